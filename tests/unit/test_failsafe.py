"""Failsafes: what the simulated autopilot does and when.

Lost setpoints against what a real PX4 was seen to do; the others against PX4's user guide ("Safety (failsafe)
configuration") and parameter reference: COM_DL_LOSS_T 10 s, COM_FAIL_ACT_T 5 s in Hold before the action,
BAT_LOW_THR 15 %, BAT_CRIT_THR 7 %, BAT_EMERGEN_THR 5 %.
"""

from __future__ import annotations

import pytest
from commanded import ARM, DISARM, HOLD, ME, OFFBOARD, Flight, in_offboard, ready

from flightstack_sim.autopilot import modes
from flightstack_sim.autopilot.requests import ACCEPTED, TEMPORARILY_REJECTED, ModeRequest


@pytest.fixture
def flight() -> Flight:
    return ready()


@pytest.fixture
def offboard() -> Flight:
    return in_offboard()


@pytest.mark.parametrize(
    ("settings", "mode", "action"),
    [
        ({}, modes.RTL, 6),
        ({"COM_OBL_RC_ACT": 5}, modes.HOLD, 5),
        ({"COM_OBL_RC_ACT": 4}, modes.LAND, 7),
        ({"COM_OBL_RC_ACT": 3}, modes.RTL, 6),
        ({"NAV_RCL_ACT": 1}, modes.HOLD, 5),
        ({"NAV_RCL_ACT": 1, "COM_RC_IN_MODE": 4}, modes.HOLD, 5),
        ({"COM_OBL_RC_ACT": 1}, modes.RTL, 6),
        ({"COM_OBL_RC_ACT": 2, "NAV_RCL_ACT": 3}, modes.LAND, 7),
        ({"COM_OBL_RC_ACT": 6}, modes.TERMINATION, 10),
    ],
)
def test_a_lost_stream_is_answered_after_1_0_to_1_1_seconds_as_the_parameters_say(
    offboard: Flight, settings: dict[str, float], mode: modes.Mode, action: int
) -> None:
    for name, value in settings.items():
        offboard.set(name, value)
    offboard.streaming = False
    last = offboard.now_us
    while offboard.state.mode is modes.OFFBOARD:
        offboard.tick()
    assert 1.0 <= (offboard.now_us - last) / 1e6 <= 1.104
    assert offboard.state.mode is mode
    assert offboard.state.in_failsafe
    assert offboard.state.armed
    assert offboard.state.intended is modes.OFFBOARD
    assert offboard.texts() == ["Failsafe activated"]
    event = next(notice for notice in offboard.notices if notice.text)
    assert event.arguments == (0x00060000).to_bytes(4, "little") + bytes([action])


def test_a_lost_stream_can_disarm(offboard: Flight) -> None:
    offboard.set("COM_OBL_RC_ACT", 7)
    offboard.streaming = False
    offboard.run(1.2)
    assert not offboard.state.armed


def test_the_loss_time_follows_its_parameter_at_once(offboard: Flight) -> None:
    offboard.set("COM_OF_LOSS_T", 0.2)
    offboard.set("COM_OBL_RC_ACT", 5)
    offboard.streaming = False
    last = offboard.now_us
    while offboard.state.mode is modes.OFFBOARD:
        offboard.tick()
    assert 0.2 <= (offboard.now_us - last) / 1e6 <= 0.304


def test_six_setpoints_a_second_hold_offboard_with_a_loss_time_of_0_2_seconds(offboard: Flight) -> None:
    offboard.set("COM_OF_LOSS_T", 0.2)
    offboard.streaming = False
    for _ in range(20):
        offboard.last_setpoint_us = offboard.now_us
        offboard.run(1.0 / 6.0)
        assert offboard.state.mode is modes.OFFBOARD


def test_a_resumed_stream_returns_to_offboard_within_0_2_seconds(offboard: Flight) -> None:
    offboard.streaming = False
    offboard.run(3.0)
    assert offboard.state.mode is modes.RTL
    offboard.streaming = True
    offboard.run(0.2)
    assert offboard.state.mode is modes.OFFBOARD
    assert not offboard.state.in_failsafe


def test_a_resumed_stream_returns_to_offboard_even_after_the_failsafe_has_landed(offboard: Flight) -> None:
    offboard.streaming = False
    offboard.run(3.0)
    offboard.landed = True
    offboard.run(1.0)
    offboard.streaming = True
    offboard.run(0.2)
    assert offboard.state.mode is modes.OFFBOARD


