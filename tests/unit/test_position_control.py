"""Position control: the cascade's equations, limits and integrators."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flightstack.types import F64
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.position_control import PositionControl

G = 9.80665
NAN = math.nan


def control(**setpoint: tuple[float, float, float] | float) -> PositionControl:
    loop = PositionControl(Params())
    loop.limits[:] = 12.0, 3.0, 1.5, math.radians(45.0)
    loop.setpoint[9] = 0.0
    for name, value in setpoint.items():
        loop.setpoint[{"pos": slice(0, 3), "vel": slice(3, 6), "acc": slice(6, 9), "yaw": 9}[name]] = value
    return loop


def state(pos: tuple[float, ...] = (0, 0, 0), vel: tuple[float, ...] = (0, 0, 0)) -> F64:
    return np.array([*pos, *vel, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def thrust_vector(loop: PositionControl) -> F64:
    """Thrust in NED, normalised: minus body z times the collective."""
    return Rotation.from_quat(np.roll(loop.q_setpoint_ned_frd, -1)).apply([0.0, 0.0, -float(loop.thrust[0])])


def test_at_the_setpoint_it_hovers_level() -> None:
    loop = control(pos=(1.0, 2.0, -3.0))
    loop.step(state((1.0, 2.0, -3.0)))
    assert loop.thrust[0] == pytest.approx(0.5)
    np.testing.assert_allclose(loop.q_setpoint_ned_frd, [1.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_a_position_error_becomes_velocity_acceleration_and_thrust_by_the_documented_gains() -> None:
    """v = P e; a = P_v v; thrust / hover = (a_xy, a_z - g) / g, all at PX4's defaults."""
    loop = control(pos=(0.5, -0.4, -0.3))
    loop.step(state())
    vel = np.array([0.95 * 0.5, -0.95 * 0.4, -1.0 * 0.3])
    np.testing.assert_allclose(loop.vel_setpoint_ned_mps, vel, rtol=1e-6)
    acc = np.array([1.8 * vel[0], 1.8 * vel[1], 4.0 * vel[2]])
    up = 0.5 * (1.0 - acc[2] / G)
    np.testing.assert_allclose(thrust_vector(loop), [up * acc[0] / G, up * acc[1] / G, -up], rtol=1e-6)


def test_velocity_and_acceleration_setpoints_add_to_the_cascade() -> None:
    loop = control(pos=(0.0, NAN, NAN), vel=(0.5, 0.2, NAN), acc=(0.3, NAN, -1.0))
    loop.step(state())
    np.testing.assert_allclose(loop.vel_setpoint_ned_mps[:2], [0.5, 0.2])
    assert math.isnan(loop.vel_setpoint_ned_mps[2])
    up = 0.5 * (1.0 + 1.0 / G)
    expected = [up * (1.8 * 0.5 + 0.3) / G, up * 1.8 * 0.2 / G, -up]
    np.testing.assert_allclose(thrust_vector(loop), expected, rtol=1e-6)


def test_velocity_damps_and_its_derivative_too() -> None:
    loop = control(vel=(0.0, 0.0, 0.0))
    loop.step(state())
    loop.step(state(vel=(0.1, 0.0, 0.0)))
    dt, cut = 0.008, 1.0 / (2.0 * math.pi * 5.0)
    integral = 0.0  # of the first step, whose error was 0
    acc = -1.8 * 0.1 + integral - 0.2 * (0.1 / dt) * dt / (dt + cut)
    assert thrust_vector(loop)[0] == pytest.approx(0.5 * acc / G, rel=1e-5)


def test_speeds_asked_for_are_limited_and_keep_their_direction() -> None:
    loop = control(pos=(300.0, 400.0, -100.0))
    loop.step(state())
    np.testing.assert_allclose(loop.vel_setpoint_ned_mps, [7.2, 9.6, -3.0], rtol=1e-6)
    loop.setpoint[2] = 100.0
    loop.step(state())
    assert loop.vel_setpoint_ned_mps[2] == pytest.approx(1.5)


def test_tilt_never_passes_its_limit_and_thrust_stays_between_its_own() -> None:
    rng = np.random.default_rng(0)
    for tilt_deg in (12.0, 45.0):
        loop = control(pos=(0.0, 0.0, 0.0))
        loop.limits[3] = math.radians(tilt_deg)
        for _ in range(500):
            loop.step(state(tuple(20.0 * rng.standard_normal(3)), tuple(5.0 * rng.standard_normal(3))))
            vector = thrust_vector(loop)
            tilt = math.atan2(math.hypot(vector[0], vector[1]), -vector[2])
            assert tilt <= math.radians(tilt_deg) + 1e-9
            assert 0.12 - 1e-6 <= loop.thrust[0] <= 1.0 + 1e-9


def test_the_body_faces_the_yaw_asked_for_while_it_tilts() -> None:
    for yaw in (-3.0, -1.0, 0.5, 2.0):
        loop = control(acc=(2.0, -1.5, 0.5), yaw=yaw)
        loop.step(state())
        ahead = Rotation.from_quat(np.roll(loop.q_setpoint_ned_frd, -1)).apply([1.0, 0.0, 0.0])
        assert math.atan2(ahead[1], ahead[0]) == pytest.approx(yaw, abs=1e-9)


def test_the_integrator_finds_the_missing_lift_and_the_lateral_force() -> None:
    """A point mass with 0.15 g from the side and only 2/3 of the lift expected: it ends at rest on the setpoint."""
    loop = control(pos=(0.0, 0.0, 0.0))
    pos, vel = np.zeros(3), np.zeros(3)
    for _ in range(5000):
        loop.step(state(tuple(pos), tuple(vel)))
        acc = thrust_vector(loop) / 0.75 * G + [0.15 * G, 0.0, G]
        vel += 0.008 * acc
        pos += 0.008 * vel
    np.testing.assert_allclose(pos, 0.0, atol=1e-3)
    np.testing.assert_allclose(vel, 0.0, atol=1e-3)


def test_integrators_do_not_wind_up_against_the_limits() -> None:
    """Held back for 20 s at full thrust and full tilt, then told to stay: nothing pushes on that way.

    Back-calculation with gain 2/P even pulls back: it settles where P e + I exceeds what is given by P e / 2.
    """
    loop = control(pos=(50.0, 0.0, -50.0))
    for _ in range(2500):
        loop.step(state())
    loop.setpoint[:3] = 0.0
    loop.step(state())
    vector = thrust_vector(loop)
    assert -0.5 < vector[0] < 0.01
    assert -vector[2] < 0.75


def test_a_reset_forgets_the_integrals() -> None:
    loop = control(pos=(1.0, 0.0, 0.0))
    for _ in range(200):
        loop.step(state())
    loop.reset()
    loop.setpoint[:3] = 0.0
    loop.step(state())
    np.testing.assert_allclose(thrust_vector(loop), [0.0, 0.0, -0.5], atol=1e-12)
