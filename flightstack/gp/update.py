"""The recursion: points leave and enter an exact Gaussian process, at one pass over its inverse for each exchange.

With A = (K + noise I)^-1 over the held points, and weights A y carried along for every output:

    leave j    A <- A - a a' / a_j                       a = column j of A; row and column j become zero
    enter x    A <- A + (u - e_j)(u - e_j)' / s          u = A k(x), s = k(x, x) + noise - k(x)' u

Source: the inverse of a partitioned matrix (Golub and Van Loan, Matrix Computations, section 2.1.4).  A point takes
the place that another has left, so an exchange is one symmetric rank-2 update.  It waits until the next product with
A, which applies it in the same pass.  The product of a prediction serves the entry of the same point.

Row and column j are written anew from zero at every exchange, so old rounding errors leave with their points.  What
builds up all the same (the worse, the smaller the noise) is watched: of one held point, the probe, the column of
K + noise I is kept up, and each leaving row of A must be orthogonal to it.  `rebuild` computes A from nothing by
Gauss-Jordan elimination on the diagonal, which for these matrices is as accurate as Cholesky's factorisation.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.gp import program, store
from flightstack.gp.panel import multiply, update_multiply
from flightstack.gp.rebuild import rebuild
from flightstack.jit import Entry, njit, njit_called
from flightstack.types import F64, I64

_LEAST_PIVOT = 0.5
"""An entering point's s and a leaving one's 1 / a_j are at least the noise; below this share of it, A is lost."""
_SMALL_NOISE = 1e-3
"""Where the noise is below this share of the prior variance, every product is bettered by its residual, unless the
latest was below what is tolerated."""
_CHECK_STEPS = 16
"""And otherwise every so many, to watch the drift."""
_REST_STEPS = 100
"""Drift calls for a rebuild no more often than this: what a rebuild can't mend must not cost every step."""


@njit
def predict(x: F64, mean: F64, squares: F64, rows: F64, state: I64, real: F64) -> float:
    """Mean (P,) at x (D,) into `mean`, and the variance there; NaN where x isn't finite."""
    d, outputs = state[store.INPUTS], state[store.OUTPUTS]
    real[store.QUERY : store.QUERY + d] = x
    if not _admissible(rows, state, real):
        mean[:] = np.nan
        return math.nan
    _solve(squares, rows, state, real, True)
    first, size = store.POINTS + d, state[store.HIGH]
    for p in range(outputs):
        mean[p] = store.dot(rows[store.PRODUCT], rows[first + p], size)
        if state[store.UNCHECKED] == 0:
            mean[p] += store.dot(rows[store.RESIDUAL], rows[first + outputs + p], size)
    return float(real[store.VARIANCE])


@njit
def predict_along(x: F64, x_rate: F64, mean: F64, mean_rate: F64, rows: F64, state: I64, real: F64) -> None:
    """Mean (P,) at x (D,) and its time derivative along `x_rate`; NaN where either isn't finite."""
    d, outputs, size = state[store.INPUTS], state[store.OUTPUTS], state[store.HIGH]
    query, rate = real[store.QUERY : store.QUERY + d], real[store.QUERY + d : store.QUERY + 2 * d]
    query[:], rate[:] = x, x_rate
    if not store.finite(real, store.QUERY, 2 * d):
        mean[:] = mean_rate[:] = np.nan
        return
    ints, floats, points = store.kernel_of(rows, state, real)
    work = rows[store.WORK : store.WORK + program.WORK_ROWS]
    program.row((ints, floats), points, size, (query, rate), work, (rows[store.UNUSED], rows[store.RATE]), True)
    first = store.POINTS + d + outputs
    for p in range(outputs):
        mean[p] = store.dot(rows[store.UNUSED], rows[first + p], size)
        mean_rate[p] = store.dot(rows[store.RATE], rows[first + p], size)


@njit
def enter(squares: F64, rows: F64, state: I64, real: F64, leaving: int) -> bool:
    """Let the point `leaving` go (-1: none), then take the query with its value; False where these aren't finite.

    Where the store is full and nothing leaves, the oldest point goes.
    """
    d, outputs = state[store.INPUTS], state[store.OUTPUTS]
    fit = _admissible(rows, state, real) and store.finite(real, store.QUERY + 3 * d, outputs)
    if fit and leaving < 0 and state[store.COUNT] == state[store.CAPACITY]:
        leaving = store.oldest(state)
    if leaving >= 0:
        leave(squares, rows, state, real, leaving)
    if fit:
        _solve(squares, rows, state, real, False)
        _insert(squares, rows, state, real)
    else:
        state[store.REJECTED] += 1
    return fit