def test_hold_chosen_before_the_loss_replaces_the_intention(offboard: Flight) -> None:
    assert offboard.ask(HOLD) == ACCEPTED
    offboard.streaming = False
    offboard.run(3.0)
    assert offboard.state.mode is modes.HOLD
    assert not offboard.state.in_failsafe
    offboard.streaming = True
    offboard.run(1.0)
    assert offboard.state.mode is modes.HOLD
    assert offboard.ask(OFFBOARD) == ACCEPTED
    assert offboard.state.mode is modes.OFFBOARD


def test_offboard_asked_for_during_the_failsafe_without_a_stream_is_refused(offboard: Flight) -> None:
    offboard.streaming = False
    offboard.run(2.0)
    assert offboard.ask(OFFBOARD) == TEMPORARILY_REJECTED
    assert offboard.state.mode is modes.RTL


def test_a_stream_lost_while_armed_on_the_ground_does_the_same(flight: Flight) -> None:
    flight.streaming = True
    flight.run(0.3)
    flight.ask(OFFBOARD)
    flight.ask(ARM)
    flight.streaming = False
    flight.run(1.2)
    assert flight.state.mode is modes.RTL
    assert flight.ask(DISARM) == ACCEPTED
    assert flight.state.mode is modes.OFFBOARD


# --- ground station, battery, fence, estimate ---


def _near(changes: list[tuple[float, modes.Mode]], expected: list[tuple[float, modes.Mode]]) -> None:
    """The modes in their order, each within a cycle (0.1 s) of its time or just after it."""
    assert [mode for _, mode in changes] == [mode for _, mode in expected]
    for (came, _), (due, _) in zip(changes, expected, strict=True):
        assert due - 1e-9 <= came <= due + 0.2


@pytest.fixture
def watched(offboard: Flight) -> Flight:
    """In OFFBOARD with a ground station."""
    offboard.gcs = True
    offboard.run(0.5)
    offboard.notices.clear()
    return offboard


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({}, []),
        ({"NAV_DLL_ACT": 1}, [(10.0, modes.HOLD)]),
        ({"NAV_DLL_ACT": 2}, [(10.0, modes.HOLD), (15.0, modes.RTL)]),
        ({"NAV_DLL_ACT": 3}, [(10.0, modes.HOLD), (15.0, modes.LAND)]),
        ({"NAV_DLL_ACT": 2, "COM_DL_LOSS_T": 5}, [(5.0, modes.HOLD), (10.0, modes.RTL)]),
        ({"NAV_DLL_ACT": 3, "COM_FAIL_ACT_T": 0.0}, [(10.0, modes.LAND)]),
        ({"NAV_DLL_ACT": 2, "COM_FAIL_ACT_T": 10.0}, [(10.0, modes.HOLD), (20.0, modes.RTL)]),
        ({"NAV_DLL_ACT": 5}, [(10.0, modes.TERMINATION)]),
    ],
)
def test_a_lost_ground_station_is_answered_as_nav_dll_act_says(
    watched: Flight, settings: dict[str, float], expected: list[tuple[float, modes.Mode]]
) -> None:
    for name, value in settings.items():
        watched.set(name, value)
    watched.gcs = False
    _near(watched.timeline(25.0), expected)
    assert "Connection to ground station lost" in watched.texts()
    assert watched.state.in_failsafe is bool(expected)


def test_a_ground_station_that_comes_back_does_not_end_its_failsafe_but_the_next_mode_does(watched: Flight) -> None:
    watched.set("NAV_DLL_ACT", 2)
    watched.gcs = False
    watched.run(16.0)
    watched.gcs = True
    watched.run(2.0)
    assert watched.state.mode is modes.RTL
    assert "GCS connection regained" in watched.texts()
    assert watched.ask(HOLD) == ACCEPTED
    watched.run(0.2)
    assert watched.state.mode is modes.HOLD
    assert not watched.state.in_failsafe


def test_the_words_name_the_wait_and_its_end(watched: Flight) -> None:
    watched.set("NAV_DLL_ACT", 2)
    watched.gcs = False
    watched.run(16.0)
    assert watched.texts()[-2:] == ["Failsafe activated, entering Hold for 5 seconds", "Failsafe activated"]


def test_landing_goes_on_without_a_ground_station(watched: Flight) -> None:
    watched.set("NAV_DLL_ACT", 2)
    watched.ask(ModeRequest(ME, 4, 6))
    watched.gcs = False
    assert watched.timeline(20.0) == []


