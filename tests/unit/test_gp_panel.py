"""The pass over the triangle against plain matrix algebra."""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.gp.panel import aligned, multiply, padded, read_column, triangle, update_multiply, write_column
from flightstack.types import F64


def tiled(full: F64) -> F64:
    """A symmetric matrix as its triangle of tiles, column by column."""
    size = padded(len(full))
    matrix, column = aligned(1, triangle(size))[0], np.zeros(size)
    for place in range(len(full)):
        column[: len(full)] = full[place]
        write_column(matrix, size, place, column)
    return matrix


def square(matrix: F64, size: int) -> F64:
    """The full matrix of a triangle of tiles."""
    result = np.empty((size, size))
    for place in range(size):
        read_column(matrix, size, place, result[place])
    return result


def symmetric(count: int, seed: int) -> F64:
    draw = np.random.default_rng(seed).normal(size=(count, count))
    return draw + draw.T


@pytest.mark.parametrize("count", [1, 7, 8, 9, 16, 43, 100])
def test_columns_come_back_as_they_were_written(count: int) -> None:
    full, size = symmetric(count, count), padded(count)
    back = square(tiled(full), size)
    np.testing.assert_array_equal(back[:count, :count], full)
    assert not back[count:].any()


@pytest.mark.parametrize("count", [1, 7, 8, 9, 16, 43, 100])
def test_a_pass_updates_and_multiplies(count: int) -> None:
    full, size = symmetric(count, 3), padded(count)
    rows = aligned(6, size + 16)  # rows may be longer than the matrix's
    rows[:, :count] = np.random.default_rng(4).normal(size=(6, count))
    w0, w1, c0, c1, k = rows[:5, :count]
    matrix = tiled(full)
    multiply(matrix, size, rows[4], rows[5])
    np.testing.assert_allclose(rows[5, :count], full @ k, rtol=1e-12, atol=1e-12)
    c1[:] = w1
    c0[:] = -w0
    update_multiply(matrix, size, rows, rows[4], rows[5])
    wanted = full - np.outer(w0, w0) + np.outer(w1, w1)
    np.testing.assert_allclose(square(matrix, size)[:count, :count], wanted, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(rows[5, :count], wanted @ k, rtol=1e-12, atol=1e-12)
    assert not rows[5, count:].any()


def test_the_memory_begins_on_a_cache_line() -> None:
    for rows in range(1, 5):
        assert aligned(rows, 24).ctypes.data % 64 == 0
