"""Kernels as flat programs: a sum of products in two arrays, and the compiled evaluator that reads them.

Any expression of `flightstack.gp.kernels` multiplies out to a sum of terms, a term being a coefficient times factors.
`ints` holds the shape: the number of terms; for each its number of factors; for each factor its code, its number of
columns and the columns.  `floats` holds, in the same order, each term's coefficient (the product of its variances)
and each factor's weights, one a column (1 / lengthscale^2).  Every number is a product of powers of hyper-parameters:
row i of `powers` has the exponents of floats[i], so that gradients pass to theta by one matrix product.

One evaluator interprets every program.  Its loops run over the held points, so the cost of interpreting is paid once
for each factor and not for each point; the exponentials of a term's factors are added up and taken together.
Derivatives are exact: each factor carries its value and its rate along the query's motion.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.jit import njit, njit_called, njit_vector
from flightstack.types import F64, I64, InputError

LINEAR, SQUARED_EXPONENTIAL, MATERN12, MATERN32, MATERN52 = 0, 1, 2, 3, 4
MATERN = {0.5: MATERN12, 1.5: MATERN32, 2.5: MATERN52}
WORK_ROWS = 6
_POWER, _POWER_RATE, _VALUE, _VALUE_RATE, _SQUARE, _SQUARE_RATE = range(WORK_ROWS)
"""Rows of scratch that `row` needs."""


class KernelFactor(NamedTuple):
    """One factor of a term."""

    code: int
    columns: tuple[int, ...]
    lengthscales: tuple[int, ...]
    """Places of the length-scales among the hyper-parameters, one a column; none for a linear factor."""


class Term(NamedTuple):
    """A product of factors."""

    variances: tuple[int, ...]
    """Places of the variances that multiply to the coefficient."""
    factors: tuple[KernelFactor, ...]

    def times(self, other: Term) -> Term:
        """The product of two terms."""
        return Term(self.variances + other.variances, self.factors + other.factors)


class Program(NamedTuple):
    """A kernel for inputs of a known number of columns."""

    ints: I64
    floats: F64
    powers: F64
    """(floats, hyper-parameters)."""


def flatten(terms: tuple[Term, ...], values: tuple[float, ...], input_dim: int) -> Program:
    """The program of a sum of products; raises InputError where a factor looks at a column that isn't there."""
    ints: list[int] = [len(terms)]
    powers: list[F64] = []
    for term in terms:
        powers.append(_powers(term.variances, 1.0, len(values)))
        ints.append(len(term.factors))
        for factor in term.factors:
            if max(factor.columns) >= input_dim:
                raise InputError(f"kernel: column {max(factor.columns)} is not there; inputs have {input_dim} columns")
            ints += [factor.code, len(factor.columns), *factor.columns]
            powers += [_powers((place,), -2.0, len(values)) for place in factor.lengthscales]
    table = np.array(powers)
    return Program(np.array(ints, np.int64), np.prod(np.array(values) ** table, axis=1), table)


def _powers(places: tuple[int, ...], power: float, size: int) -> F64:
    row = np.zeros(size)
    for place in places:
        row[place] += power
    return row


def matrix(kernel: Program, x: F64, y: F64) -> F64:
    """(N, M) covariances between the rows of x (N, D) and of y (M, D)."""
    turned = len(y) < len(x)  # a row costs as much as some hundred of its elements: few and long ones
    rows, columns = (y, x) if turned else (x, y)
    out = np.empty((len(rows), len(columns)))
    _matrix(kernel.ints, kernel.floats, rows, np.ascontiguousarray(columns.T), turned, out)
    return out.T if turned else out


def diagonal(kernel: Program, x: F64) -> F64:
    """(N,) prior variances of the rows of x (N, D)."""
    out = np.empty(len(x))
    _diagonal(kernel.ints, kernel.floats, x, out)
    return out


def gradient(kernel: Program, x: F64, weights: F64) -> F64:
    """(hyper-parameters,) sum over i, j of weights[i, j] (symmetric) times d k(x_i, x_j) / d theta."""
    out = np.zeros(len(kernel.floats))
    _gradient(kernel.ints, kernel.floats, x, np.ascontiguousarray(x.T), weights, out)
    result: F64 = kernel.powers.T @ out
    return result


@njit
def prior(ints: I64, floats: F64, x: F64) -> float:
    """k(x, x) for x (D,)."""
    at, place, total = 1, 0, 0.0
    for _ in range(ints[0]):
        value = floats[place]
        place += 1
        factors = ints[at]
        at += 1
        for _ in range(factors):
            columns = ints[at + 1]
            if ints[at] == LINEAR:
                value *= x[ints[at + 2]] ** 2
            else:
                place += columns
            at += 2 + columns
        total += value
    return total