def test_where_a_ground_station_is_required_nothing_arms_without_one(flight: Flight) -> None:
    flight.set("NAV_DLL_ACT", 2)
    flight.run(0.2)
    assert flight.ask(ARM) == TEMPORARILY_REJECTED
    assert flight.texts()[-1] == "Preflight Fail: No connection to the ground control station"
    flight.gcs = True
    flight.run(0.2)
    assert flight.ask(ARM) == ACCEPTED


@pytest.mark.parametrize(
    ("charge", "action", "expected"),
    [
        (0.16, 3, []),
        (0.10, 3, []),
        (0.06, 0, []),
        (0.06, 3, [(0.0, modes.HOLD), (5.0, modes.RTL)]),
        (0.06, 2, [(0.0, modes.HOLD), (5.0, modes.LAND)]),
        (0.04, 3, [(0.0, modes.HOLD), (5.0, modes.LAND)]),
        (0.04, 0, []),
    ],
)
def test_a_low_battery_is_answered_as_com_low_bat_act_says(
    offboard: Flight, charge: float, action: int, expected: list[tuple[float, modes.Mode]]
) -> None:
    offboard.set("COM_LOW_BAT_ACT", action)
    offboard.battery = charge
    _near(offboard.timeline(8.0), expected)
    assert bool(offboard.texts()) is (charge < 0.15)  # a warning at least


def test_a_battery_that_runs_down_is_warned_of_then_returns_then_lands(offboard: Flight) -> None:
    seen = []
    for charge in (0.2, 0.1, 0.06, 0.04):
        offboard.battery = charge
        offboard.run(7.0)
        seen.append(offboard.state.mode)
    assert seen == [modes.OFFBOARD, modes.OFFBOARD, modes.RTL, modes.LAND]


def test_armed_with_a_low_battery_it_is_no_news(flight: Flight) -> None:
    flight.battery = 0.06
    flight.run(0.2)
    flight.ask(ARM)
    flight.landed = False
    flight.run(8.0)
    assert flight.state.mode is modes.HOLD
    assert not flight.state.in_failsafe


@pytest.mark.parametrize(
    ("action", "expected"),
    [
        (0, []),
        (1, []),
        (2, [(0.0, modes.HOLD)]),
        (3, [(0.0, modes.HOLD), (5.0, modes.RTL)]),
        (5, [(0.0, modes.HOLD), (5.0, modes.LAND)]),
        (4, [(0.0, modes.TERMINATION)]),
    ],
)
def test_leaving_the_fence_is_answered_as_gf_action_says(
    offboard: Flight, action: int, expected: list[tuple[float, modes.Mode]]
) -> None:
    offboard.set("GF_ACTION", action)
    offboard.breached = True
    _near(offboard.timeline(8.0), expected)


def test_a_mode_chosen_in_a_failsafe_takes_the_vehicle_over(offboard: Flight) -> None:
    """The battery stays critical, and that is a warning from then on."""
    offboard.battery = 0.06
    offboard.run(8.0)
    assert offboard.state.mode is modes.RTL
    assert offboard.ask(OFFBOARD) == ACCEPTED
    offboard.run(10.0)
    assert offboard.state.mode is modes.OFFBOARD
    assert not offboard.state.in_failsafe
    offboard.battery = 0.04
    offboard.run(0.2)
    assert offboard.state.in_failsafe  # something new


def test_the_more_severe_of_two_failsafes_flies(offboard: Flight) -> None:
    offboard.set("GF_ACTION", 2)
    offboard.breached = True
    offboard.run(0.5)
    assert offboard.state.mode is modes.HOLD
    offboard.streaming = False
    offboard.run(1.3)
    assert offboard.state.mode is modes.RTL


def test_without_a_position_body_rates_fly_on_and_what_needs_one_descends(offboard: Flight) -> None:
    offboard.position_valid = False
    assert offboard.timeline(3.0) == []
    assert offboard.ask(ModeRequest(ME, 4, 6)) == ACCEPTED  # LAND is always allowed
    offboard.run(0.2)
    assert offboard.state.mode is modes.DESCEND
    assert offboard.state.in_failsafe
    assert offboard.ask(HOLD) == TEMPORARILY_REJECTED


def test_a_stream_lost_without_a_position_descends(offboard: Flight) -> None:
    offboard.position_valid = False
    offboard.streaming = False
    _near(offboard.timeline(3.0), [(1.0, modes.DESCEND)])


def test_a_position_that_comes_back_ends_the_descent(offboard: Flight) -> None:
    offboard.ask(HOLD)
    offboard.position_valid = False
    offboard.run(0.3)
    assert offboard.state.mode is modes.DESCEND
    offboard.position_valid = True
    offboard.run(0.3)
    assert offboard.state.mode is modes.HOLD
