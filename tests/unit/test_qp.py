"""The nearest point of a polytope against every active set there is."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from flightstack.barrier.qp import NearestPoint
from flightstack.types import F64

ROWS = 9
_RANDOM, _NARROW = 1_500, 700  # benchmarks/filter.py runs 100,000 and 10,000


def oracle(rows: F64, low: F64, high: F64, wanted: F64) -> F64:
    """(n, 3) nearest points of n problems: every set of up to three bounds is tried, the nearest feasible one taken.

    rows (n, m, 3), low, high (n, m), wanted (n, 3).  NaN where none is feasible.
    """
    normals = np.concatenate([rows, rows], axis=1)
    bounds = np.concatenate([low, high], axis=1)
    count = low.shape[1]
    best = np.full(len(wanted), np.inf)
    point = np.full(wanted.shape, np.nan)
    for size in range(4):
        for active in combinations(range(2 * count), size):
            if len({i % count for i in active}) < size:
                continue
            x, fine = wanted, np.ones(len(wanted), bool)
            if size:
                x, fine = _on_planes(normals[:, active], bounds[:, active], wanted)
            z = np.einsum("nmk,nk->nm", rows, x)
            fine = fine & (z >= low - 1e-11).all(axis=1) & (z <= high + 1e-11).all(axis=1)
            distance = ((x - wanted) ** 2).sum(axis=1)
            better = fine & (distance < best)
            best[better], point[better] = distance[better], x[better]
    return point


def _on_planes(normals: F64, bounds: F64, wanted: F64) -> tuple[F64, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """The points of the planes' intersections nearest to `wanted`, by QR; and where there is one."""
    q, r = np.linalg.qr(np.swapaxes(normals, 1, 2))
    fine = np.abs(np.diagonal(r, axis1=1, axis2=2)).min(axis=1) > 1e-9
    r = np.where(fine[:, None, None], r, np.eye(r.shape[1]))
    gap = bounds - np.einsum("nmk,nk->nm", normals, wanted)
    along = np.linalg.solve(np.swapaxes(r, 1, 2), gap[..., None])[..., 0]
    return wanted + np.einsum("nkm,nm->nk", q, along), fine


def random_problems(rng: np.random.Generator, count: int) -> tuple[F64, F64, F64, F64]:
    """Rows of every direction and length round a point that is inside, and a wanted point anywhere."""
    rows = rng.normal(size=(count, ROWS, 3)) * rng.uniform(0.1, 10.0, (count, ROWS, 1))
    inside = np.einsum("nmk,nk->nm", rows, rng.normal(size=(count, 3)) * 3.0)
    size = np.linalg.norm(rows, axis=2)
    low = inside - size * rng.exponential(1.0, (count, ROWS))
    high = inside + size * rng.exponential(1.0, (count, ROWS))
    return rows, low, high, rng.normal(size=(count, 3)) * 5.0


def narrow_problems(rng: np.random.Generator, count: int) -> tuple[F64, F64, F64, F64]:
    """The filter's own rows, of which two in three leave between 1e-9 and 1e-3 m/s^2 of room."""
    rows, _, _, wanted = random_problems(rng, count)
    rows[:, :3] = np.eye(3)
    inside = rng.normal(size=(count, 3)) * 3.0
    z = np.einsum("nmk,nk->nm", rows, inside)
    size = np.linalg.norm(rows, axis=2)
    room = np.where(rng.random((count, ROWS)) < 2 / 3, 10.0 ** rng.uniform(-9, -3, (count, ROWS)), 3.0) * size
    share = rng.random((count, ROWS))
    return rows, z - share * room, z + (1.0 - share) * room, wanted


def worst_error(problems: tuple[F64, F64, F64, F64]) -> tuple[float, int, int]:
    """Largest distance from the oracle's points, problems without a solution, most iterations."""
    solver, exact = NearestPoint(problems[0].shape[1]), oracle(*(_unit(problems)))
    worst, failed, most = 0.0, 0, 0
    assert np.isfinite(exact).all()
    for i, problem in enumerate(zip(*problems, strict=True)):
        solution = solver.solve(*problem)
        failed += not solution.solved
        most = max(most, solution.iterations)
        if solution.solved:
            worst = max(worst, float(np.abs(solution.x - exact[i]).max()))
            assert solution.residual <= 1e-9
    return worst, failed, most


def _unit(problems: tuple[F64, F64, F64, F64]) -> tuple[F64, F64, F64, F64]:
    rows, low, high, wanted = problems
    size = np.linalg.norm(rows, axis=2)
    return rows / size[..., None], low / size, high / size, wanted


def test_random_problems_are_solved_to_the_active_sets_answer():
    worst, failed, most = worst_error(random_problems(np.random.default_rng(1), _RANDOM))
    assert failed == 0
    assert worst < 1e-7
    assert most <= 75


def test_nearly_infeasible_problems_too():
    worst, failed, _ = worst_error(narrow_problems(np.random.default_rng(2), _NARROW))
    assert failed == 0
    assert worst < 1e-7


def test_infeasible_problems_are_never_called_solved():
    rng = np.random.default_rng(3)
    solver = NearestPoint(ROWS)
    for gap in 10.0 ** rng.uniform(-7, 1, 200):
        rows, low, high, wanted = (part[0] for part in random_problems(rng, 1))
        rows[1] = rows[0]
        low[0], high[0], low[1], high[1] = 0.0, np.inf, -np.inf, -gap * np.linalg.norm(rows[0])
        solution = solver.solve(rows, low, high, wanted)
        assert not solution.solved
        assert np.isnan(solution.x).all()  # and not the 2143289344.0 of the library
        assert solution.residual == np.inf
    after = random_problems(rng, 1)
    np.testing.assert_allclose(solver.solve(*(part[0] for part in after)).x, oracle(*_unit(after))[0], atol=1e-7)


@pytest.mark.parametrize("place", range(4))
def test_what_is_not_a_number_is_not_solved(place):
    problem = [part[0].copy() for part in random_problems(np.random.default_rng(4), 1)]
    problem[place].flat[2] = np.nan
    assert not NearestPoint(ROWS).solve(*problem).solved


def test_one_affine_row_is_its_closed_form():
    """The published filter: the nearest thrust to the wanted one that a single row allows."""
    solver = NearestPoint(2)
    rng = np.random.default_rng(5)
    for _ in range(200):
        slope, room, wanted = rng.normal() * 4.0, rng.normal(), rng.normal() * 20.0
        rows = np.array([[slope, 0.0, 0.0], [1.0, 0.0, 0.0]])
        low, high = np.array([-room, -30.0]), np.array([np.inf, 30.0])
        least = -room / slope
        if abs(least) > 29.0:
            continue
        expected = min(max(wanted, -30.0), 30.0)
        expected = max(expected, least) if slope > 0.0 else min(expected, least)
        solution = solver.solve(rows, low, high, np.array([wanted, 1.0, -2.0]))
        np.testing.assert_allclose(solution.x, [expected, 1.0, -2.0], atol=1e-9)


def test_the_same_problem_ends_the_same_way():
    problems = random_problems(np.random.default_rng(6), 50)
    one, two = NearestPoint(ROWS), NearestPoint(ROWS)
    for problem in zip(*problems, strict=True):
        first, second = one.solve(*problem), two.solve(*problem)
        assert first.iterations == second.iterations
        assert first.x.tobytes() == second.x.tobytes()
