"""Where a recursive Gaussian process keeps what: four arrays, the names of their places, and the simple moves.

`squares` holds the matrix G = K + noise I and its inverse A, as `flightstack.gp.panel` wants them; `rows` holds
vectors as long as their rows, one element for each place; `state` (int64) and `real` hold single numbers, the query,
and the kernel's program.  A point keeps its place for as long as it is held; `state` lists the places in the order of
the points' indices.  At a place without a point, A and the weights are zero, and the rest is finite.
"""

from __future__ import annotations

import math

from flightstack.gp import program
from flightstack.gp.panel import BLOCK, read_column, update_multiply, write_column
from flightstack.jit import njit, njit_called, njit_vector
from flightstack.types import F64, I64

# squares
INVERSE, GRAM = 0, 1

# rows
W, C = 0, 2
"""What is to be added to A and waits for the next pass: c0 w0' + c1 w1', as rows w0, w1, c0, c1."""
K, PRODUCT, RESIDUAL, COLUMN, ZERO, UNUSED, PRIOR, RATE, WORK = 4, 5, 6, 7, 8, 9, 10, 11, 12
POINTS = WORK + program.WORK_ROWS
"""From here on: the points' columns (D), their values (P), the weights A y (P)."""

# state
COUNT, HIGH, PENDING, KNOWN, UNCHECKED, STEPS, CLOCK, REJECTED = 0, 1, 2, 3, 4, 5, 6, 7
REBUILT, CLIPPED, ALARM, CAPACITY, INPUTS, OUTPUTS, PERIOD = 8, 9, 10, 11, 12, 13, 14
ORDER = 16
"""From here on: places by index (capacity; free ones last), time of entry by place (capacity), the kernel's ints."""

# real
NOISE, LIMIT, DRIFT, WORST, JITTER, PRIOR_HERE, VARIANCE, LATEST, TOLERANCE = 0, 1, 2, 3, 4, 5, 6, 7, 8
"""VARIANCE: at the query whose product is known; the points that have left since are accounted for.  LATEST: residual
when it was looked at last; up to TOLERANCE it is looked at rarely."""
QUERY = 10
"""From here on: query (D), its rate (D), the query whose product is known (D), value (P), mean (P), variance or the
mean's rate (P), the kernel's floats."""

LEAST_NOISE = 1e-10
"""Noise below this share of the prior variance counts as this share: below it a double's digits do not suffice."""


def rows_needed(inputs: int, outputs: int) -> int:
    """Rows of `rows`."""
    return POINTS + inputs + 2 * outputs


def reals_needed(inputs: int, outputs: int) -> int:
    """Length of `real` before the kernel's floats."""
    return QUERY + 3 * inputs + outputs


@njit
def kernel_of(rows: F64, state: I64, real: F64) -> tuple[I64, F64, F64]:
    """The kernel's program and the points (D, places)."""
    d, outputs = state[INPUTS], state[OUTPUTS]
    ints = state[ORDER + 2 * state[CAPACITY] :]
    floats = real[QUERY + 3 * d + outputs :]
    return ints, floats, rows[POINTS : POINTS + d]


