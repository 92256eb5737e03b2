"""What the companion makes of its situation: the first event that matters, and the reason in words.

Pure: `decide` looks and says; the changes of state stand in `handshake.TRANSITIONS`, what they bring in `companion`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from flightstack.error_statistics import ErrorStatistics
from mavlink_bridge import px4
from mavlink_bridge.faults import FAULTS, Reaction
from mavlink_bridge.handshake import HandshakeEvent, State
from mavlink_bridge.requests import CommandQueue
from mavlink_bridge.stalls import RETAKE_LIMIT_US, Stalls
from mavlink_bridge.vehicle_params import unsafe
from mavlink_bridge.vehicle_view import VehicleView, what_is_lost

SECOND_US = 1_000_000
_ESTIMATOR_READY = 0x27
"""ESTIMATOR_STATUS.flags: attitude, horizontal and vertical velocity, height."""
ROUND_TRIP_MAX_S = 0.055
"""Median of the last round trips: 20 ms each way, a tick and jitter are flown on a real PX4, no more was."""
_LANDING_S, _LANDING_MPS = 60.0, 0.3
_DISARMS_AFTER_S = 2.0
"""So long after it has landed PX4 disarms (COM_DISARM_LAND): what is disarmed sooner was so by somebody."""
_FALL = "velocity-against-imu"
"""The fault for which the fall of a disarmed vehicle is taken, before a heartbeat says what it is."""
_ESTIMATOR_POSITION = 0x18
"""Horizontal position, relative or absolute: one of them is enough."""


@dataclass(frozen=True, slots=True)
class CompanionConfig:
    """How the companion behaves; times in seconds."""

    arm: bool = False
    """Leave to select OFFBOARD and to arm; without it the pilot does both."""
    dry_run: bool = False
    """Connect and check, send no setpoint."""
    heartbeat_timeout_s: float = 10.0
    identify_timeout_s: float = 10.0
    ready_timeout_s: float = 30.0
    arm_timeout_s: float = 10.0
    link_loss_s: float = 3.0
    """Nothing heard for so long, or stamps that stand still: the link is lost (PX4 sends heartbeats at 1 Hz)."""
    blind_s: float = 0.5
    """The guard has flown for so much longer than not (no usable state, outside the envelope): hand back."""
    stream_before_offboard_s: float = 0.5
    tick_s: float = 0.004
    """Between two steps of the companion, where nothing is missed."""
    round_trip_max_s: float = ROUND_TRIP_MAX_S
    """Of the link; a later one is refused before the flight."""
    estimate: ErrorStatistics | None = None
    """How the autopilot's estimate errs; None: it is taken as it is reported."""
    speaks_first: bool = False
    """Heartbeats go out before anyone was heard: to whoever answers only those who speak."""
    dead_man: bool = True
    """Silence of ours is answered within 50 ms (or can't be: in lockstep); else COM_OF_LOSS_T must be short."""
    counted: Mapping[str, float] = field(default_factory=dict)
    """Parameters that certificates count on, by PX4's names: one that is told to be another ends protection."""
    contradictions: Callable[[Mapping[str, float]], list[str]] = lambda values: []
    """What PX4's parameters (by name) say against the vehicle file, one line each."""
    misplaced: Callable[[VehicleView], str] = lambda view: ""
    """Why the vehicle does not stand where its site counts on, or does not know where; looked at until it flies."""


