"""Example 1: the published digits' defects and our own regions; oracles: closed forms, Monte Carlo, SciPy alone."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import minimize

from flightstack.types import F64, InputError
from flightstack_paper import example1, sos
from flightstack_paper.exact import ExactPolynomial, Proof, as_ellipse, check, leading_minors
from flightstack_paper.example1 import FIELD, Example1, ExampleRegion


@pytest.fixture(scope="module")
def result() -> Example1:
    return example1.evaluate()


@pytest.fixture(scope="module")
def found() -> dict[str, Proof]:
    return example1.find_proofs()


def slope(x: F64) -> F64:
    """The system, written once more; (2, ...) to (2, ...)."""
    return np.array([x[1] + 0.8 * x[1] ** 2, -x[0] - x[1] + x[0] ** 2 * x[1]])


def v_star(x: F64) -> F64:
    return np.asarray(1.343 * x[0] ** 2 + 0.5155 * x[0] * x[1] + 1.152 * x[1] ** 2)


def h_star(x: F64) -> F64:
    one = 1.0 - 0.4254 * x[0] - 0.3248 * x[1] - 0.7549 * x[1] ** 2 - 0.8616 * x[0] ** 2 - 0.2846 * x[0] * x[1]
    return np.asarray(one)


def matrix(polynomial: ExactPolynomial) -> tuple[F64, F64, float]:
    """P, centre and level, anew from the coefficients."""
    p = -np.array([[float(polynomial[2, 0]), float(polynomial[1, 1]) / 2.0], [0.0, float(polynomial[0, 2])]])
    p[1, 0] = p[0, 1]
    centre = np.linalg.solve(2.0 * p, [float(polynomial[1, 0]), float(polynomial[0, 1])])
    return p, centre, float(polynomial[0, 0]) + centre @ p @ centre


def sampled_rates(polynomial: ExactPolynomial, count: int = 400_000) -> tuple[F64, F64]:
    """hdot = -2 (x - c)^T P f on the boundary, and the boundary, by polar angle."""
    p, centre, level = matrix(polynomial)
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    ray = np.stack([np.cos(angle), np.sin(angle)])
    x = centre[:, None] + ray * np.sqrt(level / np.einsum("ik,ij,jk->k", ray, p, ray))
    return -2.0 * np.einsum("ik,ij,jk->k", x - centre[:, None], p, slope(x)), x


def regions(result: Example1) -> tuple[ExampleRegion, ...]:
    return (
        result.published_lyapunov,
        result.published_barrier,
        result.lowered_lyapunov,
        result.lowered_barrier,
        result.lyapunov,
        result.barrier,
    )


def test_published_areas_and_ratio(result: Example1) -> None:
    assert result.published_lyapunov.area == pytest.approx(2.58176, abs=1e-5)
    assert result.published_barrier.area == pytest.approx(4.25294, abs=1e-5)
    assert result.lowered_lyapunov.area == pytest.approx(2.5803, abs=1e-4)
    assert result.lowered_barrier.area == pytest.approx(4.2511, abs=1e-4)
    assert result.ratio_published == pytest.approx(1.647, abs=5e-4)
    assert result.ratio == pytest.approx(1.672, abs=1e-3)


def test_areas_agree_with_counting_points(result: Example1) -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-2.0, 2.0, (2, 1_000_000))
    hits = [np.mean(v_star(x) <= 1.0), np.mean(h_star(x) >= 0.0)]
    hits += [np.mean(example1.values(region.h, x.T) >= 0.0) for region in (result.lyapunov, result.barrier)]
    areas = [result.published_lyapunov.area, result.published_barrier.area, result.lyapunov.area, result.barrier.area]
    for share, area in zip(hits, areas, strict=True):
        assert 16.0 * share == pytest.approx(area, abs=5.0 * 16.0 * np.sqrt(share * (1.0 - share) / x.shape[1]))


def test_motion_leaves_the_published_regions(result: Example1) -> None:
    lyapunov, barrier = result.published_lyapunov, result.published_barrier
    assert lyapunov.least_rate == pytest.approx(-2.96e-4, abs=1e-6)
    assert lyapunov.least_rate_at == pytest.approx((0.614, 0.532), abs=1e-3)
    assert lyapunov.outward_share == pytest.approx(0.0046, abs=1e-4)
    assert barrier.least_rate == pytest.approx(-2.5e-5, abs=1e-6)
    assert barrier.least_rate_at == pytest.approx((-1.236, 0.544), abs=1e-3)
    for region in (lyapunov, barrier):
        assert region.refuted
        assert region.proven_rate is None


def test_boundary_rates_agree_with_sampling_by_another_angle(result: Example1) -> None:
    for region in regions(result):
        rates, x = sampled_rates(region.h)
        assert region.least_rate == pytest.approx(rates.min(), abs=1e-8)
        # the least rate may be taken at more than one place; the one named has it
        away = np.hypot(*(x - np.array(region.least_rate_at)[:, None]))
        assert rates[away.argmin()] == pytest.approx(rates.min(), abs=1e-7)


def test_what_is_proven_is_seen_and_nothing_proven_is_refuted(result: Example1) -> None:
    for region in regions(result)[2:]:
        assert region.proven_rate is not None
        assert 0.0 < float(region.proven_rate) <= sampled_rates(region.h)[0].min()
        assert not region.refuted
        assert region.outward_share == 0.0
    for region in (result.lyapunov, result.barrier):
        assert region.proven_rate == Fraction(1, 2000)


def test_lowered_regions_are_the_published_ones_at_a_lower_level(result: Example1) -> None:
    x = np.random.default_rng(2).uniform(-2.0, 2.0, (2, 200))
    scaled = (1.0 - 5.7e-4) * example1.values(result.lowered_lyapunov.h, x.T)
    np.testing.assert_allclose(scaled, 1.0 - 5.7e-4 - v_star(x), atol=1e-12)
    np.testing.assert_allclose(example1.values(result.lowered_barrier.h, x.T), h_star(x) - 4.7e-4, atol=1e-12)


def test_our_regions_are_larger(result: Example1) -> None:
    assert result.barrier.area >= 4.32
    assert result.lyapunov.area >= 2.585
    for region in (result.lyapunov, result.barrier):
        p, _, level = matrix(region.h)
        assert np.pi * level / np.sqrt(np.linalg.det(p)) == pytest.approx(region.area, rel=1e-12)


def test_our_lyapunov_function_falls_in_all_of_its_region(result: Example1) -> None:
    p, centre, _ = matrix(result.lyapunov.h)
    assert not centre.any()
    x = np.random.default_rng(3).uniform(-1.3, 1.3, (2, 400_000))
    v = np.einsum("ik,ij,jk->k", x, p, x)
    fall = -2.0 * np.einsum("ik,ij,jk->k", x, p, slope(x))
    inside = v <= 1.0
    assert inside.sum() > 100_000
    assert (fall[inside] >= v[inside] / 2000.0).all()


def largest_by_sampling(rate: float, radius: float, *, centred: bool) -> float:
    """Area of the largest ellipse by constraints on 3000 points of its boundary, x = c + L u, from a circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, 3000, endpoint=False)
    u = np.stack([np.cos(angle), np.sin(angle)])

    def rates(q: F64) -> F64:
        root = np.array([[q[0], 0.0], [q[1], q[2]]])
        return np.asarray(-2.0 * (u * np.linalg.solve(root, slope(q[3:, None] + root @ u))).sum(axis=0) - rate)

    def size(q: F64) -> float:
        return -float(np.log(q[0] * q[2]))

    place = (0.0, 0.0) if centred else (-1.0, 1.0)
    solved = minimize(
        size, [radius, 0.0, radius, 0.0, 0.0], method="SLSQP",
        bounds=[(0.1, 3.0), (-2.0, 2.0), (0.1, 3.0), place, place],
        constraints={"type": "ineq", "fun": rates}, options={"ftol": 1e-12, "maxiter": 300},
    )  # fmt: skip
    assert rates(solved.x).min() > -1e-9
    return float(np.pi * solved.x[0] * solved.x[2])


