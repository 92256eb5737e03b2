"""Trajectories against finite differences, known polynomials and SciPy's optimiser; the nominal against expm."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import minimize

from flightstack.trajectory import (
    Boundary,
    NominalGains,
    Polynomial,
    Trajectory,
    figure8,
    hover,
    minimum_snap,
    nominal_step,
    sinusoid,
)
from flightstack.types import F64, FlatOutput

PAPER = sinusoid((0.0, 0.0, -1.5), (1.5, 1.0, 0.5), (0.6, 0.9, 0.6))
COURSE = minimum_snap(
    np.array([[0, 0, -1, 0], [2, 1, -2, 0.5], [3, -1, -1.5, 1.0], [0, 0, -1, 0]], dtype=float),
    np.array([0.0, 1.5, 3.5, 6.0]),
)


def table(point: FlatOutput) -> F64:
    return np.stack([point.pos_ned_m, point.vel_ned_mps, point.acc_ned_mps2, point.jerk_ned_mps3, point.snap_ned_mps4])


@pytest.mark.parametrize("path", [PAPER, figure8(length_m=3.0, width_m=1.5, period_s=8.0, height_m=2.0), COURSE])
@pytest.mark.parametrize("t", [0.3, 1.1, 2.7, 4.9, 5.7])
def test_each_derivative_is_the_slope_of_the_one_before(path: Trajectory, t: float) -> None:
    """Five-point differences, error of fourth order."""
    h = 1e-3
    rows = [table(path.at(t + k * h)) for k in (-2, -1, 1, 2)]
    slope = (rows[0] - 8.0 * rows[1] + 8.0 * rows[2] - rows[3]) / (12.0 * h)
    np.testing.assert_allclose(table(path.at(t))[1:], slope[:-1], rtol=1e-6, atol=1e-6)


def test_the_papers_path_is_the_papers_path() -> None:
    for t in (0.0, 1.0, 33.3):
        wanted = [1.5 * math.sin(0.6 * t), 1.0 * math.sin(0.9 * t), -1.5 + 0.5 * math.sin(0.6 * t)]
        np.testing.assert_allclose(PAPER.at(t).pos_ned_m, wanted)
        assert PAPER.at(t).yaw_rad == 0.0


def test_the_figure_of_eight_is_fastest_in_its_crossing() -> None:
    """x' = 3 w, y' = 3 w at the crossing, w = 2 pi / 8: 3.33 m/s."""
    path = figure8(length_m=3.0, width_m=1.5, period_s=8.0, height_m=2.0)
    w = 2.0 * math.pi / 8.0
    np.testing.assert_allclose(path.at(0.0).vel_ned_mps, [3.0 * w, 3.0 * w, 0.0])
    np.testing.assert_allclose(path.at(8.0).pos_ned_m, [0.0, 0.0, -2.0], atol=1e-12)
    speeds = [float(np.linalg.norm(path.at(t).vel_ned_mps)) for t in np.linspace(0.0, 8.0, 801)]
    assert max(speeds) == pytest.approx(3.0 * w * math.sqrt(2.0))


def test_hover_stands_still_for_ever() -> None:
    path = hover((1.0, 2.0, -3.0), yaw_rad=0.5)
    assert path.duration_s == math.inf
    np.testing.assert_array_equal(table(path.at(1e6))[0], [1.0, 2.0, -3.0])
    np.testing.assert_array_equal(table(path.at(1e6))[1:], 0.0)


def test_one_segment_from_rest_to_rest_has_the_known_coefficients() -> None:
    """35 s^4 - 84 s^5 + 70 s^6 - 20 s^7."""
    path = minimum_snap(np.array([[0, 0, 0, 0], [1.0, -2.0, 0, 0.5]]), np.array([0.0, 3.0]))
    known = np.array([0, 0, 0, 0, 35.0, -84.0, 70.0, -20.0])
    np.testing.assert_allclose(path.coefficients[0, 0], known, atol=1e-9)
    np.testing.assert_allclose(path.coefficients[0, 1], -2.0 * known, atol=1e-9)
    np.testing.assert_allclose(path.coefficients[0, 3], 0.5 * known, atol=1e-9)


def test_inner_knots_are_met_with_continuous_derivatives_up_to_the_sixth() -> None:
    for left in range(2):
        spans = np.diff(COURSE.knots_s)
        for axis in range(4):
            before = np.polynomial.Polynomial(COURSE.coefficients[left, axis])
            after = np.polynomial.Polynomial(COURSE.coefficients[left + 1, axis])
            for order in range(7):
                end = before.deriv(order)(1.0) / spans[left] ** order if order else before(1.0)
                start = after.deriv(order)(0.0) / spans[left + 1] ** order if order else after(0.0)
                assert end == pytest.approx(start, abs=1e-7)


def test_waypoints_are_met_at_their_times_and_the_ends_are_at_rest() -> None:
    np.testing.assert_allclose(COURSE.at(1.5).pos_ned_m, [2, 1, -2], atol=1e-9)
    assert COURSE.at(3.5).yaw_rad == pytest.approx(1.0)
    for t in (0.0, 6.0, 7.0, -1.0):
        np.testing.assert_allclose(table(COURSE.at(t))[1:4], 0.0, atol=1e-8)


def snap_cost(coefficients: F64, spans: F64) -> float:
    """int snap^2 over all segments of one axis, by exact polynomial integration."""
    total = 0.0
    for row, span in zip(coefficients, spans, strict=True):
        snap = np.polynomial.Polynomial(row).deriv(4)
        total += float((snap * snap).integ()(1.0)) / span**7
    return total


def test_scipy_finds_no_cheaper_path_over_the_free_derivatives_at_the_inner_knots() -> None:
    """Each segment is fixed by position to jerk at its ends; those at the inner knots are the optimiser's to choose."""
    spans, points = np.diff(COURSE.knots_s), [0.0, 2.0, 3.0, 0.0]

    def path(inner: F64) -> F64:
        ends = np.zeros((4, 4))
        ends[:, 0] = points
        ends[1:3, 1:] = inner.reshape(2, 3)
        rows = []
        for i, span in enumerate(spans):
            scale = span ** np.arange(4)
            matrix = np.array(
                [
                    [math.perm(n, k) * s ** max(n - k, 0) * (n >= k) for n in range(8)]
                    for s in (0.0, 1.0)
                    for k in range(4)
                ]
            )
            rows.append(np.linalg.solve(matrix, np.concatenate([ends[i] * scale, ends[i + 1] * scale])))
        return np.array(rows)

    ours = snap_cost(COURSE.coefficients[:, 0], spans)
    found = minimize(lambda inner: snap_cost(path(inner), spans), np.zeros(6), method="BFGS", options={"gtol": 1e-6})
    assert ours == pytest.approx(found.fun, rel=1e-6)
    np.testing.assert_allclose(path(found.x), COURSE.coefficients[:, 0], atol=1e-2)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2), st.floats(-1.0, 1.0).filter(lambda size: abs(size) > 1e-3), st.integers(0, 5))