@dataclass(slots=True)
class Situation:
    """What a decision is made from."""

    config: CompanionConfig
    view: VehicleView
    commands: CommandQueue
    state: State = State.DISCONNECTED
    entered_us: int = -1
    """Local time at which the state was entered."""
    system: int = 0
    """The vehicle's system id; 0 before the first heartbeat."""
    foreign_system: int = 0
    """Another autopilot on the link; 0: none."""
    unvouched: int = 0
    """Frames dropped for want of our key's signature before anybody was heard."""
    rival: str = ""
    """Another companion on the link, in words; empty: none."""
    stop_requested: str = ""
    """Why the user wants to stop; empty: goes on."""
    ending: str = ""
    """Why the companion itself ends the flight early; empty: goes on."""
    fresh: bool = False
    """Attitude, position and IMU are there and not stale."""
    catching_up: bool = False
    """What has piled up in a pause of ours is being read: what is heard may be over."""
    parameters_changed: bool = False
    """Since they were judged somebody set one."""
    gains_changed: bool = False
    """The vehicle told of a parameter that is not what certificates count on."""
    unfit: str = ""
    """Row of the fault table that says that the state can't be flown with; empty: it can."""
    trouble: str = ""
    """Row of the fault table that applies in flight; empty: none."""
    mission_done: bool = False
    landing_limit_s: float = math.inf
    """PX4 is to have landed and disarmed within so long (`landing_limit_s`)."""
    landing_for: str = ""
    """Why the landing began before the mission's end; empty: it did not."""
    dead_man_lost: str = ""
    """Why the dead-man is gone; empty: it is there, or there is none."""
    stalls: Stalls = field(default_factory=Stalls)
    """What the dead-man did."""


class Decision(NamedTuple):
    """What happened, and one line why where it ends the flight."""

    event: HandshakeEvent
    reason: str = ""


def decide(now: Situation, now_us: int) -> Decision | None:
    """The first thing that matters in the present state; local time `now_us`."""
    state = now.state
    look = _LOOKS.get(state)
    if look is None:
        return None
    if now.stop_requested and state not in (State.LANDING, State.HOLDING):
        return Decision(HandshakeEvent.STOP, now.stop_requested)
    if state is not State.DISCONNECTED and (lost := what_is_lost(now.view, now_us, now.config.link_loss_s)):
        return Decision(HandshakeEvent.LINK_LOST, f"{now.landing_for}; {lost}" if now.landing_for else lost)
    if state in (State.IDENTIFYING, State.STANDBY, State.STREAMING):
        if other := now.foreign_system or now.view.other_system:
            words = f"two autopilots on one link (systems {now.system} and {other}): refusing"
            return Decision(HandshakeEvent.FOREIGN, words)
        if now.rival:
            return Decision(HandshakeEvent.FOREIGN, f"{now.rival}: stop it first")
    return look(now, now_us)


def _disconnected(now: Situation, now_us: int) -> Decision | None:
    if now.system:
        return Decision(HandshakeEvent.HEARTBEAT)
    timeout_s = now.config.heartbeat_timeout_s
    if _in_state_s(now, now_us) > timeout_s:
        unsigned = f"; {now.unvouched} frames without the key's signature were dropped" if now.unvouched else ""
        return Decision(
            HandshakeEvent.TIMEOUT,
            f"no heartbeat of an autopilot within {timeout_s:g} s: "
            f"check that the vehicle or simulator runs and sends to this address and port{unsigned}",
        )
    return None


def _identifying(now: Situation, now_us: int) -> Decision | None:
    heartbeat = now.view.heartbeat
    assert heartbeat is not None
    if heartbeat.autopilot != px4.AUTOPILOT_PX4:
        return Decision(
            HandshakeEvent.FOREIGN,
            f"the autopilot of system {now.system} is no PX4 (MAV_AUTOPILOT {heartbeat.autopilot}, "
            f"PX4 is {px4.AUTOPILOT_PX4}): this companion flies PX4 only",
        )
    if heartbeat.type != px4.TYPE_QUADROTOR:
        return Decision(
            HandshakeEvent.FOREIGN,
            f"the vehicle is no quadrotor (MAV_TYPE {heartbeat.type}): this companion flies quadrotors only",
        )
    if now.view.version is not None:
        return Decision(HandshakeEvent.IDENTIFIED)
    if _in_state_s(now, now_us) > now.config.identify_timeout_s:
        return Decision(
            HandshakeEvent.TIMEOUT,
            f"system {now.system} did not answer who it is (AUTOPILOT_VERSION): is the link two-way?",
        )
    return None