@pytest.mark.parametrize("radius", [0.3, 0.5, 0.8])
def test_the_search_agrees_with_an_optimiser_that_knows_no_squares(result: Example1, radius: float) -> None:
    rate = 1.1 / 2000.0  # what the search asks for, so that a proof of 1 / 2000 has room
    assert largest_by_sampling(rate, radius, centred=False) == pytest.approx(result.barrier.area, abs=1e-4)
    assert largest_by_sampling(rate, radius, centred=True) == pytest.approx(result.lyapunov.area, abs=1e-4)


def test_searching_anew_finds_the_shipped_regions(found: dict[str, Proof]) -> None:
    shipped = example1.proofs()
    for name in example1.NAMES:
        assert check(found[name], FIELD) == []
        assert as_ellipse(found[name].h).area == pytest.approx(as_ellipse(shipped[name].h).area, abs=1e-4)
    other = sos.invariant_ellipse(FIELD, example1.RATE_PS, starts=3, seed=11)
    assert other.area == pytest.approx(as_ellipse(shipped["barrier"].h).area, abs=1e-4)
    assert max(other.areas) - min(other.areas) < 1e-4


def test_shipped_proofs_hold_exactly() -> None:
    for name, proof in example1.proofs().items():
        assert check(proof, FIELD) == [], name
        assert all(minor > 0 for minor in leading_minors(proof.gram))
        assert len(leading_minors(proof.gram)) == len(proof.basis)