@njit_called
def put(squares: F64, rows: F64, state: I64, real: F64, place: int) -> None:
    """Put the query, its covariances and its value into a free place."""
    d, outputs = state[INPUTS], state[OUTPUTS]
    for i in range(d):
        rows[POINTS + i, place] = real[QUERY + i]
    for p in range(outputs):
        rows[POINTS + d + p, place] = real[QUERY + 3 * d + p]
    if place >= state[HIGH]:
        if place % BLOCK == 0:
            first = triangle_of(place // BLOCK)
            squares[:, first : triangle_of(place // BLOCK + 1)] = 0.0
        state[HIGH] = place + 1
    state[COUNT] += 1
    state[CLOCK] += 1
    state[ORDER + state[CAPACITY] + place] = state[CLOCK]
    state[KNOWN] = 0
    rows[K, place] = real[PRIOR_HERE] + noise_at(real, real[PRIOR_HERE])
    write_column(squares[GRAM], whole_blocks(state[HIGH]), place, rows[K])
    rows[K, place] = 0.0
    rows[PRODUCT, place] = 0.0
    rows[PRIOR, place] = real[PRIOR_HERE]
    for row in range(W, C + 2):
        rows[row, place] = 0.0


@njit
def triangle_of(blocks: int) -> int:
    """Elements of the first so many rows of tiles."""
    return BLOCK * BLOCK * blocks * (blocks + 1) // 2


@njit
def oldest(state: I64) -> int:
    """Index of the point that entered first."""
    best, entered = 0, state[ORDER + state[CAPACITY] + state[ORDER]]
    for i in range(1, state[COUNT]):
        when = state[ORDER + state[CAPACITY] + state[ORDER + i]]
        if when < entered:
            best, entered = i, when
    return best


@njit_called
def column_of(squares: F64, rows: F64, pending: int, place: int, size: int) -> None:
    """Column `place` of A into COLUMN, what is pending included."""
    read_column(squares[INVERSE], whole_blocks(size), place, rows[COLUMN])
    for p in range(pending):
        add_multiple(rows[COLUMN], rows[W + p], rows[C + p, place], size)


@njit
def clear_place(squares: F64, rows: F64, place: int, size: int) -> None:
    """Row and column `place` of A become zero, of what is pending too."""
    write_column(squares[INVERSE], whole_blocks(size), place, rows[ZERO])
    for row in range(W, C + 2):
        rows[row, place] = 0.0


@njit_called
def close_ranks(rows: F64, state: I64) -> None:
    """Move the points to the first places, in the order of their indices."""
    count, capacity, d = state[COUNT], state[CAPACITY], state[INPUTS]
    order, age = state[ORDER : ORDER + capacity].copy(), state[ORDER + capacity : ORDER + 2 * capacity].copy()
    for row in range(POINTS, POINTS + d + state[OUTPUTS]):
        values = rows[row].copy()
        rows[row] = 0.0
        for i in range(count):
            rows[row, i] = values[order[i]]
    values = rows[PRIOR].copy()
    rows[PRIOR] = 0.0
    for i in range(count):
        rows[PRIOR, i] = values[order[i]]
        state[ORDER + capacity + i] = age[order[i]]
    for i in range(capacity):
        state[ORDER + i] = i
    state[HIGH] = count


@njit
def make_room(squares: F64, rows: F64, state: I64) -> None:
    """Room for one more vector among what is pending."""
    if state[PENDING] == 2:
        apply(squares, rows, state)


@njit_called
def apply(squares: F64, rows: F64, state: I64) -> None:
    """Apply what is pending."""
    blank_pending(rows, state)
    update_multiply(squares[INVERSE], whole_blocks(state[HIGH]), rows, rows[ZERO], rows[UNUSED])
    state[PENDING] = 0


@njit
def blank_pending(rows: F64, state: I64) -> None:
    """The second vector of a single pending update is nothing."""
    if state[PENDING] == 1:
        rows[W + 1] = 0.0
        rows[C + 1] = 0.0
    elif state[PENDING] == 0:
        rows[W : C + 2] = 0.0


@njit
def noise_at(real: F64, prior: float) -> float:
    """The noise on the diagonal where the prior variance is `prior`: as given, or the least that can be inverted."""
    least = LEAST_NOISE * prior
    if real[NOISE] < least:
        real[JITTER] = max(real[JITTER], least - real[NOISE])
        return least
    return float(real[NOISE])


@njit
def finite(values: F64, start: int, size: int) -> bool:
    """Whether a stretch of numbers is finite."""
    fine = True
    for i in range(start, start + size):
        fine &= math.isfinite(values[i])
    return fine


@njit
def whole_blocks(size: int) -> int:
    """The size, rounded up to whole blocks."""
    return (size + BLOCK - 1) // BLOCK * BLOCK


@njit_vector
def dot(x: F64, y: F64, size: int) -> float:
    """The product of the first `size` elements of two vectors."""
    total = 0.0
    for i in range(size):
        total += x[i] * y[i]
    return total


@njit_vector
def add_multiple(x: F64, y: F64, factor: float, size: int) -> None:
    """Add a multiple of y to x, over the first `size` elements."""
    for i in range(size):
        x[i] += factor * y[i]


@njit_vector
def total(x: F64, size: int) -> float:
    """The sum of the first `size` elements."""
    result = 0.0
    for i in range(size):
        result += x[i]
    return result


@njit_vector
def queue(rows: F64, state: I64, vector: F64, factor: float) -> None:
    """To A is to be added: factor vector vector', once there is a pass; there must be room."""
    w, c = rows[W + state[PENDING]], rows[C + state[PENDING]]
    for i in range(state[HIGH]):
        w[i] = vector[i]
        c[i] = factor * vector[i]
    state[PENDING] += 1