def _standby(now: Situation, now_us: int) -> Decision | None:
    view, config = now.view, now.config
    if view.armed and (config.arm or view.in_offboard or view.intends_offboard):
        # Setpoints would make PX4 go back to OFFBOARD by itself, even out of a failsafe that has landed.
        return Decision(
            HandshakeEvent.BUSY,
            f"the vehicle is already armed (in {view.mode_name}), not by this companion: not taking over",
        )
    if view.params.settled and (wrong := _parameters_wrong(now)):
        return Decision(HandshakeEvent.UNFIT, wrong)
    missing = _missing(now)
    if now.unfit:
        missing.append(FAULTS[now.unfit].what)
    if not missing:
        return Decision(HandshakeEvent.READY)
    if _in_state_s(now, now_us) > config.ready_timeout_s:
        words = f"not ready within {config.ready_timeout_s:g} s: {', '.join(missing)}{view.says(now_us, 10)}"
        return Decision(HandshakeEvent.TIMEOUT, words)
    return None


def _parameters_wrong(now: Situation) -> str:
    """Why nobody should fly with the parameters as they are; empty where they are right, and in a dry run, which goes
    on and tells everything that it finds."""
    if now.config.dry_run:
        return ""
    values = now.view.params.values
    return unsafe(values, dead_man=now.config.dead_man) or "; ".join(now.config.contradictions(values))


def _missing(now: Situation) -> list[str]:
    """What stands between the vehicle and a flight, in words."""
    missing = [] if now.fresh else ["no fresh attitude, position and IMU streams"]
    if slow := _too_slow(now):
        missing.append(slow)
    if not estimate_is_good(now.view.estimator_flags):
        missing.append(f"estimate not good (ESTIMATOR_STATUS flags {now.view.estimator_flags:#x})")
    if now.commands.is_waiting:
        missing.append("streams asked for, not all answered")
    if now.view.landed_state == 0:
        missing.append("landed state unknown")
    if not now.view.params.settled:
        missing.append(f"parameters not told ({', '.join(now.view.params.missing) or 'still asking'})")
    if now.view.armed and now.view.intended_at_us < 0:
        missing.append("armed, and which mode it would go back to is not known (CURRENT_MODE)")
    return missing


def estimate_is_good(flags: int) -> bool:
    """Whether ESTIMATOR_STATUS.flags have all that a flight needs."""
    return flags & _ESTIMATOR_READY == _ESTIMATOR_READY and bool(flags & _ESTIMATOR_POSITION)


def _too_slow(now: Situation) -> str:
    """What is wrong with the link's latency; empty where nothing is."""
    trip_s, most_s = 1e-6 * now.view.round_trip_us, now.config.round_trip_max_s
    return (
        "" if trip_s <= most_s else f"link too slow: {1e3 * trip_s:.0f} ms there and back, {1e3 * most_s:.0f} at most"
    )


