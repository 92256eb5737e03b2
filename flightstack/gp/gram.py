"""Covariances of points with each other, for what factorises them: lower triangles, and roots where they are exact."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flightstack.gp.kernels import Kernel
from flightstack.gp.program import LINEAR, WORK_ROWS, Program, row
from flightstack.jit import njit_called
from flightstack.types import F64, I64

_BLOCK = 8
"""Rows that are written at once: as many numbers as a line of the cache holds."""
_ROUNDED = 1e-12


class Parts(NamedTuple):
    """A kernel's terms at some points."""

    root: F64
    """(N, terms) of those without a stationary leaf, each of rank one: a column whose product with itself it is."""
    smooth: F64
    """(N, N) lower triangle of the sum of the others, column by column; zero above."""


def lower_triangle(kernel: Kernel, x: F64) -> F64:
    """(N, N) covariances of the points x (N, D), to the last bit `Kernel.matrix`; zero above the diagonal, and column
    by column, as LAPACK takes it."""
    rows = np.ascontiguousarray(x, np.float64)
    found = kernel.program(rows.shape[1])
    return _triangle(found.ints, found.floats, rows)


def parts(kernel: Kernel, x: F64) -> Parts:
    """Of a kernel at the points x (N, D)."""
    rows = np.ascontiguousarray(x, np.float64)
    ints, floats, _ = kernel.program(rows.shape[1])
    columns, shape, numbers = [np.empty((len(rows), 0))], [np.zeros(1, np.int64)], [np.zeros(0)]
    at, place = 1, 0
    for _ in range(ints[0]):
        begin, first, column, smooth = at, place, np.sqrt(np.full(len(rows), floats[place])), False
        at, place = at + 1, place + 1
        for _ in range(ints[begin]):
            if ints[at] == LINEAR:
                column *= rows[:, ints[at + 2]]
            else:
                place, smooth = place + int(ints[at + 1]), True
            at += 2 + int(ints[at + 1])
        if smooth:
            shape.append(ints[begin:at])
            numbers.append(floats[first:place])
        else:
            columns.append(column[:, None])
    shape[0][0] = len(shape) - 1
    return Parts(np.hstack(columns), _triangle(np.concatenate(shape), np.concatenate(numbers), rows))


def linear_columns(kernel: Program, count: int) -> tuple[I64, F64]:
    """Columns, of so many, that a kernel has nowhere but in terms of their own, variance x_c x'_c; these variances, 0
    of columns that it does not look at."""
    ints, floats, _ = kernel
    variances, elsewhere = np.zeros(count), np.zeros(count, np.bool_)
    at, place = 1, 0
    for _ in range(ints[0]):
        factors, coefficient = ints[at], floats[place]
        at, place = at + 1, place + 1
        for _ in range(factors):
            columns = ints[at + 2 : at + 2 + ints[at + 1]]
            if factors == 1 and ints[at] == LINEAR:
                variances[columns] += coefficient
            else:
                elsewhere[columns] = True
            place += 0 if ints[at] == LINEAR else len(columns)
            at += 2 + len(columns)
    found = np.flatnonzero(~elsewhere)
    return found, variances[found]


@njit_called
def alike(x: F64, but: I64) -> tuple[I64, I64]:
    """(M,) number of each row of x (M, D) among those that differ, and the first row of each: up to rounding, and but
    for some columns."""
    places, first, count = np.empty(len(x), np.int64), np.empty(len(x), np.int64), 0
    compared = np.ones(x.shape[1], np.bool_)
    compared[but] = False
    for i in range(len(x)):
        places[i] = count
        for k in range(count - 1, -1, -1):
            same = True
            for c in range(x.shape[1]):
                if compared[c] and abs(x[i, c] - x[first[k], c]) > _ROUNDED:
                    same = False
                    break
            if same:
                places[i] = k
                break
        if places[i] == count:
            first[count] = i
            count += 1
    return places, first[:count].copy()


def _triangle(ints: I64, floats: F64, x: F64) -> F64:
    out = np.zeros((len(x), len(x)))
    if ints[0]:
        _lower(ints, floats, x, np.ascontiguousarray(x.T), out)
    return out.T


@njit_called
def _lower(ints: I64, floats: F64, x: F64, points: F64, out: F64) -> None:
    """out[j, i] = k(x_i, x_j) for j <= i, with x (N, D) and `points` its transpose."""
    n = len(x)
    work, rates, found = np.empty((WORK_ROWS, n)), np.empty(n), np.empty((_BLOCK, n))
    for first in range(0, n, _BLOCK):
        count = min(_BLOCK, n - first)
        for k in range(count):
            i = first + k
            row((ints, floats), points, i + 1, (x[i], x[i]), work, (found[k], rates), False)
        for j in range(first + count):
            for k in range(max(j - first, 0), count):
                out[j, first + k] = found[k, j]
