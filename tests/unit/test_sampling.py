"""Covering a region by samples, against brute force and the figures of the paper's strict variant."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flightstack.barrier.published import Bounds, constant, left_side, on_the_vertical
from flightstack.barrier.sampling import Claim, ClaimSamples, adaptive, crossed, local_margin, project, thinned, uniform
from flightstack.barrier.shapes import Quadratic
from flightstack.types import F64, InputError

FALLING = 9.81
BRAKING = 9.81 * (1.0 - 1.8 / 1.4)
STRICT = crossed(0.6, 0.6, 0.617)


def bounded(doubt: float = 0.0) -> Bounds:
    """The paper's vehicle, less a doubt."""
    return constant(BRAKING + doubt, FALLING - doubt)


def inside(barrier: Quadratic, count: int) -> F64:
    """(n, 2) a dense grid of the region."""
    e, v = np.meshgrid(np.linspace(*barrier.box[:2], count), np.linspace(*barrier.box[2:], count))
    points = np.stack([e.ravel(), v.ravel()], axis=1)
    de, dv = points[:, 0] - barrier.centre_m, points[:, 1] - barrier.centre_mps
    return points[barrier.p11 * de**2 + 2.0 * barrier.p12 * de * dv + barrier.p22 * dv**2 <= 1.0]


@pytest.mark.parametrize(
    ("mu", "cross", "gamma", "margin"), [(0.6, 0.617, 2.0, 1.29), (0.8, 0.82, 2.0, 2.0), (0.8, 0.88, 2.2, 2.19)]
)
def test_the_cross_term_leaves_a_margin_everywhere(mu: float, cross: float, gamma: float, margin: float) -> None:
    barrier = crossed(0.6, mu, cross)
    assert barrier.box[:2] == pytest.approx((-0.6, 0.6))
    worst = float(np.min(Claim(barrier, gamma, bounded()).left(inside(barrier, 1501))))
    assert worst == pytest.approx(margin, abs=0.01)
    assert adaptive(Claim(barrier, gamma, bounded())).closed
    assert adaptive(Claim(barrier, gamma, bounded()), local=True).closed


@pytest.mark.parametrize("local", [False, True])
def test_each_sample_vouches_for_its_ball_and_together_for_the_region(local: bool) -> None:
    claim = Claim(STRICT, 2.0, bounded(0.5))
    found = adaptive(claim, local=local)
    assert found.closed
    _check(claim, found)


@pytest.mark.parametrize("doubt", [0.0, 0.5, 0.8])
def test_fewer_samples_with_larger_balls_still_vouch_for_the_region(doubt: float) -> None:
    claim = Claim(STRICT, 2.0, bounded(doubt))
    found = adaptive(claim, local=True)
    fewer = thinned(claim, found)
    assert len(fewer.points) < 0.8 * len(found.points)
    _check(claim, fewer)
    assert len(fewer.points) <= 0.05 * len(uniform(claim).points)


def _check(claim: Claim, found: ClaimSamples) -> None:
    """Every state of a fine grid lies in a sample's ball, and the condition holds in all of each ball."""
    fine = inside(claim.barrier, 151)
    left = claim.left(fine)
    away = np.hypot(*np.moveaxis(fine[:, None, :] - found.points, 2, 0))
    covered = away <= found.radius * (1.0 + 1e-9)
    assert covered.any(axis=1).all()
    assert np.all(np.where(covered, left[:, None], 0.0) >= 0.0)
    h = left_side(claim.barrier, 1.0, claim.bounds, *found.points.T)
    h = h - left_side(claim.barrier, 0.0, claim.bounds, *found.points.T)
    assert np.all(h >= -1e-9)  # samples lie in the region


@settings(deadline=None, max_examples=40)
@given(st.floats(0.3, 1.5), st.floats(0.0, 0.9), st.floats(0.5, 4.0), st.floats(-0.5, 0.5), st.floats(0.0, 0.6))
def test_what_phi_may_lose_in_a_ball(mu: float, cross: float, gamma: float, centre: float, slope: float) -> None:
    shape = crossed(0.6, mu, cross)
    barrier = Quadratic(0.1 * centre, centre, shape.p11, shape.p12, shape.p22)
    ends = np.array([-8.0, 8.0])
    claim = Claim(barrier, gamma, Bounds(ends, BRAKING + slope * ends, FALLING - slope * ends))
    points = inside(barrier, 9)
    rng = np.random.default_rng(3)
    for radius in (0.02, 0.2):
        turn, far = rng.uniform(0.0, 2.0 * np.pi, 300), radius * np.sqrt(rng.uniform(0.0, 1.0, 300))
        around = points[:, None, :] + np.stack([far * np.cos(turn), far * np.sin(turn)], axis=1)
        left = claim.left(around.reshape(-1, 2)).reshape(len(points), -1)
        assert np.all(left.min(axis=1) >= local_margin(claim, points, radius) - 1e-9)
        e, v = around[..., 0] - barrier.centre_m, around[..., 1] - barrier.centre_mps
        within = barrier.p11 * e * e + 2.0 * barrier.p12 * e * v + barrier.p22 * v * v <= 1.0
        lost = np.where(within, claim.left(points)[:, None] - left, 0.0)
        assert np.all(lost <= claim.modulus * far + 1e-9)