def _streaming(now: Situation, now_us: int) -> Decision | None:
    view, config = now.view, now.config
    if view.armed and view.in_offboard and not now.catching_up:
        return Decision(HandshakeEvent.ENGAGED)
    if view.armed and view.would_return:
        return Decision(
            HandshakeEvent.TOOK_OVER,
            f"the vehicle went from OFFBOARD into {view.mode_name} before this companion flew it, and setpoints would "
            "bring it back: hands off",
        )
    if now.parameters_changed and (wrong := _parameters_wrong(now)):
        return Decision(HandshakeEvent.UNFIT, wrong)
    if now.unfit:
        return Decision(HandshakeEvent.UNFIT, f"not fit to fly ({now.unfit}): {FAULTS[now.unfit].what}")
    if wrong := _too_slow(now) or config.misplaced(view):
        return Decision(HandshakeEvent.UNFIT, wrong)
    in_state_s = _in_state_s(now, now_us)
    if not config.arm or in_state_s < config.stream_before_offboard_s:
        return None
    arm_request = now.commands.status(px4.Cmd.COMPONENT_ARM_DISARM)
    if arm_request.accepted and view.mode_at_us > arm_request.answered_us and not view.in_offboard:
        if now.stalls.is_held and now.stalls.own_hold(view.custom_mode):  # refused, it is disarmed
            now.stalls.judge(now_us, is_taking_back=False)
            return Decision(HandshakeEvent.UNFIT, f"stalled while arming: {now.stalls.words}")
        lately = now.stalls.asked_lately(view.custom_mode, now_us)
        left = f"{lately}: hands off" if lately else ": leaving the vehicle to the pilot"
        return Decision(HandshakeEvent.TOOK_OVER, f"the mode changed to {view.mode_name} while arming{left}")
    if in_state_s > config.stream_before_offboard_s + config.arm_timeout_s:
        what = "arming" if view.in_offboard else "OFFBOARD mode"
        command = px4.Cmd.COMPONENT_ARM_DISARM if view.in_offboard else px4.Cmd.DO_SET_MODE
        return Decision(HandshakeEvent.ARM_REFUSED, f"{what} refused: {_why_refused(now, command, now_us)}")
    return None


def _why_refused(now: Situation, command: px4.Cmd, now_us: int) -> str:
    result = now.commands.status(command).result
    answer = "no answer" if result is None else px4.describe_result(result)
    if result == 0:
        disarmed = command is px4.Cmd.COMPONENT_ARM_DISARM and not now.view.armed
        answer = "accepted, and then the vehicle was disarmed" if disarmed else answer
    return answer + (now.view.says(now_us, 12) or " (the vehicle gave no reason)")


def _offboard(now: Situation, now_us: int) -> Decision | None:
    view = now.view
    if ended := view.ended_by_others(now.entered_us):
        return Decision(HandshakeEvent.TOOK_OVER, ended + (view.says(now_us, 3) if view.armed else ""))
    if now.stalls.is_held:
        return _held(now, now_us)
    if view.mode_at_us > now.entered_us and not view.in_offboard:
        if now.stalls.is_late_hold(view.custom_mode, now_us):
            return Decision(HandshakeEvent.STALLED)
        why = now.stalls.asked_lately(view.custom_mode, now_us) or ", not by this companion"
        reason = f"the vehicle left OFFBOARD for {view.mode_name}{why}: hands off"
        return Decision(HandshakeEvent.TOOK_OVER, reason + view.says(now_us, 3))
    if now.ending:
        return Decision(HandshakeEvent.ENDED, now.ending)
    if now.trouble:
        fault = FAULTS[now.trouble]
        event = HandshakeEvent.FAULT_HOLD if fault.reaction is Reaction.HOLD else HandshakeEvent.FAULT_LAND
        return Decision(event, f"{now.trouble}: {fault.what}")
    return Decision(HandshakeEvent.MISSION_DONE) if now.mission_done else None


def _held(now: Situation, now_us: int, *, is_taking_back: bool = False) -> Decision:
    """The dead-man commanded Hold: taken back after a short stall, else the flight is over."""
    why = now.stalls.judge(now_us, is_taking_back=is_taking_back)
    if not why:
        return Decision(HandshakeEvent.STALLED)
    if now.stalls.report.touched:
        return Decision(HandshakeEvent.TOOK_OVER, f"{now.stalls.words}: {why}: hands off")
    now.trouble = "stalled-long"
    return Decision(HandshakeEvent.FAULT_HOLD, f"stalled-long: {now.stalls.words}: {why}")


