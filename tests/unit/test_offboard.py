"""Offboard setpoints, from the message to the motors; the oracle is a real PX4, measured."""

from __future__ import annotations

import math

import pytest
from station import (
    ARM,
    HOSTILE,
    MODE,
    NAN,
    OFFBOARD_MODE,
    Station,
    airborne,
    position_setpoint,
    rates_setpoint,
    velocity_setpoint,
)

from mavlink_bridge import messages as m
from tests.branches import branching


@pytest.fixture(scope="module")
def booted() -> Station:
    return Station().boot()


@pytest.fixture
def station(booted: Station, request: pytest.FixtureRequest) -> Station:
    branching(request)
    return booted


@pytest.fixture(scope="module")
def risen() -> Station:
    station = airborne()
    station.clear()
    return station


@pytest.fixture
def flying(risen: Station, request: pytest.FixtureRequest) -> Station:
    branching(request)
    return risen


RATE, ATTITUDE, NONE = "rate", "attitude", "no signal"


@pytest.mark.parametrize(
    ("mask", "meaning"),
    [
        (128, RATE), (132, RATE), (192, RATE), (196, RATE), (160, RATE), (7, ATTITUDE), (0, ATTITUDE), (71, ATTITUDE),
        (1, ATTITUDE), (32, ATTITUDE), (129, NONE), (130, NONE), (131, NONE), (135, NONE), (255, NONE), (193, NONE),
    ],
)  # fmt: skip
def test_a_type_mask_is_a_signal_and_controls_what_px4_says(station: Station, mask: int, meaning: str) -> None:
    station.stream = rates_setpoint(0.0, mask=mask)
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    assert station.command(ARM, 1.0) == ([1] if meaning is NONE else [0])
    if meaning is not NONE:
        station.run(1.1)
        assert station.last(m.Heartbeat).base_mode == (0x81 if meaning is RATE else 0x91)


@pytest.mark.parametrize(
    ("thrust", "mask", "pwm"),
    [
        (0.0, 128, 1000), (-0.3, 128, 1000), (1.5, 128, 2000), (0.4, 128, 1400), (0.4, 132, 1400), (0.4, 160, 1400),
        (0.4, 192, 1000), (0.4, 196, 1000), (math.nan, 128, 900), (math.inf, 128, 900), (1e30, 128, 2000),
    ],
)  # fmt: skip
def test_thrust_reaches_the_motors_as_on_px4(station: Station, thrust: float, mask: int, pwm: int) -> None:
    """On the ground, so that the rates stay 0 and the mixing adds next to nothing."""
    station.stream = rates_setpoint(0.0)
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    station.command(ARM, 1.0)
    station.stream = rates_setpoint(thrust, (0.0, 0.0, NAN), mask)
    station.run(0.12)
    station.command(512, 36.0)
    motors = station.last(m.ServoOutputRaw).pwm_us
    assert motors[:4] == pytest.approx((pwm,) * 4, abs=30)
    assert motors[4:] == (900,) * 12


def test_hover_thrust_is_weight_over_four_rotors(flying: Station) -> None:
    """m g / (4 T_max) of the vehicle file, 0.4903; PX4 itself hovered at 0.487 to 0.492."""
    flying.run(4.0)
    flying.clear()
    flying.run(2.0)
    pwm = [sum(message.pwm_us[:4]) / 4 for message in flying.all(m.ServoOutputRaw)]
    assert sum(pwm) / len(pwm) == pytest.approx(1000 + 490.3, abs=8)


def test_a_setpoint_received_before_a_tick_acts_in_it(station: Station) -> None:
    station.stream = rates_setpoint(0.0)
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    station.command(ARM, 1.0)
    assert max(station.vehicle.motor_command) < 0.05
    station.stream = rates_setpoint(0.4)
    station.tick()
    assert min(station.vehicle.motor_command) > 0.35


def test_setpoints_act_only_in_offboard(station: Station) -> None:
    station.command(ARM, 1.0)
    station.stream = rates_setpoint(0.9)
    station.run(1.0)
    assert station.state.mode.title == "Hold"
    assert max(station.vehicle.motor_command) < 0.2
    assert station.last(m.ExtendedSysState).landed_state == 1


