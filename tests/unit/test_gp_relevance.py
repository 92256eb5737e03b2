"""Which points to hold, against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.gp import Constant, Linear, RecursiveGP, SquaredExponential, least_relevant, oldest, spread
from flightstack.types import F64, InputError

KERNEL = SquaredExponential(1.0, (1.0, 2.0)) + Linear(0.2, 0)


def largest_variance(chosen: list[int], candidates: F64, queries: F64, noise: float = 1e-2) -> float:
    """By plain linear algebra."""
    x = candidates[chosen]
    gram = KERNEL.matrix(x) + noise * np.eye(len(x))
    across = KERNEL.matrix(queries, x)
    return float(np.max(KERNEL.diagonal(queries) - np.einsum("ij,ji->i", across, np.linalg.solve(gram, across.T))))


def test_the_least_relevant_point_has_the_least_covariance_with_the_query() -> None:
    rng = np.random.default_rng(0)
    gp = RecursiveGP(KERNEL, 1e-2, input_dim=2, output_dim=1, capacity=20)
    gp.add(rng.normal(size=(20, 2)), np.zeros((20, 1)))
    for _ in range(30):
        query = rng.normal(size=2)
        index = least_relevant(gp, query)
        assert index == np.argmin(np.abs(KERNEL.matrix(gp.x, query[None])[:, 0]))
        gp.remove(index)
        gp.add(query, np.zeros(1))


def test_of_equally_irrelevant_points_the_oldest_goes() -> None:
    gp = RecursiveGP(Constant(1.0), 1e-2, input_dim=1, output_dim=1, capacity=5)
    gp.add(np.arange(5.0)[:, None], np.zeros((5, 1)))
    gp.remove(0)  # the last one, 4, is at index 0 now
    assert least_relevant(gp, np.zeros(1)) == 1
    assert gp.x[1, 0] == 1.0


def test_the_oldest_is_the_first_that_entered() -> None:
    gp = RecursiveGP(KERNEL, 1e-2, input_dim=2, output_dim=1, capacity=5)
    gp.add(np.arange(10.0).reshape(5, 2), np.zeros((5, 1)))
    gp.remove(0)
    assert gp.x[oldest(gp), 0] == 2.0


def test_nothing_held_has_no_least_relevant_point() -> None:
    gp = RecursiveGP(KERNEL, 1e-2, input_dim=2, output_dim=1)
    with pytest.raises(InputError, match="no point is held"):
        least_relevant(gp, np.zeros(2))
    with pytest.raises(InputError, match="no point is held"):
        oldest(gp)


def test_a_spread_set_knows_every_corner_nearly_as_well_as_all_points_do() -> None:
    rng = np.random.default_rng(5)
    path = np.linspace(0.0, 20.0, 900)
    points = np.stack([np.sin(path), np.sin(path) + 0.01 * rng.normal(size=900)], axis=1)  # two inputs move as one
    points[:40, 1] = -1.0  # but for a moment at the beginning
    queries = np.array([[a, b] for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    chosen, newest, everything = spread(points, 60).tolist(), list(range(840, 900)), list(range(900))
    assert len(chosen) == len(set(chosen)) == 60
    whole = largest_variance(everything, points, queries)
    assert largest_variance(chosen, points, queries) < 1.25 * whole
    assert largest_variance(newest, points, queries) > 1.5 * whole


def test_a_spread_set_of_few_points_is_all_of_them_in_order() -> None:
    points = np.random.default_rng(6).normal(size=(7, 3))
    assert spread(points, 7).tolist() == list(range(7))
    assert spread(points, 0).tolist() == []
    assert spread(np.tile(points[:1], (30, 1)), 5).tolist() == sorted(spread(np.tile(points[:1], (30, 1)), 5).tolist())


def test_a_spread_set_refuses_what_it_cannot_choose_from() -> None:
    with pytest.raises(InputError, match="must be finite"):
        spread(np.full((3, 2), np.nan), 1)
    with pytest.raises(InputError, match="count = -1"):
        spread(np.zeros((3, 2)), -1)
