"""Control allocation: PX4's mixing matrix, and its saturation on recorded commands."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flightstack.autopilot import effectiveness, mixer
from flightstack.types import F64, InputError
from flightstack.vehicle import Rotors
from flightstack_sim.autopilot.allocation import allocate
from tests.recorded_px4 import read_flight

X_QUAD = Rotors(
    position_m=np.array([[0.2, 0.2, 0.0], [-0.2, -0.2, 0.0], [0.2, -0.2, 0.0], [-0.2, 0.2, 0.0]]),
    torque_ratio_m=np.array([0.02, 0.02, -0.02, -0.02]),
    max_thrust_n=5.0,
    max_speed_radps=1000.0,
    thrust_model_factor=0.0,
    time_constant_s=0.05,
    radius_m=0.12,
)
WIDE = replace(
    X_QUAD, position_m=np.array([[0.13, 0.16, 0.0], [-0.13, -0.16, 0.0], [0.13, -0.16, 0], [-0.13, 0.16, 0]])
)


def _allocate(mix: F64, roll: float, pitch: float, yaw: float, thrust: float) -> tuple[F64, F64]:
    motors, lost = np.full(4, 0.5), np.full(3, 9.0)
    allocate(mix.ravel(), roll, pitch, yaw, thrust, motors, lost)
    return motors, lost


def test_an_x_quad_mixes_as_measured_on_px4() -> None:
    """0.707 for roll and pitch, 1 for yaw and thrust; m1 (-,+,+) m2 (+,-,+) m3 (+,+,-) m4 (-,-,-)."""
    c = math.sqrt(0.5)
    expected = [[-c, c, 1, 1], [c, -c, 1, 1], [c, c, -1, 1], [-c, -c, -1, 1]]
    np.testing.assert_allclose(mixer(X_QUAD), expected, atol=1e-12)


def test_a_unit_of_roll_torque_is_as_many_newton_metres_as_one_of_pitch_on_any_rectangle() -> None:
    moment = effectiveness(WIDE)[:3] @ mixer(WIDE)[:, :3]
    assert moment[0, 0] == pytest.approx(moment[1, 1])
    np.testing.assert_allclose(moment - np.diag(np.diag(moment)), 0.0, atol=1e-12)


@pytest.mark.recorded
def test_motor_commands_equal_px4s_for_every_recorded_torque_and_thrust(recorded: Path) -> None:
    """Some 9000 samples, several hundred of them saturated on the ground and in hard manoeuvres."""
    log, _ = read_flight(recorded)
    torque, thrust, motor = log["vehicle_torque_setpoint"], log["vehicle_thrust_setpoint"], log["actuator_motors"]
    thrust_at = {int(t): i for i, t in enumerate(thrust["timestamp_sample"])}
    motor_at = {int(t): i for i, t in enumerate(motor["timestamp_sample"])}
    mix = mixer(X_QUAD)
    compared = saturated = 0
    for t, xyz in zip(torque["timestamp_sample"].tolist(), torque["xyz"].astype(float), strict=True):
        if t not in thrust_at or t not in motor_at:
            continue
        real = motor["control"][motor_at[t]][:4]
        if np.isnan(real).any():
            continue
        collective = -float(thrust["xyz"][thrust_at[t]][2])
        ours, _ = _allocate(mix, *xyz.tolist(), collective)
        np.testing.assert_allclose(ours, real, atol=1e-6)
        compared += 1
        saturated += bool(real.min() <= 0.0 or real.max() >= 1.0)
    assert compared > 8000
    assert saturated > 300


torques = st.floats(-2.0, 2.0)


@settings(deadline=None)  # the first call compiles
@given(torques, torques, torques, st.floats(-1.0, 2.0))
def test_commands_stay_in_range_and_never_raise_the_collective(
    roll: float, pitch: float, yaw: float, thrust: float
) -> None:
    motors, _ = _allocate(mixer(X_QUAD), roll, pitch, yaw, thrust)
    assert motors.min() >= 0.0
    assert motors.max() <= 1.0
    if 0.3 < thrust < 0.7 and max(abs(roll), abs(pitch)) < 0.1:  # only yaw saturates: nothing is clipped at the end
        assert motors.mean() <= thrust + 1e-9


@settings(deadline=None)  # the first call compiles
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(0.4, 0.6))
def test_without_saturation_the_rotors_give_the_torque_and_thrust_asked_for(
    roll: float, pitch: float, yaw: float, thrust: float
) -> None:
    mix = mixer(WIDE)
    motors, lost = _allocate(mix, roll, pitch, yaw, thrust)
    np.testing.assert_allclose(motors, mix @ [roll, pitch, yaw, thrust], atol=1e-12)
    np.testing.assert_array_equal(lost, 0.0)


def test_yaw_gives_way_before_roll_and_pitch() -> None:
    mix = mixer(X_QUAD)
    motors, lost = _allocate(mix, 0.2, 0.0, 0.8, 0.5)
    given_torque = np.linalg.lstsq(mix[:, :3], motors - motors.mean(), rcond=None)[0]
    assert given_torque[0] == pytest.approx(0.2)
    assert 0.0 < given_torque[2] < 0.5
    assert lost[2] == pytest.approx(0.8 - given_torque[2])
    assert lost[0] == 0.0


def test_full_thrust_still_yaws_a_little() -> None:
    motors, _ = _allocate(mixer(X_QUAD), 0.0, 0.0, 0.5, 1.0)
    np.testing.assert_allclose(motors, [1.0, 1.0, 0.7, 0.7], atol=1e-12)  # 0.15 of headroom, then thrust down by it


def test_full_thrust_gives_way_to_roll() -> None:
    motors, lost = _allocate(mixer(X_QUAD), 0.2, 0.0, 0.0, 1.0)
    assert motors.max() == pytest.approx(1.0)
    assert motors[1] - motors[0] == pytest.approx(2 * 0.2 * math.sqrt(0.5))
    assert lost[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("thrust", [math.nan, math.inf, -math.inf])
def test_a_thrust_that_is_no_number_turns_the_motors_off(thrust: float) -> None:
    motors, lost = _allocate(mixer(X_QUAD), 0.1, 0.1, 0.1, thrust)
    np.testing.assert_array_equal(motors, 0.0)
    np.testing.assert_array_equal(lost, 0.0)


@pytest.mark.parametrize(("asked", "given_"), [(-0.3, 0.0), (1.5, 1.0)])
def test_thrust_is_clipped_to_the_rotors_range(asked: float, given_: float) -> None:
    motors, _ = _allocate(mixer(X_QUAD), 0.0, 0.0, 0.0, asked)
    np.testing.assert_allclose(motors, given_, atol=1e-12)


def test_rotors_that_cannot_turn_the_vehicle_are_refused() -> None:
    in_line = replace(X_QUAD, position_m=np.array([[0.2, 0, 0], [-0.2, 0, 0], [0.1, 0, 0], [-0.1, 0, 0]]))
    with pytest.raises(InputError, match=r"rotors\.position_m"):
        mixer(in_line)
