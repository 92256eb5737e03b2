"""Arming, modes and timers of the simulated autopilot against what a real PX4 was seen to do."""

from __future__ import annotations

import math

import pytest
from commanded import ARM, DISARM, HOLD, ME, OFFBOARD, Flight, in_offboard, ready

from flightstack_sim.autopilot import modes, notices
from flightstack_sim.autopilot.failsafe import Action
from flightstack_sim.autopilot.requests import (
    ACCEPTED,
    COMMAND_ARM,
    COMMAND_LAND,
    COMMAND_RETURN,
    COMMAND_SET_MODE,
    COMMAND_TAKEOFF,
    TEMPORARILY_REJECTED,
    ArmRequest,
    FlyRequest,
    ModeRequest,
    Sender,
)


@pytest.fixture
def flight() -> Flight:
    return ready()


@pytest.fixture
def offboard() -> Flight:
    return in_offboard()


def test_it_boots_disarmed_in_hold() -> None:
    flight = Flight()
    flight.tick()
    assert flight.state.mode is modes.HOLD
    assert not flight.state.armed


def test_arming_is_refused_until_the_estimate_is_ready_3_9_seconds_after_boot() -> None:
    flight = Flight()
    flight.run(3.8)
    assert flight.ask(ARM) == TEMPORARILY_REJECTED
    assert "Arming denied: Resolve system health failures first" in flight.texts()
    assert "Preflight Fail: heading estimate not stable" in flight.texts()
    flight.run(0.2)
    assert "Ready for takeoff!" in flight.texts()
    assert flight.ask(ARM) == ACCEPTED


def test_arming_and_disarming_twice_are_both_accepted(flight: Flight) -> None:
    assert [flight.ask(request) for request in (DISARM, ARM, ARM, DISARM, DISARM)] == [ACCEPTED] * 5
    assert flight.texts().count("Armed by external command") == 1
    assert flight.texts().count("Disarmed by external command") == 1


@pytest.mark.parametrize("value", [2.0, -1.0, 0.5, math.nan, math.inf, 1e38])
def test_an_arm_value_that_is_neither_0_nor_1_gets_words_but_no_answer(flight: Flight, value: float) -> None:
    assert flight.ask(ArmRequest(ME, value, False)) is None
    assert flight.texts()[-1].startswith("Unsupported ARM_DISARM param: ")
    assert not flight.state.armed


def test_the_words_for_an_unsupported_arm_value_are_px4s(flight: Flight) -> None:
    flight.ask(ArmRequest(ME, 2.0, False))
    assert flight.texts()[-1] == "Unsupported ARM_DISARM param: 2.000"


@pytest.mark.parametrize("mode", [modes.MANUAL, modes.POSCTL, modes.ALTCTL, modes.OFFBOARD, modes.LAND, modes.RTL])
@pytest.mark.parametrize("force", [False, True])
def test_a_mode_without_its_needs_is_chosen_but_does_not_arm_even_by_force(
    flight: Flight, mode: modes.Mode, force: bool
) -> None:
    assert flight.ask(ModeRequest(ME, mode.main, mode.sub)) == ACCEPTED
    assert flight.state.mode is mode
    assert flight.ask(ArmRequest(ME, 1.0, force)) == TEMPORARILY_REJECTED
    assert not flight.state.armed
    assert "Arming denied: Resolve system health failures first" in flight.texts()


def test_the_first_setpoint_makes_offboard_armable(flight: Flight) -> None:
    flight.ask(OFFBOARD)
    assert flight.ask(ARM) == TEMPORARILY_REJECTED
    flight.last_setpoint_us = flight.now_us
    assert flight.ask(ARM) == ACCEPTED
    assert flight.state.mode is modes.OFFBOARD


def test_arm_in_hold_then_stream_then_offboard_works_too(flight: Flight) -> None:
    assert flight.ask(ARM) == ACCEPTED
    flight.streaming = True
    flight.run(0.2)
    assert flight.ask(OFFBOARD) == ACCEPTED
    assert flight.state.mode is modes.OFFBOARD


def test_offboard_is_taken_in_the_very_tick_of_the_first_setpoint(flight: Flight) -> None:
    """MAVSDK's own order: a setpoint, then at once the mode; the signal is not awaited till the next cycle."""
    flight.ask(ARM)
    flight.run(0.05)
    flight.last_setpoint_us = flight.now_us
    assert flight.ask(OFFBOARD) == ACCEPTED
    assert flight.state.mode is modes.OFFBOARD


def test_armed_offboard_without_a_signal_is_rejected_and_the_mode_kept(flight: Flight) -> None:
    flight.ask(ARM)
    assert flight.ask(OFFBOARD) == TEMPORARILY_REJECTED
    assert flight.state.mode is modes.HOLD
    assert flight.texts()[-1] == "Switching to Offboard is currently not available"


def test_the_words_for_a_refused_mode_go_only_to_component_190_and_once_a_second(flight: Flight) -> None:
    flight.ask(ARM)
    words = "Switching to Offboard is currently not available"
    flight.ask(ModeRequest(Sender(0, 245, 191), 6, 0))
    assert words not in flight.texts()
    flight.ask(OFFBOARD)
    flight.ask(OFFBOARD)
    assert flight.texts().count(words) == 1
    flight.run(1.0)
    flight.ask(OFFBOARD)
    assert flight.texts().count(words) == 2