def test_any_feasible_bump_makes_the_path_dearer(segment: int, size: float, power: int) -> None:
    """s^4 (1 - s)^4 s^n keeps positions and derivatives up to the third at both ends of a segment."""
    spans = np.diff(COURSE.knots_s)
    bump = np.polynomial.Polynomial([0, 0, 0, 0, 1.0]) * np.polynomial.Polynomial([1.0, -1.0]) ** 4
    bump = size * bump * np.polynomial.Polynomial([0.0, 1.0]) ** power
    cost = bumped = 0.0
    for i, span in enumerate(spans):
        row = np.polynomial.Polynomial(COURSE.coefficients[i, 0])
        for_snap, bumped_snap = row.deriv(4), (row + bump if i == segment else row).deriv(4)
        cost += float((for_snap * for_snap).integ()(1.0)) / span**7
        bumped += float((bumped_snap * bumped_snap).integ()(1.0)) / span**7
    assert bumped > cost


def test_a_boundary_state_is_met_exactly() -> None:
    state = PAPER.at(0.0)
    path = minimum_snap(
        np.array([[0, 0, -1.5, 0.3], [*state.pos_ned_m, 0.0]]), np.array([0.0, 3.0]), end=Boundary.of(state)
    )
    np.testing.assert_allclose(table(path.at(3.0))[:4], table(state)[:4], atol=1e-9)


