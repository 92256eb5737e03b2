"""Lost setpoints: what the simulated autopilot does and when, against what a real PX4 was seen to do."""

from __future__ import annotations

import pytest
from commanded import ARM, DISARM, HOLD, OFFBOARD, Flight, in_offboard, ready

from sim.autopilot import modes
from sim.autopilot.commander import ACCEPTED, TEMPORARILY_REJECTED


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
