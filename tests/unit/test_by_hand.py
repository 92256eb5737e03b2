"""Sticks, flight termination, injected failures and a lost motor; the oracle is a real PX4 (1.18, SIH) unless said."""

from __future__ import annotations

import math

import pytest

from mavlink_bridge import messages as m
from tests.unit.station import ARM, LAND, MODE, OFFBOARD_MODE, Station, airborne

POSCTL, ALTCTL, STABILIZED = (1.0, 3.0), (1.0, 2.0), (1.0, 7.0)
TERMINATE, INJECT = 185, 420
MOTOR, BATTERY, GPS, BARO, MAG = 101.0, 100.0, 4.0, 3.0, 2.0


def sticks(station: Station, seconds: float, x: int = 0, y: int = 0, z: int = 500, r: int = 0) -> None:
    """A pilot's hands, 20 times a second."""
    for _ in range(round(seconds * 20)):
        station.send(m.ManualControl(1, x, y, z, r))
        station.run(0.052)


def test_a_pilot_flies_position_altitude_and_stabilized_and_losing_the_sticks_returns() -> None:
    station = Station().boot()
    assert station.command(ARM, 1.0) == [0]
    assert station.command(MODE, *POSCTL) == [0, 1]  # nobody's sticks
    assert station.command(ARM, 0.0) == [0]
    sticks(station, 0.5)
    assert station.command(MODE, *POSCTL) == [0, 0]
    assert station.command(ARM, 1.0) == [0]
    sticks(station, 1.0)
    assert station.vehicle.landed
    sticks(station, 4.0, z=1000)
    plant = station.vehicle.plant
    assert plant.pos_ned_m[2] < -1.0
    sticks(station, 3.0)
    height = float(plant.pos_ned_m[2])
    sticks(station, 3.0, x=1000)
    assert plant.vel_ned_mps[0] > 4.0
    assert abs(plant.vel_ned_mps[1]) < 0.5
    sticks(station, 10.0)
    assert math.hypot(*plant.vel_ned_mps) < 0.2
    assert plant.pos_ned_m[2] == pytest.approx(height, abs=0.3)
    sticks(station, 1.0, r=500)
    assert station.server.view.heading_deg == pytest.approx(60.0, abs=20.0)  # 150 deg/s by (0.5 - 0.1) / 0.9
    assert station.command(MODE, *ALTCTL) == [0, 0]
    sticks(station, 2.0, y=300)
    assert plant.pos_ned_m[2] == pytest.approx(height, abs=0.4)
    assert math.hypot(*plant.vel_ned_mps[:2]) > 0.5
    assert station.command(MODE, *STABILIZED) == [0, 0]
    sticks(station, 1.0)
    assert abs(plant.vel_ned_mps[2]) < 1.0
    assert station.command(MODE, *POSCTL) == [0, 0]
    sticks(station, 2.0)
    lost_us = station.server.t_us
    station.run_until(lambda: station.state.mode.title == "Hold", 1.0)
    assert (station.server.t_us - lost_us) * 1e-6 < 0.65  # COM_RC_LOSS_T and a cycle
    station.run_until(lambda: station.state.mode.title == "Return", 5.2)
    sticks(station, 1.0)
    assert station.command(MODE, *POSCTL) == [0, 0]
    sticks(station, 0.5)
    assert station.state.mode.title == "Position"


def test_termination_is_for_good() -> None:
    station = airborne()
    assert station.command(TERMINATE, 0.0) == [2]
    assert station.command(TERMINATE, 1.0) == [0]
    station.run(1.1)
    beat = station.last(m.Heartbeat)
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (0x81, 0x0A0000, 8)
    assert station.last(m.ServoOutputRaw).pwm_us[:4] == (900,) * 4
    assert station.command(MODE, *OFFBOARD_MODE)[0] == 0
    assert station.state.mode.title == "Termination"
    station.stream = None
    station.run(2.0)
    assert station.command(ARM, 0.0, 21196.0) == [0]
    assert station.command(ARM, 1.0) == [1]


def test_a_quadrotor_that_loses_a_motor_tumbles_and_falls() -> None:
    """Physics: three motors can't balance roll, pitch and yaw; it turns over within two seconds and comes down.

    By default the failure detector (60 degrees for 0.3 s) only warns: CBRK_FLIGHTTERM is set; else it terminates.
    """
    for breaker, mode in ((121212.0, "Offboard"), (0.0, "Termination")):
        station = airborne()
        station.vehicle.params.set("CBRK_FLIGHTTERM", breaker)
        assert station.command(INJECT, MOTOR, 1.0, 1.0) == [0]
        station.run_until(lambda station=station: station.server.detector.failed, 2.0)  # type: ignore[misc]
        station.run(0.2)
        assert station.state.mode.title == mode
        station.run_until(lambda station=station: station.vehicle.plant.on_ground, 4.0)  # type: ignore[misc]


