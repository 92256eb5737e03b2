"""Attitude control against rotations computed by SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from flightstack.types import F64
from flightstack_sim.autopilot.attitude_control import AttitudeControl, attitude_error, reduced_attitude
from flightstack_sim.autopilot.params import Params


def quaternion(rotation: Rotation) -> F64:
    return np.roll(rotation.as_quat(), 1)


def rotation(q: F64) -> Rotation:
    return Rotation.from_quat(np.roll(q, -1))


vectors = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))


@settings(deadline=None)  # the first call compiles
@given(vectors, vectors)
def test_the_reduced_attitude_points_the_thrust_axis_right_by_the_shortest_turn(
    a: tuple[float, float, float], b: tuple[float, float, float]
) -> None:
    now, goal = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    down_now, down_goal = now.apply([0, 0, 1]), goal.apply([0, 0, 1])
    if np.dot(down_now, down_goal) < -0.999:
        return
    reduced = rotation(reduced_attitude(quaternion(now), quaternion(goal)))
    np.testing.assert_allclose(reduced.apply([0, 0, 1]), down_goal, atol=1e-9)
    angle = math.atan2(np.linalg.norm(np.cross(down_now, down_goal)), np.dot(down_now, down_goal))
    assert (now.inv() * reduced).magnitude() == pytest.approx(angle, abs=1e-7)


@settings(deadline=None)  # the first call compiles
@given(vectors, vectors)
def test_with_full_yaw_weight_the_error_is_the_plain_quaternion_error(
    a: tuple[float, float, float], b: tuple[float, float, float]
) -> None:
    now, goal = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    if np.dot(now.apply([0, 0, 1]), goal.apply([0, 0, 1])) < -0.999:
        return
    x, y, z, w = (now.inv() * goal).as_quat()
    sign = 2.0 if w >= 0.0 else -2.0
    ours = attitude_error(quaternion(now), quaternion(goal), 1.0)
    if abs(w) > 1e-6:  # at half a turn either sign is right
        np.testing.assert_allclose(ours, np.array([x, y, z]) * sign, atol=1e-9)


def test_small_errors_become_rates_by_their_gains_and_yaw_keeps_its_own() -> None:
    control = AttitudeControl(Params())
    goal = Rotation.from_rotvec([0.01, -0.02, 0.03])
    control.step(quaternion(Rotation.identity()), quaternion(goal), 0.0)
    np.testing.assert_allclose(control.rate_setpoint_frd_radps, [4.0 * 0.01, -4.0 * 0.02, 2.8 * 0.03], rtol=0.02)


def test_a_large_yaw_error_turns_no_faster_than_its_limit_and_does_not_tilt() -> None:
    control = AttitudeControl(Params())
    control.step(quaternion(Rotation.identity()), quaternion(Rotation.from_euler("Z", 3.0)), 0.0)
    np.testing.assert_allclose(control.rate_setpoint_frd_radps[:2], 0.0, atol=1e-12)
    assert control.rate_setpoint_frd_radps[2] == pytest.approx(math.radians(200.0))


def test_a_small_yaw_error_on_top_of_a_large_tilt_is_reached_after_the_tilt() -> None:
    """Yaw's share of the commanded rate is its weighted part, divided back by the weight."""
    control = AttitudeControl(Params())
    goal = Rotation.from_euler("XZ", [0.5, 0.0]) * Rotation.from_euler("Z", 0.1)
    control.step(quaternion(Rotation.identity()), quaternion(goal), 0.0)
    rate = control.rate_setpoint_frd_radps
    assert rate[0] == pytest.approx(4.0 * 2.0 * math.sin(0.25), rel=0.01)
    assert 0.0 < rate[2] < 2.8 * 0.11


def test_the_yaw_rate_is_fed_forward_about_the_worlds_down_axis() -> None:
    control = AttitudeControl(Params())
    tilted = Rotation.from_euler("ZYX", [1.0, 0.3, -0.4])
    control.step(quaternion(tilted), quaternion(tilted), 0.5)
    np.testing.assert_allclose(control.rate_setpoint_frd_radps, tilted.inv().apply([0.0, 0.0, 0.5]), atol=1e-9)


def test_upside_down_the_error_is_finite_and_a_half_turn() -> None:
    error = attitude_error(quaternion(Rotation.identity()), quaternion(Rotation.from_euler("X", math.pi)), 0.4)
    assert np.isfinite(error).all()
    assert np.linalg.norm(error) == pytest.approx(2.0)