@njit_called
def _insert(squares: F64, rows: F64, state: I64, real: F64) -> None:
    """Take the query, whose product with A is known, and its value."""
    store.make_room(squares, rows, state)
    d, outputs = state[store.INPUTS], state[store.OUTPUTS]
    place = state[store.ORDER + state[store.COUNT]]
    store.put(squares, rows, state, real, place)
    size, u = state[store.HIGH], rows[store.PRODUCT]
    # from the same A as u, not the better variance: so the new row of A's inverse is exact, and old errors heal
    noise = store.noise_at(real, real[store.PRIOR_HERE])
    pivot = real[store.PRIOR_HERE] + noise - store.dot(rows[store.K], u, size)
    if not pivot > _LEAST_PIVOT * noise:
        state[store.ALARM] = 1
        pivot = noise
    for values in range(store.POINTS + d, store.POINTS + d + outputs):
        weights = rows[values + outputs]
        error = rows[values, place] - store.dot(rows[store.K], weights, size)
        store.add_multiple(weights, u, -error / pivot, size)
        weights[place] = error / pivot
    u[place] = -1.0
    store.queue(rows, state, u, 1.0 / pivot)
    state[store.STEPS] += 1


@njit_called
def leave(squares: F64, rows: F64, state: I64, real: F64, index: int) -> None:
    """Let a point go; the last one takes its index.  ALARM tells where A is found spoilt."""
    store.make_room(squares, rows, state)
    last = state[store.COUNT] - 1
    place, size = state[store.ORDER + index], state[store.HIGH]
    state[store.ORDER + index] = state[store.ORDER + last]
    state[store.ORDER + last] = place
    state[store.COUNT] = last
    column = rows[store.COLUMN]
    store.column_of(squares, rows, state[store.PENDING], place, size)
    pivot = column[place]
    noise = store.noise_at(real, rows[store.PRIOR, place])
    if not 0.0 < pivot * _LEAST_PIVOT * noise < 1.0:
        state[store.ALARM] = 1
        pivot = 1.0 / noise
    column[place] = 0.0
    store.clear_place(squares, rows, place, size)
    rows[store.K, place] = 0.0
    rows[store.PRIOR, place] = 0.0
    first = store.POINTS + state[store.INPUTS] + state[store.OUTPUTS]
    for row in range(first, first + state[store.OUTPUTS]):
        store.add_multiple(rows[row], column, -rows[row, place] / pivot, size)
        rows[row, place] = 0.0
    if state[store.KNOWN]:
        share = rows[store.PRODUCT, place]
        real[store.VARIANCE] += share * share / pivot
        store.add_multiple(rows[store.PRODUCT], column, -share / pivot, size)
        rows[store.PRODUCT, place] = 0.0
        rows[store.RESIDUAL, place] = 0.0
    store.queue(rows, state, column, -1.0 / pivot)


@njit
def _admissible(rows: F64, state: I64, real: F64) -> bool:
    """Whether the query and its prior variance, which is noted, are finite."""
    ints, floats, _ = store.kernel_of(rows, state, real)
    real[store.PRIOR_HERE] = program.prior(ints, floats, real[store.QUERY : store.QUERY + state[store.INPUTS]])
    return store.finite(real, store.QUERY, state[store.INPUTS]) and math.isfinite(real[store.PRIOR_HERE])


@njit_called
def _solve(squares: F64, rows: F64, state: I64, real: F64, asked: bool) -> None:
    """The query's covariances into K, their product with A into PRODUCT; unless all are known already.

    Its variance, too, where it is `asked` for; a point that enters needs none.

    Where A is found spoilt, or is due, it is rebuilt first.
    """
    d = state[store.INPUTS]
    query, known = real[store.QUERY : store.QUERY + d], real[store.QUERY + 2 * d : store.QUERY + 3 * d]
    same = state[store.KNOWN] == 1
    for i in range(d):
        same &= query[i] == known[i]
        known[i] = query[i]
    if same and not state[store.ALARM]:
        return
    for _ in range(2):
        if state[store.ALARM] or state[store.STEPS] >= state[store.PERIOD]:
            rebuild(squares, rows, state, real)
        _multiply_query(squares, rows, state, real)
        if asked:
            real[store.VARIANCE] = _variance(squares[store.GRAM], rows, state, real)
        else:
            state[store.UNCHECKED] += 1
        if not state[store.ALARM]:
            break
    state[store.KNOWN] = 1


