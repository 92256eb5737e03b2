"""Prediction of the latest samples to now, against motions whose exact course is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from flightstack.frames import quat_from_euler
from flightstack.predictor import Streams, predict

LEVEL = (1.0, 0.0, 0.0, 0.0)
REST = (0.0, 0.0, 0.0)
HOVER = (0.0, 0.0, -9.80665)


def streams(
    *, q: tuple[float, ...] = LEVEL, rate: tuple[float, float, float] = REST, attitude_us: int = 0,
    pos: tuple[float, float, float] = REST, vel: tuple[float, float, float] = REST, position_us: int = 0,
    accel: tuple[float, float, float] = HOVER, gyro: tuple[float, float, float] = REST, imu_us: int = 0,
) -> Streams:  # fmt: skip
    made = Streams()
    made.attitude(attitude_us, (q[0], q[1], q[2], q[3]), rate)
    made.position(position_us, pos, vel)
    made.imu(imu_us, accel, gyro)
    return made


def test_a_hovering_vehicle_stays_where_it_is_and_every_age_is_told() -> None:
    m = predict(streams(pos=(1.0, 2.0, -3.0), attitude_us=3000, position_us=1000, imu_us=5000), 9000)
    assert m is not None
    np.testing.assert_allclose(m.pos_ned_m, [1.0, 2.0, -3.0], atol=1e-12)
    np.testing.assert_allclose(m.vel_ned_mps, 0.0, atol=1e-12)
    assert (m.t_us, m.attitude_age_us, m.position_age_us, m.imu_age_us) == (9000, 6000, 8000, 4000)
    assert np.isnan(m.motor_command).all()


def test_nothing_is_predicted_until_attitude_position_and_imu_have_been_heard() -> None:
    made = Streams()
    assert predict(made, 0) is None
    made.attitude(0, LEVEL, REST)
    made.imu(0, HOVER, REST)
    assert predict(made, 0) is None
    made.position(0, REST, REST)
    assert predict(made, 0) is not None


def test_a_constant_acceleration_is_followed_exactly() -> None:
    """Tilted by 0.3 rad with 12 m/s^2 of thrust: x = v t + a t^2 / 2 in each axis."""
    q = quat_from_euler(0.3, 0.0, 0.0)
    m = predict(streams(q=tuple(q), vel=(1.0, 0.0, 0.0), accel=(0.0, 0.0, -12.0)), 20_000)
    assert m is not None
    acc = np.array([0.0, 12.0 * math.sin(0.3), 9.80665 - 12.0 * math.cos(0.3)])
    np.testing.assert_allclose(m.vel_ned_mps, [1.0, 0.0, 0.0] + 0.02 * acc, atol=1e-12)
    np.testing.assert_allclose(m.pos_ned_m, [0.02, 0.0, 0.0] + 0.5 * 0.02**2 * acc, atol=1e-12)


@settings(deadline=None)
@given(
    st.tuples(*[st.floats(-6.0, 6.0)] * 3), st.tuples(*[st.floats(-1.2, 1.2)] * 3), st.integers(0, 30_000)
)  # fmt: skip
def test_a_constant_rotation_is_followed_exactly(
    rate: tuple[float, float, float], euler: tuple[float, float, float], age_us: int
) -> None:
    """SciPy's rotations as the oracle: R exp(omega t)."""
    q = quat_from_euler(*euler)
    m = predict(streams(q=tuple(q), rate=rate, gyro=rate), age_us)
    assert m is not None
    wanted = Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(np.array(rate) * age_us * 1e-6)
    found = Rotation.from_quat(m.q_ned_frd, scalar_first=True)
    assert (wanted.inv() * found).magnitude() < 1e-9


def test_a_gyro_newer_than_the_attitude_is_the_rate_and_half_of_the_turn() -> None:
    m = predict(streams(rate=(0.0, 0.0, 1.0), gyro=(0.0, 0.0, 2.0), imu_us=8000), 10_000)
    assert m is not None
    assert m.rate_frd_radps[2] == 2.0
    assert 2.0 * math.atan2(m.q_ned_frd[3], m.q_ned_frd[0]) == pytest.approx(1.5 * 0.01)
    older = predict(streams(rate=(0.0, 0.0, 1.0), gyro=(0.0, 0.0, 2.0), attitude_us=8000), 10_000)
    assert older is not None
    assert older.rate_frd_radps[2] == 1.0


def test_a_sample_that_arrives_late_does_not_replace_a_newer_one() -> None:
    made = streams(pos=(1.0, 0.0, 0.0), position_us=5000)
    made.position(4000, (9.0, 9.0, 9.0), REST)
    made.motors(10, (0.1, 0.2, 0.3, 0.4))
    made.motors(5, (0.9, 0.9, 0.9, 0.9))
    m = predict(made, 5000)
    assert m is not None
    np.testing.assert_array_equal(m.pos_ned_m, [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(m.motor_command, [0.1, 0.2, 0.3, 0.4])


def test_an_old_sample_is_carried_50_ms_and_no_farther() -> None:
    m = predict(streams(vel=(2.0, 0.0, 0.0)), 10_000_000)
    assert m is not None
    assert m.pos_ned_m[0] == pytest.approx(0.1)
    assert m.position_age_us == 10_000_000


def test_a_sample_from_the_future_is_not_carried_backwards() -> None:
    m = predict(streams(vel=(2.0, 0.0, 0.0), position_us=9000), 1000)
    assert m is not None
    assert m.pos_ned_m[0] == 0.0


@settings(deadline=None)
@given(st.tuples(*[st.floats()] * 4), st.tuples(*[st.floats()] * 3))
def test_whatever_was_sent_nothing_raises(q: tuple[float, ...], anything: tuple[float, float, float]) -> None:
    made = streams(q=q, rate=anything, pos=anything, vel=anything, accel=anything, gyro=anything)
    assert predict(made, 4000) is not None


def test_a_measurement_keeps_its_numbers_when_the_next_sample_comes() -> None:
    made = streams(pos=(1.0, 0.0, 0.0))
    m = predict(made, 0)
    made.position(1, (2.0, 0.0, 0.0), REST)
    assert m is not None
    assert m.pos_ned_m[0] == 1.0