@pytest.mark.parametrize("target", [(2, 1), (1, 2), (2, 2), (1, 191)])
def test_setpoints_for_somebody_else_are_no_signal(station: Station, target: tuple[int, int]) -> None:
    station.stream = rates_setpoint()._replace(target_system=target[0], target_component=target[1])
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    assert station.command(ARM, 1.0) == [1]


def test_throttle_ignored_in_hover_stops_the_motors_and_it_falls(flying: Station) -> None:
    """PX4: 0.6 s of mask 196 in hover, motors at 1000, falling at 3.7 m/s."""
    flying.vehicle.params.set("COM_DISARM_LAND", -1.0)
    flying.stream = rates_setpoint(0.49, mask=196)
    flying.run(0.4)
    flying.command(512, 36.0)
    assert flying.last(m.ServoOutputRaw).pwm_us[:4] == pytest.approx((1000,) * 4, abs=40)
    assert flying.vehicle.plant.truth().vel_ned_mps[2] == pytest.approx(3.7 * 0.4 / 0.6, rel=0.35)


def test_velocity_setpoints_fly_at_that_velocity(flying: Station) -> None:
    flying.stream = velocity_setpoint(1.0, -0.5, 0.0)
    flying.run(5.0)
    assert flying.vehicle.plant.truth().vel_ned_mps == pytest.approx((1.0, -0.5, 0.0), abs=0.15)


def test_body_frame_velocities_turn_with_the_heading(flying: Station) -> None:
    flying.stream = position_setpoint(0.0, 0.0, -2.5)._replace(yaw_rad=math.pi / 2)
    flying.run(6.0)
    flying.stream = velocity_setpoint(1.0, 0.0, 0.0)._replace(frame=8, yaw_rad=math.pi / 2)
    flying.run(8.0)
    assert flying.vehicle.plant.truth().vel_ned_mps == pytest.approx((0.0, 1.0, 0.0), abs=0.15)


def test_position_setpoints_are_reached(flying: Station) -> None:
    flying.stream = position_setpoint(2.0, -1.0, -3.0)
    flying.run(8.0)
    assert flying.vehicle.plant.truth().pos_ned_m == pytest.approx((2.0, -1.0, -3.0), abs=0.2)


@pytest.mark.parametrize(("frame", "height_m"), [(5, 489.4 + 3.0), (6, 3.0)])
def test_a_position_on_the_globe_is_reached(flying: Station, frame: int, height_m: float) -> None:
    """1e-5 degrees of latitude are 1.112 m."""
    zero = (0.0, 0.0, 0.0)
    home = flying.server.view.frame
    flying.stream = m.SetPositionTargetGlobalInt(
        0, 1, 1, frame, 0b101111111000, home.latitude_deg + 2e-5, home.longitude_deg, height_m, zero, zero, 0.0, 0.0
    )
    flying.run(8.0)
    assert flying.vehicle.plant.truth().pos_ned_m == pytest.approx((2.224, 0.0, -3.0), abs=0.2)


@pytest.mark.parametrize("frame", [0, 3, 5, 6, 7, 9, 255])
def test_position_setpoints_in_unsupported_frames_are_no_signal(station: Station, frame: int) -> None:
    station.stream = position_setpoint(0.0, 0.0, -1.0)._replace(frame=frame)
    station.run(0.3)
    station.command(MODE, *OFFBOARD_MODE)
    assert station.command(ARM, 1.0) == [1]


@pytest.mark.parametrize("value", HOSTILE)
def test_hostile_setpoints_leave_the_state_finite(flying: Station, value: float) -> None:
    triple, quad = (value,) * 3, (value,) * 4
    for message in (
        m.SetAttitudeTarget(0, 1, 1, 128, quad, triple, value, triple),
        m.SetAttitudeTarget(0, 1, 1, 7, quad, triple, value, triple),
        m.SetAttitudeTarget(0, 1, 1, 0, (0.0,) * 4, triple, 0.5),
        m.SetPositionTargetLocalNed(0, 1, 1, 1, 0, triple, triple, triple, value, value),
        m.SetPositionTargetLocalNed(0, 1, 1, 8, 0, triple, triple, triple, value, value),
    ):
        flying.stream = message
        flying.run(0.2)
        plant = flying.vehicle.plant
        assert all(map(math.isfinite, (*plant.pos_ned_m, *plant.q_ned_frd, *flying.vehicle.motor_command)))
