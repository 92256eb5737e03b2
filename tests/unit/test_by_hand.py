"""Sticks, flight termination, injected failures and a lost motor; the oracle is a real PX4 (1.18, SIH) unless said."""

from __future__ import annotations

import math

import pytest

from mavlink_bridge import messages as m
from tests.unit.station import ARM, MODE, OFFBOARD_MODE, Station, airborne

POSCTL, ALTCTL, STABILIZED = (1.0, 3.0), (1.0, 2.0), (1.0, 7.0)
TERMINATE, INJECT = 185, 420
MOTOR, BATTERY, GPS = 101.0, 100.0, 4.0


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