def test_times_that_do_not_increase_are_a_programming_error() -> None:
    with pytest.raises(ValueError, match="increasing"):
        minimum_snap(np.zeros((2, 4)), np.array([1.0, 1.0]))


def test_a_polynomial_path_of_many_waypoints_is_still_exact() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-5, 5, (50, 3)), np.zeros(50)])
    path: Polynomial = minimum_snap(points, np.arange(50) * 1.5)
    for i, point in enumerate(points):
        np.testing.assert_allclose(path.at(1.5 * i).pos_ned_m, point[:3], atol=1e-6)


def nominal(correction: F64, pole: float, pos: F64, vel: F64, dt: float, limit: float = 100.0) -> tuple[F64, F64]:
    acc, jerk, zero = np.empty(3), np.empty(3), np.zeros(3)
    nominal_step(correction, np.full(3, pole), np.full(3, limit), (zero, zero, zero, zero), (pos, vel), dt, acc, jerk)
    return acc, jerk


def test_the_nominal_places_a_triple_pole() -> None:
    """A point mass that obeys the nominal's acceleration follows expm of the companion matrix of (s + p)^3."""
    pole, dt = 4.0, 1e-3
    pos, vel, correction = np.array([1.0, -0.5, 0.2]), np.array([0.0, 1.0, -0.3]), np.zeros(3)
    start = np.stack([pos, vel, correction])
    companion = np.array([[0, 1, 0], [0, 0, 1], [-(pole**3), -3 * pole**2, -3 * pole]])
    for _ in range(1000):
        acc, jerk = nominal(correction, pole, pos, vel, dt)
        pos = pos + dt * vel + 0.5 * dt**2 * acc
        vel = vel + dt * acc
    exact = expm(companion) @ start
    np.testing.assert_allclose(np.stack([pos, vel, correction]), exact, atol=6e-3)
    np.testing.assert_allclose(jerk, -companion[2, 0] * -pos - 3 * pole**2 * vel - 3 * pole * correction, atol=0.3)


def test_a_constant_disturbance_leaves_three_times_itself_over_the_pole_squared() -> None:
    pole, dt, disturbance = 5.0, 1e-3, np.array([0.98, 0.0, -2.0])
    pos, vel, correction = np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(6000):
        acc, _ = nominal(correction, pole, pos, vel, dt)
        pos = pos + dt * vel
        vel = vel + dt * (acc + disturbance)
    np.testing.assert_allclose(pos, 3.0 * disturbance / pole**2, atol=1e-3)


def test_the_nominals_correction_stays_within_its_clamp_whatever_the_error() -> None:
    correction = np.zeros(3)
    acc, jerk = nominal(correction, 4.8, np.array([-1e9, 1e9, 0.0]), np.zeros(3), 0.004, limit=5.0)
    np.testing.assert_array_equal(acc, [5.0, -5.0, 0.0])
    np.testing.assert_array_equal(jerk, 0.0)
    acc, _ = nominal(correction, 4.8, np.zeros(3), np.zeros(3), 0.5, limit=5.0)
    assert np.abs(acc).max() < 0.1, "no wind-up: the correction decays as soon as the error is gone"


def test_the_default_gains_are_one_pole_for_all_axes_of_the_plane() -> None:
    north, east, _ = NominalGains().pole_radps
    assert north == east
