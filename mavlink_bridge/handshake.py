"""The offboard handshake as one table: which event takes the companion from which state to which.

Theory of operation
-------------------
The companion meets a vehicle, makes sure that it is one PX4 multicopter, streams harmless setpoints, and only then
hands the vehicle to the flight stack; it brings it down again and leaves it disarmed in Hold.

Rule 1: every change of state stands in `TRANSITIONS`; code elsewhere reports events and acts on states.
Rule 2: the last four states are final.  There is no way back into flight but a new run: a pilot who took over keeps
the vehicle, and nothing here arms twice.

States in the order of a good flight:

* DISCONNECTED: nothing heard from an autopilot.
* IDENTIFYING: a heartbeat was heard; version asked for, who it is is being checked.
* STANDBY: it is a PX4 multicopter; streams are asked for, nothing is commanded until it is ready.
* STREAMING: setpoints go out that do nothing on the ground and hold the place in the air.  With leave to arm the
  companion selects OFFBOARD and arms, else it waits for the pilot to do so.
* OFFBOARD: armed, in OFFBOARD, flown by the stack.
* RETAKING: after a short stall of ours the dead-man gave the vehicle to PX4's Hold; OFFBOARD is commanded again.
* LANDING: AUTO.LAND is commanded; PX4 lands and disarms.
* HOLDING: a watchdog barked and PX4's Hold is commanded; safe setpoints until PX4 is seen in it.
* LANDED: disarmed on the ground, Hold selected so that OFFBOARD isn't left standing.
* PILOT: someone else changed the mode or disarmed, or PX4's Hold has the vehicle for the pilot: hands off.
* LOST: the link went away for good, or PX4 didn't take the vehicle back or land it in time: the stream is stopped.
* REFUSED: something is wrong before the flight; the reason is one line.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType


class State(Enum):
    """Where the companion stands; see the module's text."""

    __hash__ = object.__hash__  # members are single; Enum's own hash is Python code, and every tick asks for it
    DISCONNECTED = "disconnected"
    IDENTIFYING = "identifying"
    STANDBY = "standby"
    STREAMING = "streaming"
    OFFBOARD = "offboard"
    RETAKING = "retaking"
    LANDING = "landing"
    HOLDING = "holding"
    LANDED = "landed"
    PILOT = "pilot"
    LOST = "lost"
    REFUSED = "refused"


class HandshakeEvent(Enum):
    """What can happen to it."""

    HEARTBEAT = "an autopilot's heartbeat arrived"
    IDENTIFIED = "it is a PX4 multicopter and said which version"
    FOREIGN = "it is not a vehicle that this companion can fly"
    READY = "streams arrive, the estimate is good, arming is possible"
    BUSY = "it is armed already, and not by us"
    TIMEOUT = "the peer did not get there in time"
    ARM_REFUSED = "OFFBOARD or arming was refused"
    ENGAGED = "armed and in OFFBOARD"
    MISSION_DONE = "the scenario's end is reached"
    STOP = "the user asked to stop"
    ENDED = "the companion ends the flight early"
    TOOK_OVER = "the mode was changed or the vehicle disarmed by someone else"
    DISARMED = "disarmed after our landing"
    LINK_LOST = "nothing heard for too long"
    UNFIT = "its state or its parameters are not fit to fly with"
    FAULT_LAND = "a watchdog barked: PX4 is to land"
    FAULT_HOLD = "a watchdog barked: PX4 is to hold"
    STALLED = "a short stall: the dead-man commanded Hold"
    RETAKEN = "the vehicle is in OFFBOARD again"
    HANDED_OVER = "PX4 has taken the vehicle"


FINAL = frozenset({State.LANDED, State.PILOT, State.LOST, State.REFUSED})

_S, _E = State, HandshakeEvent
TRANSITIONS: Mapping[State, Mapping[HandshakeEvent, State]] = MappingProxyType(
    {
        _S.DISCONNECTED: {_E.HEARTBEAT: _S.IDENTIFYING, _E.TIMEOUT: _S.REFUSED, _E.STOP: _S.REFUSED},
        _S.IDENTIFYING: {
            _E.IDENTIFIED: _S.STANDBY,
            _E.FOREIGN: _S.REFUSED,
            _E.TIMEOUT: _S.REFUSED,
            _E.LINK_LOST: _S.REFUSED,
            _E.STOP: _S.REFUSED,
        },
        _S.STANDBY: {
            _E.READY: _S.STREAMING,
            _E.FOREIGN: _S.REFUSED,
            _E.UNFIT: _S.REFUSED,
            _E.BUSY: _S.REFUSED,
            _E.TIMEOUT: _S.REFUSED,
            _E.LINK_LOST: _S.REFUSED,
            _E.STOP: _S.REFUSED,
        },
        _S.STREAMING: {
            _E.ENGAGED: _S.OFFBOARD,
            _E.ARM_REFUSED: _S.REFUSED,
            _E.FOREIGN: _S.REFUSED,
            _E.UNFIT: _S.REFUSED,
            _E.TOOK_OVER: _S.PILOT,
            _E.TIMEOUT: _S.REFUSED,
            _E.LINK_LOST: _S.REFUSED,
            _E.STOP: _S.REFUSED,
        },
        _S.OFFBOARD: {
            _E.MISSION_DONE: _S.LANDING,
            _E.STOP: _S.LANDING,
            _E.ENDED: _S.LANDING,
            _E.FAULT_LAND: _S.LANDING,
            _E.FAULT_HOLD: _S.HOLDING,
            _E.TOOK_OVER: _S.PILOT,
            _E.LINK_LOST: _S.LOST,
            _E.STALLED: _S.RETAKING,
        },
        _S.RETAKING: {
            _E.RETAKEN: _S.OFFBOARD,
            _E.STALLED: _S.RETAKING,
            _E.STOP: _S.LANDING,
            _E.FAULT_HOLD: _S.HOLDING,
            _E.TOOK_OVER: _S.PILOT,
            _E.LINK_LOST: _S.LOST,
        },
        _S.HOLDING: {_E.HANDED_OVER: _S.PILOT, _E.TIMEOUT: _S.LOST, _E.LINK_LOST: _S.LOST},
        _S.LANDING: {
            _E.DISARMED: _S.LANDED,
            _E.TOOK_OVER: _S.PILOT,
            _E.TIMEOUT: _S.LOST,
            _E.LINK_LOST: _S.LOST,
        },
        _S.LANDED: {},
        _S.PILOT: {},
        _S.LOST: {},
        _S.REFUSED: {},
    }
)


def transition(state: State, event: HandshakeEvent) -> State | None:
    """The state after `event` in `state`, None where the event means nothing there."""
    return TRANSITIONS[state].get(event)