@njit_called
def row(
    kernel: tuple[I64, F64], points: F64, n: int, query: tuple[F64, F64], work: F64, out: tuple[F64, F64],
    rates: bool, turned: bool = False,
) -> None:  # fmt: skip
    """Covariances of a query with n points, and with `rates` their time derivatives.

    kernel: `ints` and `floats`; query: x (D,) and its time derivative; `points` (D, >= n) holds a point a column;
    `work` (WORK_ROWS, >= n) is scratch; out: covariances and derivatives, (>= n) each.
    """
    value, value_rate, (found, found_rate) = work[_VALUE], work[_VALUE_RATE], out
    found[:n] = 0.0
    if rates:
        found_rate[:n] = 0.0
    place = 1, 0
    for _ in range(kernel[0][0]):
        place = _term(kernel, place, points, n, query, work, rates, turned)
        for i in range(n):
            found[i] += value[i]
        if rates:
            for i in range(n):
                found_rate[i] += value_rate[i]


@njit_vector
def _term(
    kernel: tuple[I64, F64], begins: tuple[int, int], points: F64, n: int, query: tuple[F64, F64], work: F64,
    rates: bool, turned: bool = False,
) -> tuple[int, int]:  # fmt: skip
    """One term's values into work[_VALUE] and its rates beside it; where the next term begins in `ints`, `floats`."""
    (ints, floats), (at, place), (x, rate) = kernel, begins, query
    power, power_rate, value, value_rate = work[_POWER], work[_POWER_RATE], work[_VALUE], work[_VALUE_RATE]
    value[:n] = floats[place]
    power[:n] = 0.0
    if rates:
        value_rate[:n] = 0.0
        power_rate[:n] = 0.0
    place += 1
    factors, stationary = ints[at], False
    at += 1
    for _ in range(factors):
        columns = ints[at + 1]
        if ints[at] == LINEAR and turned:
            _linear_turned(points[ints[at + 2]], n, x[ints[at + 2]], value)
        elif ints[at] == LINEAR:
            _linear(points[ints[at + 2]], n, x[ints[at + 2]], rate[ints[at + 2]], value, value_rate, rates)
        else:
            _distance(kernel, (at, place), points, n, query, work[_SQUARE], work[_SQUARE_RATE], rates)
            _stationary(ints[at], n, work, rates)
            place += columns
            stationary = True
        at += 2 + columns
    if not stationary:  # exp(0) everywhere
        return at, place
    _exponential(power, work[_SQUARE], n)
    if rates:
        for i in range(n):
            value_rate[i] = (value_rate[i] + value[i] * power_rate[i]) * power[i]
    for i in range(n):
        value[i] *= power[i]
    return at, place


@njit_vector
def _linear(point: F64, n: int, x: float, rate: float, value: F64, value_rate: F64, rates: bool) -> None:
    """Multiply the term by x_c x'_c."""
    if rates:
        for i in range(n):
            value_rate[i] = (value_rate[i] * x + value[i] * rate) * point[i]
    for i in range(n):
        value[i] *= x * point[i]


@njit
def _linear_turned(point: F64, n: int, x: float, value: F64) -> None:
    """The same in the order in which the points' own rows have it."""
    for i in range(n):
        value[i] = (value[i] * point[i]) * x


@njit_vector
def _distance(
    kernel: tuple[I64, F64], begins: tuple[int, int], points: F64, n: int, query: tuple[F64, F64], square: F64,
    square_rate: F64, rates: bool,
) -> None:  # fmt: skip
    """Squared scaled distances of the query to the points, and their time derivatives."""
    (ints, floats), (at, place), (x, rate) = kernel, begins, query
    square[:n] = 0.0
    if rates:
        square_rate[:n] = 0.0
    for c in range(ints[at + 1]):
        column, weight = ints[at + 2 + c], floats[place + c]
        point, here = points[column], x[column]
        if rates:
            twice = 2.0 * weight * rate[column]
            for i in range(n):
                square_rate[i] += twice * (here - point[i])
        for i in range(n):
            square[i] += weight * (here - point[i]) ** 2


@njit_vector
def _stationary(code: int, n: int, work: F64, rates: bool) -> None:
    """Multiply the term by a function of the squared distance: its exponent into `power`, the rest into `value`."""
    power, power_rate, value, value_rate, square, square_rate = (
        work[_POWER],
        work[_POWER_RATE],
        work[_VALUE],
        work[_VALUE_RATE],
        work[_SQUARE],
        work[_SQUARE_RATE],
    )
    if code == SQUARED_EXPONENTIAL:
        for i in range(n):
            power[i] -= 0.5 * square[i]
        if rates:
            for i in range(n):
                power_rate[i] -= 0.5 * square_rate[i]
        return
    for i in range(n):
        part, slope, exponent = _matern(code, square[i])
        if rates:
            value_rate[i] = value_rate[i] * part + value[i] * slope * square_rate[i]
        value[i] *= part
        power[i] -= exponent


_FAR = 1e12  # a squared distance at which every factor is zero in effect