def _retaking(now: Situation, now_us: int) -> Decision | None:
    view, stalls = now.view, now.stalls
    if ended := view.ended_by_others(now.entered_us):
        return Decision(HandshakeEvent.TOOK_OVER, ended)
    if stalls.is_held:
        return _held(now, now_us, is_taking_back=True)
    asked_us = now.commands.status(px4.Cmd.DO_SET_MODE).sent_us
    seen = view.mode_at_us > now.entered_us
    if seen and not view.in_offboard and not stalls.own_hold(view.custom_mode):
        reason = f"after a stall the vehicle is in {view.mode_name}, not by this companion: hands off"
        return Decision(HandshakeEvent.TOOK_OVER, reason + view.says(now_us, 3))
    if seen and view.in_offboard and (now.entered_us <= asked_us < view.mode_at_us or stalls.hold_was_lost(view)):
        stalls.is_back(now_us, hold_seen=asked_us >= now.entered_us)
        return Decision(HandshakeEvent.RETAKEN)
    if now_us - now.entered_us > RETAKE_LIMIT_US:
        now.trouble = "stalled-long"
        return Decision(HandshakeEvent.FAULT_HOLD, f"stalled-long: {stalls.words}: OFFBOARD could not be taken back")
    return None


def _landing(now: Situation, now_us: int) -> Decision | None:
    view = now.view
    why = f"{now.landing_for}; " if now.landing_for else ""
    if (ended := view.ended_by_others(now.entered_us)) and not (view.armed and view.on_ground):
        if view.armed or (why.startswith(_FALL) and _in_state_s(now, now_us) < _DISARMS_AFTER_S):
            return Decision(HandshakeEvent.TOOK_OVER, f"{why}{ended}")
        return Decision(HandshakeEvent.DISARMED)
    settled = view.mode_at_us > now.entered_us + SECOND_US // 2
    if settled and view.custom_mode not in (px4.MODE_LAND, px4.MODE_OFFBOARD):
        return Decision(
            HandshakeEvent.TOOK_OVER,
            f"{why}the mode changed to {view.mode_name} while landing: leaving the vehicle to the pilot",
        )
    if _in_state_s(now, now_us) > now.landing_limit_s:
        where = "on the ground" if view.on_ground else "in the air"
        stands = (
            ", and stands, for its motors idle and it feels its weight" if view.stands and not view.on_ground else ""
        )
        return Decision(
            HandshakeEvent.TIMEOUT,
            f"{why}{now.landing_limit_s:.0f} s after Land was commanded the vehicle is armed, {where} by its own "
            f"report{stands}: left to PX4{view.says(now_us, 10)}",
        )
    return None


def landing_limit_s(height_m: float) -> float:
    """How long PX4 may take from a height above the start to disarmed: at 0.3 m/s (the default of MPC_LAND_CRWL; no
    MPC_LAND_SPEED may be below 0.6), and a minute for ground that is lower and for the land detector."""
    return _LANDING_S + max(height_m, 0.0) / _LANDING_MPS


def _holding(now: Situation, now_us: int) -> Decision | None:
    view = now.view
    if view.ended_by_others(now.entered_us) or (view.mode_at_us > now.entered_us and not view.in_offboard):
        return Decision(HandshakeEvent.HANDED_OVER)
    if _in_state_s(now, now_us) > now.config.link_loss_s:
        return Decision(HandshakeEvent.TIMEOUT)
    return None


def _in_state_s(now: Situation, now_us: int) -> float:
    return (now_us - now.entered_us) / SECOND_US


_LOOKS: dict[State, Callable[[Situation, int], Decision | None]] = {
    State.DISCONNECTED: _disconnected,
    State.IDENTIFYING: _identifying,
    State.STANDBY: _standby,
    State.STREAMING: _streaming,
    State.OFFBOARD: _offboard,
    State.RETAKING: _retaking,
    State.LANDING: _landing,
    State.HOLDING: _holding,
}
"""State -> what to look at; the final ones are not there."""
