"""Flights in the modes of the simulated autopilot, over MAVLink; the oracle is a real PX4, measured."""

from __future__ import annotations

import pytest
from station import (
    ARM,
    LAND,
    NAN,
    RETURN,
    TAKEOFF,
    Station,
    airborne,
    position_setpoint,
)

from mavlink_bridge import messages as m


@pytest.fixture
def station() -> Station:
    return Station().boot()


@pytest.fixture
def flying() -> Station:
    station = airborne()
    station.clear()
    return station


def test_a_takeoff_asked_for_while_disarmed_climbs_after_arming_and_holds() -> None:
    station = Station().boot()
    station.heartbeat_every_us = 1_000_000
    assert station.command(TAKEOFF) == [0]
    assert station.command(ARM, 1.0) == [0]
    station.run_until(lambda: station.last(m.ExtendedSysState).landed_state == 3, 5.0)
    station.run_until(lambda: station.last(m.Heartbeat).custom_mode == 0x03040000, 15.0)
    station.run(4.0)
    assert station.vehicle.plant.truth().pos_ned_m[2] == pytest.approx(-2.5, abs=0.25)
    assert station.last(m.ExtendedSysState).landed_state == 2
    assert "Using default takeoff altitude: 2.5 m" in station.texts()
    assert "Takeoff detected" in station.texts()


def test_a_takeoff_can_name_its_altitude() -> None:
    station = Station().boot()
    station.command(TAKEOFF, NAN, NAN, NAN, NAN, NAN, NAN, 489.4 + 5.0)
    station.command(ARM, 1.0)
    station.run(12.0)
    assert station.vehicle.plant.truth().pos_ned_m[2] == pytest.approx(-5.0, abs=0.25)


def test_a_landing_ends_disarmed_two_seconds_after_touch_down_with_offboard_still_chosen(flying: Station) -> None:
    flying.heartbeat_every_us = 1_000_000
    flying.run(1.1)
    assert flying.command(LAND) == [0]
    flying.stream = None
    flying.run(0.4)
    assert flying.last(m.ExtendedSysState).landed_state == 4
    flying.run_until(lambda: "Landing detected" in flying.texts(), 15.0)
    took_s = flying.run_until(lambda: not flying.state.armed, 5.0)
    assert took_s == pytest.approx(2.05, abs=0.07)
    assert flying.texts()[-3:] == ["Landing at current position", "Landing detected", "Disarmed by landing"]
    flying.run(1.1)
    assert flying.last(m.Heartbeat) == m.Heartbeat(2, 12, 0x01, 0x00060000, 0)
    assert flying.last(m.ServoOutputRaw).pwm_us == (900,) * 16


def test_return_near_home_lands_at_home(flying: Station) -> None:
    flying.heartbeat_every_us = 1_000_000
    flying.stream = position_setpoint(4.0, 2.0, -2.5)
    flying.run(6.0)
    assert flying.command(RETURN) == [0]
    flying.run_until(lambda: not flying.state.armed, 30.0)
    assert flying.vehicle.plant.truth().pos_ned_m[:2] == pytest.approx((0.0, 0.0), abs=0.5)
    texts = flying.texts()
    assert "Returning to launch" in texts
    assert "RTL: start return at 492 m (3 m above destination)" in texts
    assert "RTL: land at destination" in texts


def test_return_from_afar_climbs_before_it_crosses(flying: Station) -> None:
    flying.vehicle.params.set("RTL_RETURN_ALT", 8.0)
    flying.stream = position_setpoint(20.0, 0.0, -2.5)
    flying.run(14.0)
    flying.command(RETURN)
    highest = 0.0
    while flying.state.armed:
        flying.run(0.1)
        north, _, down = flying.vehicle.plant.truth().pos_ned_m
        highest = max(highest, -down)
        assert flying.server.t_us < 120e6
        if 5.0 < north < 15.0:
            assert -down > 6.5
    assert highest == pytest.approx(8.0, abs=1.0)
    assert flying.vehicle.plant.truth().pos_ned_m[:2] == pytest.approx((0.0, 0.0), abs=0.5)


def test_a_lost_stream_returns_after_1_0_to_1_1_s_with_critical_heartbeats_and_both_modes_told(flying: Station) -> None:
    flying.heartbeat_every_us = 1_000_000
    flying.run(1.1)
    flying.clear()
    flying.stream = None
    took_s = flying.run_until(lambda: flying.state.mode.title == "Return", 2.0)
    assert 1.0 <= took_s <= 1.104
    assert "Failsafe activated" in flying.texts()
    flying.run(2.1)
    assert flying.last(m.Heartbeat) == m.Heartbeat(2, 12, 0x9D, 0x05040000, 5)
    assert flying.last(m.CurrentMode) == m.CurrentMode(5, 0x05040000, 0x00060000)


@pytest.mark.parametrize(
    ("setting", "custom_mode"), [((5, 2), 0x03040000), ((4, 2), 0x06040000), ((0, 1), 0x03040000), ((3, 2), 0x05040000)]
)
def test_the_answer_to_a_lost_stream_follows_its_parameters(
    flying: Station, setting: tuple[int, int], custom_mode: int
) -> None:
    for name, value in zip(("COM_OBL_RC_ACT", "NAV_RCL_ACT"), setting, strict=True):
        flying.send(m.ParamSet(1, 1, name, m.param_bits(value, 6), 6))
    flying.stream = None
    flying.run(2.3)
    assert flying.last(m.Heartbeat) == m.Heartbeat(2, 12, 0x9D, custom_mode, 5)


def test_a_resumed_stream_takes_off_again_out_of_the_landed_failsafe(flying: Station) -> None:
    flying.stream = None
    flying.run(2.2)
    assert flying.last(m.Heartbeat).system_status == 5
    flying.run_until(lambda: flying.state.landed, 20.0)
    assert flying.state.armed
    flying.stream = position_setpoint(0.0, 0.0, -2.0)
    took_s = flying.run_until(lambda: flying.state.mode.title == "Offboard", 1.0)
    assert took_s <= 0.2
    flying.run(6.0)
    assert flying.vehicle.plant.truth().pos_ned_m[2] < -1.5


def test_disarming_in_the_air_is_refused_and_forced_disarming_drops_it(flying: Station) -> None:
    assert flying.command(ARM, 0.0) == [1]
    assert flying.command(ARM, 0.0, 21196.0) == [0]
    flying.run(1.1)
    assert flying.last(m.Heartbeat).base_mode == 0x01
    assert flying.vehicle.plant.truth().vel_ned_mps[2] > 3.0 or flying.vehicle.plant.on_ground


def test_armed_in_hold_it_stands_with_idle_motors_and_disarms_by_itself(station: Station) -> None:
    station.heartbeat_every_us = 1_000_000
    assert station.command(ARM, 1.0) == [0]
    station.run(2.0)
    assert station.last(m.ServoOutputRaw).pwm_us[:4] == pytest.approx((1000,) * 4, abs=5)
    assert station.last(m.Heartbeat) == m.Heartbeat(2, 12, 0x9D, 0x03040000, 4)
    took_s = 2.0 + station.run_until(lambda: not station.state.armed, 12.0)
    assert took_s == pytest.approx(11.05, abs=0.1)
    assert station.texts()[-1] == "Disarmed by auto preflight disarming"