@njit_vector
def _matern(code: int, square: float) -> tuple[float, float, float]:
    """The factor as (part, slope, exponent): part exp(-exponent), and its derivative by r^2, slope exp(-exponent).

    At distance zero Matern 1/2 has no derivative; 0, the mean of both sides, stands for it.
    """
    square = min(square, _FAR)
    if code == MATERN12:
        s = math.sqrt(square)
        return 1.0, (-0.5 / s if s > 0.0 else 0.0), s
    if code == MATERN32:
        s = math.sqrt(3.0 * square)
        return 1.0 + s, -1.5, s
    s = math.sqrt(5.0 * square)
    return 1.0 + s + s * s / 3.0, -5.0 / 6.0 * (1.0 + s), s


_LEAST_POWER = -230.0  # 1e-100: nothing beside 1, and products of a few stay clear of slow, denormal numbers
_TO_POWER_OF_2 = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 0.693147180369123816490, 1.90821492927058770002e-10
_ROUND = 6755399441055744.0  # 1.5 * 2^52: adding it leaves the nearest whole number in the lowest bits
_ROUND_BITS = 0x4338000000000000


_E2, _E3, _E4, _E5, _E6, _E7, _E8, _E9, _E10, _E11, _E12, _E13 = (1.0 / math.factorial(i) for i in range(2, 14))


@njit  # IEEE order: adding and taking away _ROUND must not cancel
def _exponential(power: F64, scratch: F64, n: int) -> None:
    """exp of each element in place, for elements <= 0; below -230 as at -230.

    exp(p) = 2^k exp(r) with |r| <= ln(2) / 2 and 14 terms of exp's series, good to the last bit or two.  Written out
    because the library's exponential takes one number at a time; these loops take as many as a register holds.
    """
    for i in range(n):
        p = max(power[i], _LEAST_POWER)
        shifted = p * _TO_POWER_OF_2 + _ROUND
        k = shifted - _ROUND
        r = (p - k * _LN2_HIGH) - k * _LN2_LOW
        series = _E13
        series = series * r + _E12
        series = series * r + _E11
        series = series * r + _E10
        series = series * r + _E9
        series = series * r + _E8
        series = series * r + _E7
        series = series * r + _E6
        series = series * r + _E5
        series = series * r + _E4
        series = series * r + _E3
        series = series * r + _E2
        power[i] = (series * r + 1.0) * r + 1.0
        scratch[i] = shifted
    bits = scratch.view(np.int64)
    for i in range(n):
        bits[i] = (bits[i] - _ROUND_BITS + 1023) << 52
    for i in range(n):
        power[i] *= scratch[i]


@njit_called
def _diagonal(ints: I64, floats: F64, x: F64, out: F64) -> None:
    """out[i] = k(x_i, x_i), with x (N, D)."""
    for i in range(len(x)):
        out[i] = prior(ints, floats, x[i])


@njit_called
def _matrix(ints: I64, floats: F64, x: F64, points: F64, turned: bool, out: F64) -> None:
    """out[i, j] = k(x_i, y_j), with x (N, D) and the y as columns of `points` (D, M).

    `turned`: to the last bit as k(y_j, x_i).
    """
    n = points.shape[1]
    work = np.empty((WORK_ROWS, n))
    for i in range(len(x)):
        row((ints, floats), points, n, (x[i], x[i]), work, (out[i], work[_POWER_RATE]), False, turned)


@njit_called
def _gradient(ints: I64, floats: F64, x: F64, points: F64, weights: F64, out: F64) -> None:
    """out[f] += sum over i, j of weights[i, j] d k(x_i, x_j) / d log floats[f]; x (N, D), points its transpose."""
    n, kernel = len(x), (ints, floats)
    work = np.empty((WORK_ROWS, n))
    for i in range(n):
        place = 1, 0
        for _ in range(ints[0]):
            first = place
            place = _term(kernel, first, points, n, (x[i], x[i]), work, False)
            for j in range(n):
                work[_VALUE_RATE, j] = weights[i, j] * work[_VALUE, j]
            out[first[1]] += work[_VALUE_RATE].sum()
            _term_gradient(kernel, first, points, n, x[i], work, out)


@njit
def _term_gradient(
    kernel: tuple[I64, F64], begins: tuple[int, int], points: F64, n: int, x: F64, work: F64, out: F64
) -> None:
    """One term's share of `_gradient` for the weights; the value's rate is the value times the outer weight."""
    (ints, floats), (at, place) = kernel, begins
    factors = ints[at]
    at, place = at + 1, place + 1
    for _ in range(factors):
        columns = ints[at + 1]
        if ints[at] != LINEAR:
            _distance(kernel, (at, place), points, n, (x, x), work[_SQUARE], work[_SQUARE_RATE], False)
            for j in range(n):
                part, slope = 1.0, -0.5
                if ints[at] != SQUARED_EXPONENTIAL:
                    part, slope, _ = _matern(ints[at], work[_SQUARE, j])
                work[_SQUARE, j] = work[_VALUE_RATE, j] * slope / part
            for c in range(columns):
                point, here, total = points[ints[at + 2 + c]], x[ints[at + 2 + c]], 0.0
                for j in range(n):
                    total += work[_SQUARE, j] * (here - point[j]) ** 2
                out[place + c] += floats[place + c] * total
            place += columns
        at += 2 + columns