@njit_called
def _multiply_query(squares: F64, rows: F64, state: I64, real: F64) -> None:
    """The query's covariances and their product with A."""
    d = state[store.INPUTS]
    ints, floats, points = store.kernel_of(rows, state, real)
    query, size = real[store.QUERY : store.QUERY + d], store.whole_blocks(state[store.HIGH])
    work = rows[store.WORK : store.WORK + program.WORK_ROWS]
    program.row((ints, floats), points, size, (query, query), work, (rows[store.K], rows[store.K]), False)
    if state[store.PENDING]:
        store.blank_pending(rows, state)
        update_multiply(squares[store.INVERSE], size, rows, rows[store.K], rows[store.PRODUCT])
        state[store.PENDING] = 0
    else:
        multiply(squares[store.INVERSE], size, rows[store.K], rows[store.PRODUCT])


@njit_called
def _variance(gram: F64, rows: F64, state: I64, real: F64) -> float:
    """Posterior variance at the query; what G v lacks of k into RESIDUAL, for the mean.

    v = A k feels A's errors, and they are the larger the smaller the noise.  With the residual r = k - G v,

        k(x, x) - k'v - v'r    and    v'y + r'(A y)

    are the same for an exact A and stationary in its errors: only their square is left, and it can only make the
    variance larger.  v'r, the error of k(x, x) - k'v, is the drift watched here.
    """
    k, v, residual = rows[store.K], rows[store.PRODUCT], rows[store.RESIDUAL]
    size, prior = state[store.HIGH], real[store.PRIOR_HERE]
    # n noisy looks at other points tell no more of this one than n looks at it, each as strong as theirs
    least = prior * real[store.NOISE] / (real[store.NOISE] + store.total(rows[store.PRIOR], size))
    variance = prior - store.dot(k, v, size)
    state[store.UNCHECKED] += 1
    small = real[store.NOISE] < _SMALL_NOISE * prior and real[store.LATEST] >= real[store.TOLERANCE]
    doubtful = small or not variance >= least
    if doubtful or state[store.UNCHECKED] >= _CHECK_STEPS:
        state[store.UNCHECKED] = 0
        multiply(gram, store.whole_blocks(size), v, residual)
        for i in range(size):
            residual[i] = k[i] - residual[i]
        error = store.dot(v, residual, size)
        variance -= error
        drift = abs(error) / max(variance, least)
        real[store.LATEST], real[store.DRIFT] = drift, max(real[store.DRIFT], drift)
        real[store.WORST] = max(real[store.WORST], drift)
        if not drift <= real[store.LIMIT] and state[store.STEPS] >= _REST_STEPS:
            state[store.ALARM] = 1
    if not variance >= least:
        if not variance >= least * (1.0 - 1e-6):
            state[store.CLIPPED] += 1
        variance = least
    return float(variance)


@njit_called
def least_covariant(rows: F64, state: I64, real: F64) -> int:
    """Index of the point with the least |covariance| with the query; of equals the oldest."""
    ints, floats, points = store.kernel_of(rows, state, real)
    query, k = real[store.QUERY : store.QUERY + state[store.INPUTS]], rows[store.UNUSED]
    work = rows[store.WORK : store.WORK + program.WORK_ROWS]
    program.row((ints, floats), points, state[store.HIGH], (query, query), work, (k, k), False)
    entered = state[store.ORDER + state[store.CAPACITY] :]
    best = 0
    for i in range(1, state[store.COUNT]):
        place, other = state[store.ORDER + i], state[store.ORDER + best]
        if abs(k[place]) < abs(k[other]) or (abs(k[place]) == abs(k[other]) and entered[place] < entered[other]):
            best = i
    return best


PREDICT = Entry(predict, "f8[::1], f8[::1], f8[:, ::1], f8[:, ::1], i8[::1], f8[::1]")
ALONG = Entry(predict_along, "f8[::1], f8[::1], f8[::1], f8[::1], f8[:, ::1], i8[::1], f8[::1]")
ENTER = Entry(enter, "f8[:, ::1], f8[:, ::1], i8[::1], f8[::1], i8")
