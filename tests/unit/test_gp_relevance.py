"""Which points to hold, against brute force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from flightstack.gp import Constant, Linear, RecursiveGP, SquaredExponential, cover, least_relevant, oldest
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


def test_each_choice_of_a_cover_is_the_best_next_one() -> None:
    rng = np.random.default_rng(5)
    candidates, queries = rng.uniform(-2, 2, (25, 2)), rng.uniform(-2, 2, (40, 2))
    chosen = cover(KERNEL, 1e-2, candidates, queries, 6)
    assert len(set(chosen)) == 6
    for i in range(6):
        rest = [j for j in range(25) if j not in chosen[:i]]
        best = min(largest_variance([*chosen[:i], j], candidates, queries) for j in rest)
        assert largest_variance(chosen[: i + 1], candidates, queries) == pytest.approx(best, rel=1e-9)


def test_a_cover_of_two_comes_near_the_best_pair_and_more_points_never_hurt() -> None:
    rng = np.random.default_rng(6)
    candidates, queries = rng.uniform(-2, 2, (12, 2)), rng.uniform(-2, 2, (30, 2))
    chosen = cover(KERNEL, 1e-2, candidates, queries, 12)
    best = min(largest_variance(list(pair), candidates, queries) for pair in itertools.combinations(range(12), 2))
    assert largest_variance(chosen[:2], candidates, queries) <= 1.5 * best
    worst = [largest_variance(chosen[:i], candidates, queries) for i in range(1, 13)]
    assert all(later <= earlier + 1e-12 for earlier, later in itertools.pairwise(worst))


def test_a_cover_refuses_what_it_cannot_choose_from() -> None:
    with pytest.raises(InputError, match="there are 3 candidates"):
        cover(KERNEL, 1e-2, np.zeros((3, 2)), np.zeros((1, 2)), 4)
    with pytest.raises(InputError, match="must be finite"):
        cover(KERNEL, 1e-2, np.full((3, 2), np.nan), np.zeros((1, 2)), 1)
    assert cover(KERNEL, 1e-2, np.zeros((3, 2)), np.zeros((1, 2)), 0) == []
