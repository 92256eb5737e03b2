"""The handshake's table; its rules are read off the table itself, and off PX4's documented offboard procedure."""

from __future__ import annotations

from itertools import pairwise

import pytest

from mavlink_bridge.handshake import FINAL, TRANSITIONS, HandshakeEvent, State, transition


def _reachable(start: State) -> set[State]:
    seen, todo = {start}, [start]
    while todo:
        for after in TRANSITIONS[todo.pop()].values():
            if after not in seen:
                seen.add(after)
                todo.append(after)
    return seen


def test_a_good_flight_goes_through_the_states_in_order() -> None:
    events = [
        HandshakeEvent.HEARTBEAT,
        HandshakeEvent.IDENTIFIED,
        HandshakeEvent.READY,
        HandshakeEvent.ENGAGED,
        HandshakeEvent.MISSION_DONE,
        HandshakeEvent.DISARMED,
    ]
    states = [State.DISCONNECTED]
    for event in events:
        after = transition(states[-1], event)
        assert after is not None
        states.append(after)
    assert states[-1] is State.LANDED
    assert all(before is not after for before, after in pairwise(states))


@pytest.mark.parametrize("state", sorted(FINAL, key=lambda state: state.name))
def test_there_is_no_way_out_of_a_final_state(state: State) -> None:
    assert not TRANSITIONS[state]


@pytest.mark.parametrize("state", [state for state in State if state not in FINAL])
def test_every_other_state_is_reached_and_can_end(state: State) -> None:
    assert state in _reachable(State.DISCONNECTED)
    assert _reachable(state) & FINAL


def test_flight_is_only_entered_from_streaming_and_again_after_a_short_stall_of_ours() -> None:
    ways = [state for state in State if State.OFFBOARD in TRANSITIONS[state].values()]
    assert ways == [State.STREAMING, State.RETAKING]
    assert [state for state in State if State.RETAKING in TRANSITIONS[state].values()] == [
        State.OFFBOARD,
        State.RETAKING,
    ]


def test_a_watchdog_that_barks_leads_to_px4_and_never_back() -> None:
    assert _reachable(State.HOLDING) == {State.HOLDING, State.PILOT, State.LOST}
    assert transition(State.OFFBOARD, HandshakeEvent.FAULT_LAND) is State.LANDING


def test_once_flown_it_never_streams_or_flies_again() -> None:
    assert _reachable(State.LANDING) == {State.LANDING, State.LANDED, State.PILOT, State.LOST}


@pytest.mark.parametrize("state", [State.STREAMING, State.OFFBOARD, State.LANDING])
def test_the_pilot_can_take_over_whenever_setpoints_flow(state: State) -> None:
    assert transition(state, HandshakeEvent.TOOK_OVER) is State.PILOT


def test_every_state_hears_the_users_stop_unless_px4_is_taking_over_already() -> None:
    deaf = {state for state in State if state not in FINAL and HandshakeEvent.STOP not in TRANSITIONS[state]}
    assert deaf == {State.LANDING, State.HOLDING}


def test_every_event_is_used_and_every_state_has_a_row() -> None:
    assert set(TRANSITIONS) == set(State)
    assert {event for row in TRANSITIONS.values() for event in row} == set(HandshakeEvent)