@pytest.mark.parametrize(("main", "sub"), [(99, 0), (0, 0), (10, 0), (-5, 3), (255, 255)])
def test_an_unknown_main_mode_is_rejected_in_words(flight: Flight, main: int, sub: int) -> None:
    assert flight.ask(ModeRequest(ME, main, sub)) == TEMPORARILY_REJECTED
    assert flight.texts()[-1] == "Unsupported main mode"
    assert flight.state.mode is modes.HOLD


def test_disarming_in_the_air_is_refused_unless_forced(offboard: Flight) -> None:
    assert offboard.ask(DISARM) == TEMPORARILY_REJECTED
    assert offboard.texts() == ["Disarming denied: not landed"]
    assert offboard.state.armed
    assert offboard.ask(ArmRequest(ME, 0.0, True)) == ACCEPTED
    assert not offboard.state.armed


def test_armed_in_hold_and_never_taken_off_it_disarms_after_11_1_seconds(flight: Flight) -> None:
    flight.ask(ARM)
    start = flight.now_us
    while flight.state.armed:
        flight.tick()
    assert 11.0 <= (flight.now_us - start) / 1e6 <= 11.15
    assert flight.texts()[-1] == "Disarmed by auto preflight disarming"


def test_the_preflight_timer_follows_its_parameters(flight: Flight) -> None:
    flight.set("COM_DISARM_PRFLT", 2.0)
    flight.set("COM_SPOOLUP_TIME", 0.5)
    flight.ask(ARM)
    start = flight.now_us
    while flight.state.armed:
        flight.tick()
    assert 2.5 <= (flight.now_us - start) / 1e6 <= 2.65


@pytest.mark.parametrize(("parameter", "flown"), [("COM_DISARM_PRFLT", False), ("COM_DISARM_LAND", True)])
def test_a_negative_time_switches_an_automatic_disarm_off(flight: Flight, parameter: str, flown: bool) -> None:
    flight.set(parameter, -1.0)
    flight.ask(ARM)
    flight.landed = not flown
    flight.run(0.5)
    flight.landed = True
    flight.run(15.0)
    assert flight.state.armed


def test_it_disarms_two_seconds_after_landing_and_says_both(offboard: Flight) -> None:
    offboard.landed = True
    offboard.tick()
    start = offboard.now_us
    assert offboard.texts() == ["Landing detected"]
    while offboard.state.armed:
        offboard.tick()
    assert 2.0 <= (offboard.now_us - start) / 1e6 <= 2.11
    assert offboard.texts() == ["Landing detected", "Disarmed by landing"]


def test_touching_down_for_a_moment_does_not_disarm(offboard: Flight) -> None:
    offboard.landed = True
    offboard.run(1.5)
    offboard.landed = False
    offboard.run(3.0)
    assert offboard.state.armed


def test_landing_out_of_offboard_leaves_offboard_selected_after_the_disarm(offboard: Flight) -> None:
    assert offboard.ask(FlyRequest(ME, COMMAND_LAND)) == ACCEPTED
    assert offboard.state.mode is modes.LAND
    offboard.streaming = False
    offboard.run(5.0)
    assert offboard.state.mode is modes.LAND
    assert offboard.state.action is Action.NONE
    offboard.landed = True
    offboard.run(2.2)
    assert not offboard.state.armed
    assert offboard.state.mode is modes.OFFBOARD


def test_land_is_always_allowed(offboard: Flight) -> None:
    offboard.streaming = False
    offboard.run(2.0)
    assert offboard.ask(ModeRequest(ME, 4, 6)) == ACCEPTED
    assert offboard.state.mode is modes.LAND
    assert not offboard.state.in_failsafe


def test_a_takeoff_is_accepted_disarmed_and_ends_in_hold(flight: Flight) -> None:
    assert flight.ask(FlyRequest(ME, COMMAND_TAKEOFF)) == ACCEPTED
    assert flight.state.mode is modes.TAKEOFF
    assert flight.ask(ARM) == ACCEPTED
    flight.landed = False
    flight.run(3.0)
    assert flight.state.mode is modes.TAKEOFF
    flight.takeoff_done = True
    flight.tick()
    assert flight.state.mode is modes.HOLD
    assert "Takeoff detected" in flight.texts()


@pytest.mark.parametrize(
    ("command", "mode", "text"),
    [
        (COMMAND_LAND, modes.LAND, "Landing at current position"),
        (COMMAND_RETURN, modes.RTL, "Returning to launch"),
    ],
)
def test_land_and_return_are_accepted_and_said(offboard: Flight, command: int, mode: modes.Mode, text: str) -> None:
    assert offboard.ask(FlyRequest(ME, command)) == ACCEPTED
    assert offboard.state.mode is mode
    assert offboard.texts()[0] == text


def test_every_request_is_answered_with_its_own_command_number(flight: Flight) -> None:
    flight.tick(HOLD, FlyRequest(ME, COMMAND_TAKEOFF), ARM)
    assert [answer.command for answer in flight.answers] == [COMMAND_SET_MODE, COMMAND_TAKEOFF, COMMAND_ARM]


def test_the_arming_events_are_sent_when_something_changes_and_not_twice_within_two_seconds(flight: Flight) -> None:
    summary = notices.event_id("commander_arming_check_summary")

    def bursts() -> int:
        return sum(notice.event_id == summary for notice in flight.notices)

    before = bursts()
    flight.run(5.0)
    assert bursts() == before
    flight.last_setpoint_us = flight.now_us
    flight.run(0.2)
    assert bursts() == before + 1
    flight.run(1.2)  # the signal is gone again, but the report waits
    assert bursts() == before + 1
    flight.run(1.0)
    assert bursts() == before + 2