def test_adaptive_takes_a_twentieth_of_the_lemma_s_uniform_grid() -> None:
    """The lemma as it is worded; beside it a grid with the right side halved, as its proof would allow."""
    for doubt, tightest in ((0.0, 0.06), (0.3, 0.05), (0.5, 0.05)):
        claim = Claim(STRICT, 2.0, bounded(doubt))
        grid = uniform(claim)
        lemma = uniform(claim, twofold=True)
        best = adaptive(claim, local=True)
        assert grid.closed
        assert lemma.closed
        assert best.closed
        assert best.evaluated <= 0.05 * len(lemma.points)
        assert len(best.points) <= tightest * len(grid.points)
        assert len(adaptive(claim).points) < 0.5 * len(grid.points)


def test_uniform_is_a_grid_that_proves_the_claim_and_is_no_finer_than_need_be() -> None:
    claim = Claim(STRICT, 2.0, bounded())
    found = uniform(claim)
    _check(claim, found)
    area = STRICT.area_m2ps / (2.0 * found.radius[0] ** 2)
    assert area <= len(found.points) <= 1.25 * area  # cells of the region, and those of its rim
    worst = float(np.min(claim.left(inside(STRICT, 1001))))
    assert 0.9 * worst <= claim.modulus * found.radius[0] <= 1.1 * float(np.min(found.left))


def test_the_published_barrier_is_never_covered_at_its_tips() -> None:
    for mu in (0.6, 0.65, 0.8, 6.3):
        claim = Claim(on_the_vertical(0.6, mu), 2.0, bounded())
        for depth in (12, 16, 20):
            found = adaptive(claim, depth=depth, local=True)
            assert not found.closed
            if mu > 0.6:
                assert 5 <= len(found.open) <= 30  # a handful, at both tips, however fine
                size = 2.0 * max(0.6, 1.0 / math.sqrt(mu)) * 0.5**depth
                reach = 40.0 * size + 1e-9 if depth > 12 else 0.1
                tips = np.minimum(*(np.hypot(*(found.open - [tip, 0.0]).T) for tip in (-0.6, 0.6)))
                assert np.all(tips <= max(reach, 0.02))


def test_samples_are_dense_near_the_boundary_and_for_a_descent() -> None:
    found = adaptive(Claim(STRICT, 2.0, bounded(0.8)))
    e, v = found.points.T
    h = 1.0 - STRICT.p11 * e * e - 2.0 * STRICT.p12 * e * v - STRICT.p22 * v * v
    down, up = found.radius[(h < 0.3) & (v > 0.2)], found.radius[(h < 0.3) & (v < -0.2)]
    assert np.median(down) < 0.5 * np.median(up)
    assert len(down) > 3 * len(up)
    assert np.min(found.radius[h < 0.1]) < 0.3 * np.min(found.radius[h > 0.7])


@settings(deadline=None, max_examples=50)
@given(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(0.0, 0.9))
def test_projection_against_a_dense_boundary(e: float, v: float, cross: float) -> None:
    barrier = crossed(0.6, 0.6, cross)
    found = project(barrier, np.array([[e, v]]))[0]
    if barrier.p11 * e * e + 2.0 * barrier.p12 * e * v + barrier.p22 * v * v <= 1.0:
        assert tuple(found) == (e, v)
        return
    root = np.linalg.inv(np.linalg.cholesky(np.array([[barrier.p11, barrier.p12], [barrier.p12, barrier.p22]]))).T
    middle, reach = 0.0, np.pi
    for _ in range(
        2
    ):  # the second time around the nearest: a state close to the boundary is nearer than two points of it
        angle = middle + np.linspace(-reach, reach, 20001)
        edge = root @ np.stack([np.cos(angle), np.sin(angle)])
        away = np.hypot(edge[0] - e, edge[1] - v)
        nearest, middle, reach = float(away.min()), float(angle[away.argmin()]), 1e-3
    assert math.hypot(found[0] - e, found[1] - v) == pytest.approx(nearest, abs=1e-6)


def test_a_claim_beyond_what_is_known_is_refused() -> None:
    known = Bounds(np.array([-1.0, 1.0]), np.full(2, BRAKING), np.full(2, FALLING))
    with pytest.raises(InputError, match="beyond what the bounds know"):
        Claim(STRICT, 2.0, known)
