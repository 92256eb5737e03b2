"""Flatness for any reference: there and back, rigid rotations, and SciPy flying the result."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from flightstack.flatness import to_body, to_flat
from flightstack.frames import quat_to_matrix
from flightstack.trajectory import Sinusoid, Trajectory, figure8, minimum_snap, sinusoid
from flightstack.types import F64, FlatOutput, changed

G = 9.80665


def vectors(size: float) -> st.SearchStrategy[F64]:
    return arrays(np.float64, 3, elements=st.floats(-size, size))


FLAT = st.builds(
    FlatOutput.of, vectors(10.0), vectors(10.0), vectors(6.0), vectors(30.0), vectors(100.0),
    st.floats(-math.pi, math.pi), st.floats(-2.0, 2.0),
)  # fmt: skip


@settings(max_examples=300, deadline=None)
@given(FLAT, st.floats(0.02, 50.0), st.floats(0.0, 0.5), vectors(2.0), vectors(2.0))
def test_there_and_back_gives_acceleration_jerk_yaw_and_yaw_rate(
    flat: FlatOutput, mass: float, drag_per_kg: float, learned: F64, learned_rate: F64
) -> None:
    drag = (drag_per_kg * mass, drag_per_kg * mass, 0.3 * drag_per_kg * mass)
    thrust_axis = learned - flat.acc_ned_mps2 - drag_per_kg * flat.vel_ned_mps + [0.0, 0.0, G]
    assume(thrust_axis[2] > 0.5)  # upright: nothing is left to the hint
    body = to_body(flat, mass_kg=mass, drag_kgps=drag, learned_acc_ned_mps2=learned, learned_jerk_ned_mps3=learned_rate)
    back = to_flat(
        body, mass_kg=mass, vel_ned_mps=flat.vel_ned_mps, drag_kgps=drag, learned_acc_ned_mps2=learned,
        learned_jerk_ned_mps3=learned_rate,
    )  # fmt: skip
    assume(abs(quat_to_matrix(body.q_ned_frd)[2, 0]) < 0.999)
    np.testing.assert_allclose(back.acc_ned_mps2, flat.acc_ned_mps2, atol=1e-9)
    np.testing.assert_allclose(back.jerk_ned_mps3, flat.jerk_ned_mps3, atol=1e-7)
    sine = abs(thrust_axis @ [-math.sin(flat.yaw_rad), math.cos(flat.yaw_rad), 0.0]) / np.linalg.norm(thrust_axis)
    assume(sine < 0.99)
    assert math.remainder(back.yaw_rad - flat.yaw_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert back.yaw_rate_radps == pytest.approx(flat.yaw_rate_radps, abs=1e-7)


ANY = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6)
ANY3 = arrays(np.float64, 3, elements=ANY)
QUATERNION = (
    arrays(np.float64, 4, elements=st.floats(-1.0, 1.0))
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)


@settings(max_examples=300, deadline=None)
@given(st.builds(FlatOutput.of, ANY3, ANY3, ANY3, ANY3, ANY3, ANY, ANY), QUATERNION)
def test_every_finite_reference_gives_a_rotation_and_finite_numbers(flat: FlatOutput, hint: F64) -> None:
    body = to_body(flat, mass_kg=1.0, hint_q_ned_frd=hint)
    numbers = [body.thrust_n, body.thrust_rate_nps, *body.rate_frd_radps, *body.angular_acceleration_frd_radps2]
    assert np.isfinite(numbers).all()
    assert np.linalg.norm(body.q_ned_frd) == pytest.approx(1.0, abs=1e-9)


@settings(max_examples=100, deadline=None)
@given(QUATERNION, st.sampled_from([0.0, 0.5, 2.0]))
def test_thrust_axes_all_round_the_sphere_are_met_exactly(attitude: F64, yaw: float) -> None:
    """Also horizontal and inverted ones, where Euler angles fail."""
    z = quat_to_matrix(attitude)[:, 2]
    zero = np.zeros(3)
    flat = FlatOutput.of(zero, zero, np.array([0.0, 0.0, G]) - 8.0 * z, zero, zero, yaw)
    body = to_body(flat, mass_kg=1.0, hint_q_ned_frd=attitude)
    np.testing.assert_allclose(quat_to_matrix(body.q_ned_frd)[:, 2], z, atol=1e-7)
    assert body.thrust_n == pytest.approx(8.0)


TURNING = minimum_snap(
    np.array([[0, 0, -1, 0], [2, 1, -2, 1.0], [3, -2, -1.5, -0.5]], dtype=float), np.array([0.0, 2.0, 4.5])
)
PATHS: list[tuple[Trajectory, float, tuple[float, float, float]]] = [
    (figure8(length_m=3.0, width_m=1.5, period_s=8.0, height_m=2.0), 8.0, (0.0, 0.0, 0.0)),
    (sinusoid((0.0, 0.0, -1.5), (1.5, 1.0, 0.5), (1.6, 1.9, 2.6), yaw_rad=0.6), 5.0, (0.5, 0.5, 0.2)),
    (TURNING, 4.5, (0.3, 0.3, 0.3)),
]


@pytest.mark.parametrize(("path", "duration_s", "drag"), PATHS)
def test_thrust_and_body_rates_alone_fly_the_path(
    path: Trajectory, duration_s: float, drag: tuple[float, float, float]
) -> None:
    """SciPy integrates point mass and attitude from the first state with nothing but thrust and rates fed in."""
    mass = 1.2
    first = path.at(0.0)
    start = to_body(first, mass_kg=mass, drag_kgps=drag)
    state = np.concatenate([first.pos_ned_m, first.vel_ned_mps, quat_to_matrix(start.q_ned_frd).ravel()])

    def motion(t: float, x: F64) -> F64:
        body = to_body(path.at(t), mass_kg=mass, drag_kgps=drag)
        r = x[6:].reshape(3, 3)
        wx, wy, wz = body.rate_frd_radps
        spin = np.array([[0.0, -wz, wy], [wz, 0.0, -wx], [-wy, wx, 0.0]])
        acc = np.array([0.0, 0.0, G]) - (body.thrust_n * r[:, 2] + r @ np.diag(drag) @ r.T @ x[3:6]) / mass
        return np.concatenate([x[3:6], acc, (r @ spin).ravel()])

    end = solve_ivp(motion, (0.0, duration_s), state, rtol=1e-9, atol=1e-10, max_step=0.05).y[:, -1]
    last = path.at(duration_s)
    np.testing.assert_allclose(end[:3], last.pos_ned_m, atol=1e-5)
    np.testing.assert_allclose(end[3:6], last.vel_ned_mps, atol=1e-5)
    goal = quat_to_matrix(to_body(last, mass_kg=mass, drag_kgps=drag).q_ned_frd)
    assert Rotation.from_matrix(end[6:].reshape(3, 3).T @ goal).magnitude() < 1e-6


@settings(max_examples=40, deadline=None)
@given(st.floats(0.1, 4.4), st.sampled_from([path for path, _, _ in PATHS[:2]]))
def test_angular_acceleration_and_thrust_rate_are_the_derivatives_of_rates_and_thrust(t: float, path: Sinusoid) -> None:
    """Central differences, with drag and a heading that turns evenly (yaw acceleration is no flat output here)."""
    h = 1e-5
    before, now, after = (
        to_body(changed(path.at(s), yaw_rad=0.2 + 0.7 * s, yaw_rate_radps=0.7), mass_kg=1.2, drag_kgps=(0.3, 0.3, 0.1))
        for s in (t - h, t, t + h)
    )
    slope = (after.rate_frd_radps - before.rate_frd_radps) / (2 * h)
    np.testing.assert_allclose(now.angular_acceleration_frd_radps2, slope, atol=1e-6)
    assert now.thrust_rate_nps == pytest.approx((after.thrust_n - before.thrust_n) / (2 * h), abs=1e-6)