def test_all_motors_stop_and_one_of_them_alone_runs_again() -> None:
    """PX4: FailureInjector.cpp, instance 0 is every motor; each has a bit of its own."""
    station = airborne()
    assert station.command(INJECT, MOTOR, 1.0, 0.0) == [0]
    station.run(0.4)  # eight of the rotors' time constants of 50 ms
    plant = station.vehicle.plant
    assert sum(plant.truth().rotor_thrust_n) < math.exp(-7.0) * 9.81  # of a weight of 9.81 N
    assert plant.vel_ned_mps[2] > 2.0
    assert station.command(INJECT, MOTOR, 0.0, 2.0) == [0]
    station.run(0.1)
    assert [thrust > 0.1 for thrust in plant.truth().rotor_thrust_n] == [False, True, False, False]
    for kind in (2.0, 4.0):  # the telemetry of motor controllers, which is not there
        assert station.command(INJECT, MOTOR, kind, 0.0) == [0]


def test_failures_are_injected_and_taken_back() -> None:
    station = airborne()
    assert station.command(INJECT, BATTERY, 1.0) == [0]
    station.run(0.2)
    assert station.server.view.battery.remaining == 0.0
    assert station.command(INJECT, BATTERY, 0.0) == [0]
    for kind in (1.0, 2.0, 4.0):
        assert station.command(INJECT, GPS, kind) == [0]
        station.run(0.2)
        assert not station.vehicle.sensors.position_valid
        assert station.command(INJECT, GPS, 0.0) == [0]
    for unit, kind, instance in ((MOTOR, 99.0, 1.0), (MOTOR, 1.0, 9.0), (77.0, 1.0, 0.0)):
        assert station.command(INJECT, unit, kind, instance) == [3]


def air_samples(station: Station, seconds: float) -> tuple[list[float], list[tuple[float, ...]], int]:
    """New pressures and fields of HIGHRES_IMU, and how many SCALED_PRESSURE came."""
    station.clear()
    station.run(seconds)
    heard = station.all(m.HighresImu, 0)
    pressures = [each.abs_pressure_hpa for each in heard if each.fields_updated & 0x200]
    fields = [each.mag_frd_gauss for each in heard if each.fields_updated & 0x1C0]
    return pressures, fields, len(station.all(m.ScaledPressure, 1))


@pytest.mark.parametrize(("unit", "name", "bit", "component"), [(BARO, "Baro", 8, 1), (MAG, "Compass", 4, 27)])
def test_a_barometer_or_compass_that_is_off_is_missed_after_a_second_and_bars_arming(
    unit: float, name: str, bit: int, component: int
) -> None:
    """PX4: SimulatorMavlink.cpp blocks its samples; baroCheck.cpp, magnetometerCheck.cpp want one within a second."""
    station = airborne()
    station.heartbeat_every_us = 1_000_000  # texts go to ground stations
    assert len(air_samples(station, 2.0)[0 if unit == BARO else 1]) > 10
    assert station.command(INJECT, unit, 1.0, 0.0) == [0]
    pressures, fields, scaled = air_samples(station, 2.0)
    assert not (pressures if unit == BARO else fields)
    assert len(fields if unit == BARO else pressures) > 10
    assert (scaled == 0) == (unit == BARO)
    assert any(event.arguments[:6] == b"\xff\xff\xff\xff" + bytes([component, 0]) for event in station.all(m.Event))
    assert station.state.armed  # it flies on
    assert station.last(m.SysStatus).health & (4 | 8) == 12 - bit
    assert station.command(LAND) == [0]
    station.run_until(lambda: not station.state.armed, 30.0)
    station.clear()
    assert station.command(ARM, 1.0) == [1]
    station.run(1.2)
    assert any(f"No valid data from {name} 0" in text for text in station.texts())
    assert station.command(INJECT, unit, 0.0, 0.0) == [0]
    station.run(1.0)
    assert station.last(m.SysStatus).health & 12 == 12
    assert station.command(ARM, 1.0) == [0]


def test_a_stuck_barometer_or_compass_repeats_its_last_sample() -> None:
    station = airborne()
    for unit, kind in ((BARO, 0), (MAG, 1)):
        assert station.command(INJECT, unit, 2.0, 1.0) == [0]
        repeated = air_samples(station, 1.0)[kind]
        assert len(repeated) > 10
        assert len(set(repeated)) == 1
        assert station.command(INJECT, unit, 0.0, 1.0) == [0]
        again = air_samples(station, 1.0)[kind]
        assert len(set(again)) == len(again)


def test_nothing_is_injected_where_the_parameter_forbids_it() -> None:
    """PX4: mavlink_receiver.cpp answers DENIED unless SYS_FAILURE_EN is set."""
    station = airborne()
    station.vehicle.params.set("SYS_FAILURE_EN", 0.0)
    for unit in (MOTOR, BATTERY, GPS, BARO, MAG):
        assert station.command(INJECT, unit, 1.0, 0.0) == [2]
    station.run(1.0)
    assert station.vehicle.sensors.position_valid
    assert station.vehicle.plant.pos_ned_m[2] < -0.5
