"""The inverse from nothing but the points: Gauss-Jordan elimination on the diagonal, in the recursion's own moves.

Each pivot is one rank-1 update of the whole triangle, two of them a pass, so this costs half a pass a point, needs no
library and no second thread, and is as accurate as Cholesky's factorisation for symmetric positive definite matrices.
Source: Higham, Accuracy and Stability of Numerical Algorithms (2002), section 14.4.
"""

from __future__ import annotations

import numpy as np

from flightstack.gp import program, store
from flightstack.gp.panel import multiply, write_column
from flightstack.jit import njit, njit_called
from flightstack.types import F64, I64

_LEAST_PIVOT = 0.5
"""Share of the noise below which a pivot, at least the noise in exact arithmetic, can't be trusted."""
_TRIES = 40


@njit_called
def rebuild(squares: F64, rows: F64, state: I64, real: F64) -> None:
    """The inverse, the weights and the order of places from nothing but the points and their values.

    Where the matrix isn't positive definite in floating point, the diagonal grows by a jitter until it is.
    """
    store.close_ranks(rows, state)
    jitter = 0.0
    for _ in range(_TRIES):
        if _invert(squares, rows, state, real, jitter):
            break
        jitter = max(10.0 * jitter, 1e-15 * rows[store.PRIOR].max(), 1e-3 * real[store.NOISE])
    real[store.JITTER] = max(real[store.JITTER], jitter)
    size, first = state[store.HIGH], store.POINTS + state[store.INPUTS]
    for p in range(state[store.OUTPUTS]):
        multiply(
            squares[store.INVERSE], store.whole_blocks(size), rows[first + p], rows[first + state[store.OUTPUTS] + p]
        )
    state[store.REBUILT] += 1
    state[store.STEPS], state[store.ALARM], state[store.KNOWN] = 0, 0, 0
    real[store.DRIFT], real[store.LATEST] = 0.0, np.inf


@njit_called
def _invert(squares: F64, rows: F64, state: I64, real: F64, jitter: float) -> bool:
    """A = (K + (noise + jitter) I)^-1; False where a pivot tells that the matrix isn't positive definite."""
    size, whole = state[store.HIGH], store.whole_blocks(state[store.HIGH])
    ints, floats, points = store.kernel_of(rows, state, real)
    rows[store.W : store.C + 2] = 0.0
    state[store.PENDING] = 0
    work, k, gram = rows[store.WORK : store.WORK + program.WORK_ROWS], rows[store.K], squares[store.GRAM]
    squares[:] = 0.0
    for i in range(size):
        query = np.ascontiguousarray(points[:, i])
        program.row((ints, floats), points, size, (query, query), work, (k, k), False)
        k[i] += store.noise_at(real, rows[store.PRIOR, i]) + jitter
        k[size:] = 0.0
        write_column(gram, whole, i, k)
    squares[store.INVERSE] = -gram
    for place in range(size):
        store.make_room(squares, rows, state)
        store.column_of(squares, rows, state[store.PENDING], place, size)
        pivot = -rows[store.COLUMN, place]
        if not pivot > _LEAST_PIVOT * (store.noise_at(real, rows[store.PRIOR, place]) + jitter):
            return False
        _eliminate(squares, rows, state, place, pivot)
    store.apply(squares, rows, state)
    return True


@njit
def _eliminate(squares: F64, rows: F64, state: I64, place: int, pivot: float) -> None:
    """One step of the elimination; COLUMN holds the pivot's column."""
    size, column = state[store.HIGH], rows[store.COLUMN]
    column[place] = 0.0
    store.clear_place(squares, rows, place, size)
    store.queue(rows, state, column, 1.0 / pivot)
    for i in range(size):
        column[i] = -column[i] / pivot
    column[place] = 1.0 / pivot
    write_column(squares[store.INVERSE], store.whole_blocks(size), place, column)