@pytest.mark.parametrize("name", example1.NAMES)
def test_a_shipped_proof_with_any_gram_entry_touched_fails(name: str) -> None:
    proof = example1.proofs()[name]
    for i in range(len(proof.gram)):
        for j in range(len(proof.gram)):
            rows = [list(row) for row in proof.gram]
            rows[i][j] += Fraction(1, 10**20)
            rows[j][i] = rows[i][j]
            assert check(replace(proof, gram=tuple(map(tuple, rows))), FIELD)


@pytest.mark.parametrize("name", example1.NAMES)
def test_a_shipped_proof_rounded_fails(name: str) -> None:
    proof = example1.proofs()[name]
    rounded = tuple(tuple(Fraction(float(value)) for value in row) for row in proof.gram)
    assert any("identity" in fault for fault in check(replace(proof, gram=rounded), FIELD))


def test_a_proof_is_of_one_system_only() -> None:
    field = (FIELD[0], FIELD[1] + ExactPolynomial({(1, 0): Fraction(1, 10**15)}))
    for proof in example1.proofs().values():
        assert check(proof, field)


def runge_kutta(x: F64, step: float, count: int) -> list[F64]:
    """The classic fourth-order method; every state on the way."""
    states = [x]
    for _ in range(count):
        a = slope(x)
        b = slope(x + 0.5 * step * a)
        c = slope(x + 0.5 * step * b)
        x = x + step / 6.0 * (a + 2.0 * b + 2.0 * c + slope(x + step * c))
        states.append(x)
    return states


def test_motions_from_the_published_boundary_leave_a_little_and_all_converge(result: Example1) -> None:
    outward = example1.boundary(result.published_lyapunov.h, 1000)
    start_rates = example1.values(example1.along(result.published_lyapunov.h, FIELD), outward)
    assert (start_rates < 0.0).sum() == 5
    assert 5 <= result.flow_lyapunov.left <= 10  # those five, and some that start just before the outward part
    assert -1e-5 < result.flow_lyapunov.worst_h < -1e-7
    assert -1e-6 < result.flow_barrier.worst_h < -1e-8
    assert result.flow_found.left == 0
    for flow in (result.flow_lyapunov, result.flow_barrier, result.flow_found):
        assert flow.starts == flow.converged == 1000


def test_motions_agree_with_another_integrator(result: Example1) -> None:
    for region, ours in ((result.published_lyapunov, result.flow_lyapunov), (result.barrier, result.flow_found)):
        p, centre, level = matrix(region.h)
        angle = 2.0 * np.pi * np.arange(1000) / 1000
        circle = np.stack([np.cos(angle), np.sin(angle)])
        starts = centre[:, None] + np.sqrt(level) * np.linalg.cholesky(np.linalg.inv(p)) @ circle
        early = np.array(runge_kutta(starts, 1e-3, 1000)) - centre[:, None]
        least = (level - np.einsum("tik,ij,tjk->tk", early, p, early)).min(axis=0)
        assert ours.left == (least < -1e-9).sum()
        assert ours.worst_h == pytest.approx(least.min(), rel=1e-3, abs=1e-14)
        last = runge_kutta(starts, 0.01, 6000)[-1]
        assert ours.converged == (np.hypot(*last) < 1e-3).sum() == 1000


def test_the_figures_points_lie_where_they_should(result: Example1) -> None:
    for region in regions(result):
        np.testing.assert_allclose(example1.values(region.h, region.boundary), 0.0, atol=1e-12)
    assert result.motions.shape == (24, 801, 2)
    inside = example1.values(result.barrier.h, result.motions)
    assert inside[:, 0] == pytest.approx(np.zeros(24), abs=1e-12)
    assert (inside[:, 1:] > 0.0).all()
    assert (np.hypot(*result.motions[:, -1].T) < 1e-2).all()


def test_a_wrong_file_is_named(found: dict[str, Proof]) -> None:
    text = example1.proofs_to_json(found)
    assert example1.proofs_from_json(text, "f.json") == found
    data = json.loads(text)
    for spoiled in ("{", "[]", json.dumps({**data, "schema": "x"}), json.dumps({**data, "barrier": 1})):
        with pytest.raises(InputError, match=r"f\.json: "):
            example1.proofs_from_json(spoiled, "f.json")
    with pytest.raises(InputError, match="barrier: the identity fails"):
        example1.measured("barrier", found["barrier"].h, replace(found["barrier"], rate_ps=Fraction(1, 1999)))
