"""What is made of a situation, condition by condition and limit by limit, against a table written by hand.

The oracle is the contract's section on the handshake and PX4's documentation; the view is a stub, so that each
condition can be had alone.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from mavlink_bridge import px4
from mavlink_bridge.decide import CompanionConfig, Situation, decide, estimate_is_good, landing_limit_s
from mavlink_bridge.faults import FAULTS, Reaction
from mavlink_bridge.handshake import FINAL, HandshakeEvent, State
from mavlink_bridge.vehicle_view import VehicleView

S = 1_000_000
ENTERED = 100 * S
E = HandshakeEvent
GOOD = 0x2F
SAFE = {"COM_OF_LOSS_T": 1.0}
WRONG = {**SAFE, "wrong": 1.0}
REQUEST = {"accepted": False, "answered_us": -1, "sent_us": -1, "result": None}
CONFIG = CompanionConfig(arm=True, contradictions=lambda values: ["4 kg are missing"] if "wrong" in values else [])


def situation(state: State, view: dict[str, Any] | None = None, **changes: Any) -> Situation:
    """A quadrotor on a PX4 that is ready, and of which the last word came as the state was entered."""
    seen = SimpleNamespace(
        heartbeat=SimpleNamespace(autopilot=12, type=2, system_status=4), version=object(), armed=False,
        in_offboard=False, intends_offboard=False, would_return=False, mode_name="Position", estimator_flags=GOOD,
        landed_state=1, intended_at_us=1, round_trip_us=55_000, mode_at_us=0, heartbeat_at_us=0, heard_at_us=ENTERED,
        stood_us=0, stands=False, custom_mode=px4.MODE_OFFBOARD, on_ground=False, other_system=0,
        params=SimpleNamespace(settled=True, values=SAFE, missing=()),
        texts=(), charge_percent=-1,
    )  # fmt: skip
    seen.ended_by_others = partial(VehicleView.ended_by_others, seen)
    seen.says = partial(VehicleView.says, seen)
    vars(seen).update(view or {})
    asked = changes.pop("asked", {})
    status = lambda command: SimpleNamespace(**{**REQUEST, **asked.get(command, {})})  # noqa: E731
    commands = SimpleNamespace(status=status, is_waiting=False)
    stalls = changes.pop("stalls", {})
    held = SimpleNamespace(
        is_held=False, words="no setpoint for 600 ms", own_hold=lambda mode: mode == px4.MODE_HOLD,
        hold_was_lost=lambda view: False, report=SimpleNamespace(touched=False, silent_ns=0),
        judge=lambda now_us, is_taking_back: "too long",
        is_back=lambda now_us, hold_seen: None, is_late_hold=lambda mode, now_us: False,
        asked_lately=lambda mode, now_us: "",
    )  # fmt: skip
    vars(held).update(stalls)
    now = Situation(CONFIG, seen, commands, state, ENTERED, system=1, fresh=True)  # type: ignore[arg-type]
    now.stalls = held  # type: ignore[assignment]
    return replace(now, **changes)


def event(now: Situation, after_s: float) -> HandshakeEvent | None:
    now.view.heard_at_us = max(now.view.heard_at_us, ENTERED + round(after_s * S) if now.view.heard_at_us else 0)
    decision = decide(now, ENTERED + round(after_s * S))
    return None if decision is None else decision.event


LATER = ENTERED + S // 100
ARMED = {"armed": True, "heartbeat_at_us": LATER}
DISARMED = {"armed": False, "heartbeat_at_us": LATER}
FLYING = {**ARMED, "in_offboard": True, "mode_at_us": LATER}
AWAY = {**ARMED, "in_offboard": False, "mode_at_us": LATER, "custom_mode": px4.MODE_HOLD}
ELSEWHERE = {**AWAY, "custom_mode": px4.MODE_LAND + 1}
ARMING = px4.Cmd.COMPONENT_ARM_DISARM
SET_MODE = px4.Cmd.DO_SET_MODE
TABLE: list[tuple[State, dict[str, Any], dict[str, Any], float, HandshakeEvent | None]] = [
    (State.DISCONNECTED, {}, {}, 0.1, E.HEARTBEAT),
    (State.DISCONNECTED, {}, {"system": 0}, 10.0, None),
    (State.DISCONNECTED, {}, {"system": 0}, 10.1, E.TIMEOUT),
    (State.DISCONNECTED, {"heard_at_us": 0}, {"system": 0}, 9.0, None),  # nobody can be lost yet
    (State.IDENTIFYING, {}, {}, 0.1, E.IDENTIFIED),
    (State.IDENTIFYING, {"heartbeat": SimpleNamespace(autopilot=3, type=2)}, {}, 0.1, E.FOREIGN),
    (State.IDENTIFYING, {"heartbeat": SimpleNamespace(autopilot=12, type=13)}, {}, 0.1, E.FOREIGN),
    (State.IDENTIFYING, {"version": None}, {}, 10.0, None),
    (State.IDENTIFYING, {"version": None}, {}, 10.1, E.TIMEOUT),
    (State.IDENTIFYING, {}, {"foreign_system": 2}, 0.1, E.FOREIGN),
    (State.IDENTIFYING, {}, {"rival": "another companion"}, 0.1, E.FOREIGN),
    (State.STANDBY, {}, {}, 0.1, E.READY),
    (State.STANDBY, {}, {"foreign_system": 2}, 0.1, E.FOREIGN),
    (State.STANDBY, {}, {"rival": "another companion"}, 0.1, E.FOREIGN),
    (State.STANDBY, {}, {"stop_requested": "enough"}, 0.1, E.STOP),
    (State.STANDBY, {"armed": True}, {}, 0.1, E.BUSY),
    (State.STANDBY, {"armed": True}, {"config": replace(CONFIG, arm=False)}, 0.1, E.READY),
    (State.STANDBY, {"armed": True, "in_offboard": True}, {"config": replace(CONFIG, arm=False)}, 0.1, E.BUSY),
    (State.STANDBY, {"armed": True, "intends_offboard": True}, {"config": replace(CONFIG, arm=False)}, 0.1, E.BUSY),
    (State.STANDBY, {"armed": True, "intended_at_us": -1}, {"config": replace(CONFIG, arm=False)}, 0.1, None),
    (State.STANDBY, {"armed": True, "intended_at_us": 0}, {"config": replace(CONFIG, arm=False)}, 0.1, E.READY),
    (State.STANDBY, {"intended_at_us": -1}, {}, 0.1, E.READY),  # only a vehicle that is armed goes back to anything
    (State.STANDBY, {"params": SimpleNamespace(settled=True, values=WRONG, missing=())}, {}, 0.1, E.UNFIT),
    (State.STANDBY, {"params": SimpleNamespace(settled=True, values=WRONG, missing=())},
     {"config": replace(CONFIG, dry_run=True)}, 0.1, E.READY),
    (State.STANDBY, {"params": SimpleNamespace(settled=False, values=WRONG, missing=())}, {}, 0.1, None),
    (State.STANDBY, {"params": SimpleNamespace(settled=True, values={}, missing=())}, {}, 0.1, E.UNFIT),
    (State.STANDBY, {}, {"config": replace(CONFIG, dead_man=False)}, 0.1, E.UNFIT),
    (State.STANDBY, {}, {"fresh": False}, 30.0, None),
    (State.STANDBY, {}, {"fresh": False}, 30.1, E.TIMEOUT),
    (State.STANDBY, {"round_trip_us": 55_001}, {}, 0.1, None),
    (State.STANDBY, {"estimator_flags": GOOD & ~0x20}, {}, 0.1, None),
    (State.STANDBY, {"landed_state": 0}, {}, 0.1, None),
    (State.STANDBY, {}, {"unfit": "estimate-reset"}, 0.1, None),
    (State.STREAMING, {"armed": True, "in_offboard": True}, {}, 0.1, E.ENGAGED),
    (State.STREAMING, {"armed": True}, {}, 0.1, None),
    (State.STREAMING, {"armed": True, "would_return": True}, {}, 0.1, E.TOOK_OVER),
    (State.STREAMING, {"would_return": True}, {}, 0.1, None),
    (State.STREAMING, {"in_offboard": True}, {}, 0.1, None),
    (State.STREAMING, {}, {"rival": "another companion"}, 0.1, E.FOREIGN),
    (State.STREAMING, {}, {"foreign_system": 2}, 0.1, E.FOREIGN),
    (State.STREAMING, {"round_trip_us": 55_001}, {}, 0.1, E.UNFIT),
    (State.STREAMING, {}, {"config": replace(CONFIG, misplaced=lambda view: "carried 30 m")}, 0.1, E.UNFIT),
    (State.STREAMING, {"params": SimpleNamespace(settled=True, values=WRONG, missing=())}, {}, 0.1, None),
    (State.STREAMING, {"params": SimpleNamespace(settled=True, values=WRONG, missing=())},
     {"parameters_changed": True}, 0.1, E.UNFIT),
    (State.STREAMING, {}, {"parameters_changed": True}, 0.1, None),
    (State.STREAMING, {}, {"unfit": "estimate-reset"}, 0.1, E.UNFIT),
    (State.STREAMING, {}, {}, 10.5, None),
    (State.STREAMING, {}, {}, 10.6, E.ARM_REFUSED),
    (State.STREAMING, {}, {"config": replace(CONFIG, arm=False)}, 60.0, None),
    (State.STREAMING, {"mode_at_us": 3}, {"asked": {ARMING: {"accepted": True, "answered_us": 2}}}, 0.5, E.TOOK_OVER),
    (State.STREAMING, {"mode_at_us": 3}, {"asked": {ARMING: {"accepted": True, "answered_us": 2}}}, 0.4, None),
    (State.STREAMING, {"mode_at_us": 2}, {"asked": {ARMING: {"accepted": True, "answered_us": 2}}}, 0.6, None),
    (State.STREAMING, {"mode_at_us": 3}, {"asked": {ARMING: {"accepted": False, "answered_us": 2}}}, 0.6, None),
    (State.STREAMING, {"mode_at_us": 3, "in_offboard": True},
     {"asked": {ARMING: {"accepted": True, "answered_us": 2}}}, 0.6, None),
    (State.STREAMING, {"mode_at_us": 3, "custom_mode": px4.MODE_HOLD},
     {"asked": {ARMING: {"accepted": True, "answered_us": 2}}, "stalls": {"is_held": True}}, 0.6, E.UNFIT),
    (State.STREAMING, {"mode_at_us": 3, "custom_mode": px4.MODE_LAND},
     {"asked": {ARMING: {"accepted": True, "answered_us": 2}}, "stalls": {"is_held": True}}, 0.6, E.TOOK_OVER),
    (State.STREAMING, {"mode_at_us": 3, "custom_mode": px4.MODE_HOLD},
     {"asked": {ARMING: {"accepted": True, "answered_us": 2}}}, 0.6, E.TOOK_OVER),
    (State.OFFBOARD, FLYING, {}, 1.0, None),
    (State.OFFBOARD, FLYING, {"foreign_system": 2, "rival": "another"}, 1.0, None),  # in flight nobody is refused
    (State.OFFBOARD, FLYING, {"mission_done": True}, 1.0, E.MISSION_DONE),
    (State.OFFBOARD, FLYING, {"stop_requested": "enough"}, 1.0, E.STOP),
    (State.OFFBOARD, FLYING, {"ending": "swinging"}, 1.0, E.ENDED),
    (State.OFFBOARD, AWAY, {"ending": "swinging"}, 1.0, E.TOOK_OVER),  # the pilot comes first
    (State.OFFBOARD, DISARMED, {}, 1.0, E.TOOK_OVER),
    (State.OFFBOARD, {"armed": False, "heartbeat_at_us": ENTERED, "in_offboard": True}, {}, 1.0, None),
    (State.OFFBOARD, AWAY, {}, 1.0, E.TOOK_OVER),
    (State.OFFBOARD, {**AWAY, "mode_at_us": ENTERED}, {}, 1.0, None),
    (State.OFFBOARD, AWAY, {"stalls": {"is_held": True, "judge": lambda now_us, is_taking_back: ""}}, 1.0, E.STALLED),
    (State.OFFBOARD, AWAY, {"stalls": {"is_held": True}}, 1.0, E.FAULT_HOLD),
    (State.OFFBOARD, AWAY, {"stalls": {"is_held": True, "report": SimpleNamespace(touched=True)}}, 1.0, E.TOOK_OVER),
    (State.RETAKING, AWAY, {}, 1.0, None),
    (State.RETAKING, AWAY, {}, 1.01, E.FAULT_HOLD),
    (State.RETAKING, ELSEWHERE, {}, 0.5, E.TOOK_OVER),
    (State.RETAKING, {**ELSEWHERE, "mode_at_us": ENTERED}, {}, 0.5, None),
    (State.RETAKING, DISARMED, {}, 0.5, E.TOOK_OVER),
    (State.RETAKING, {"armed": False, "heartbeat_at_us": ENTERED}, {}, 0.5, None),
    (State.RETAKING, AWAY, {"stalls": {"is_held": True, "judge": lambda now_us, is_taking_back: ""}}, 0.5, E.STALLED),
    (State.RETAKING, FLYING, {"asked": {SET_MODE: {"sent_us": ENTERED}}}, 0.5, E.RETAKEN),
    (State.RETAKING, FLYING, {"asked": {SET_MODE: {"sent_us": ENTERED - 1}}}, 0.5, None),
    (State.RETAKING, FLYING, {"asked": {SET_MODE: {"sent_us": LATER}}}, 0.5, None),
    (State.RETAKING, FLYING, {"stalls": {"hold_was_lost": lambda view: True}}, 0.5, E.RETAKEN),
    (State.LANDING, DISARMED, {}, 1.0, E.DISARMED),
    (State.LANDING, {"armed": False, "heartbeat_at_us": ENTERED}, {}, 1.0, None),
    (State.LANDING, ARMED, {"landing_limit_s": 60.0}, 60.0, None),
    (State.LANDING, ARMED, {"landing_limit_s": 60.0}, 60.1, E.TIMEOUT),
    (State.LANDING, {**ARMED, "custom_mode": px4.MODE_HOLD, "mode_at_us": ENTERED + S // 2 + 1}, {}, 1.0, E.TOOK_OVER),
    (State.LANDING, {**ARMED, "custom_mode": px4.MODE_HOLD, "mode_at_us": ENTERED + S // 2}, {}, 1.0, None),
    (State.LANDING, {**ARMED, "custom_mode": px4.MODE_LAND, "mode_at_us": ENTERED + S}, {}, 1.5, None),
    (State.LANDING, {**ARMED, "custom_mode": px4.MODE_OFFBOARD, "mode_at_us": ENTERED + S}, {}, 1.5, None),
    (State.LANDING, ARMED, {"stop_requested": "enough"}, 1.0, None),  # it lands already
    (State.HOLDING, ARMED, {"stop_requested": "enough"}, 1.0, None),  # PX4 is being given the vehicle already
    (State.HOLDING, {**AWAY, "custom_mode": px4.MODE_HOLD}, {}, 0.5, E.HANDED_OVER),
    (State.HOLDING, DISARMED, {}, 0.5, E.HANDED_OVER),
    (State.HOLDING, {"armed": False, "heartbeat_at_us": ENTERED}, {}, 0.5, None),
    (State.HOLDING, {**AWAY, "mode_at_us": ENTERED}, {}, 3.0, None),
    (State.HOLDING, {**AWAY, "mode_at_us": ENTERED}, {}, 3.1, E.TIMEOUT),
]  # fmt: skip


@pytest.mark.parametrize(("state", "view", "changes", "after_s", "expected"), TABLE)
def test_what_is_made_of_it(
    state: State, view: dict[str, Any], changes: dict[str, Any], after_s: float, expected: HandshakeEvent | None
) -> None:
    if "unfit" in changes:
        changes = {**changes, "unfit": next(iter(FAULTS))}
    assert event(situation(state, view, **changes), after_s) == expected


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_flight_ends_it_as_its_row_says(name: str) -> None:
    holds = FAULTS[name].reaction is Reaction.HOLD
    assert event(situation(State.OFFBOARD, FLYING, trouble=name), 1.0) == (E.FAULT_HOLD if holds else E.FAULT_LAND)


@pytest.mark.parametrize("state", [state for state in State if state not in FINAL and state is not State.DISCONNECTED])
def test_a_link_is_lost_after_three_seconds_of_silence_in_every_state(state: State) -> None:
    now = situation(state, {**FLYING, "heard_at_us": 1})
    for silent_us, lost in ((3 * S, False), (3 * S + 1, True)):
        decision = decide(now, 1 + silent_us)
        assert (decision is not None and decision.event is E.LINK_LOST) == lost
        if lost:
            assert decision is not None
            assert decision.reason == "link lost: nothing heard for 3.0 s"


@pytest.mark.parametrize("state", sorted(FINAL, key=lambda state: state.value))
def test_nothing_happens_after_the_end(state: State) -> None:
    assert decide(situation(state, stop_requested="enough", mission_done=True), ENTERED + 60 * S) is None


def test_what_nobody_said_is_not_so() -> None:
    """A situation begins with nothing known: no streams, no fault, no stop, no way to have landed late."""
    known = situation(State.STANDBY)
    blank = Situation(known.config, known.view, known.commands, State.STANDBY, ENTERED)
    assert decide(blank, ENTERED) is None
    assert event(replace(known, fresh=True), 0.1) is E.READY
    for state, view in ((State.OFFBOARD, FLYING), (State.LANDING, ARMED)):
        given = situation(state, view)
        assert decide(Situation(given.config, given.view, given.commands, state, ENTERED), ENTERED + S) is None


def test_without_leave_it_neither_arms_nor_flies_with_deadly_parameters() -> None:
    deadly = {"params": SimpleNamespace(settled=True, values={"COM_OF_LOSS_T": 9.0}, missing=())}
    assert event(situation(State.STREAMING, config=CompanionConfig()), 60.0) is None
    assert event(situation(State.STANDBY, deadly, config=CompanionConfig()), 0.1) is E.UNFIT
    safe = {"params": SimpleNamespace(settled=True, values={"COM_OF_LOSS_T": 1.0}, missing=())}
    assert event(situation(State.STANDBY, safe, config=CompanionConfig()), 0.1) is E.READY  # a dead-man is there


def test_times_are_those_that_the_safety_page_promises() -> None:
    """Half a second without a usable state, 20 ms each way, half a second of setpoints before OFFBOARD."""
    times = CompanionConfig()
    assert (times.blind_s, times.round_trip_max_s, times.stream_before_offboard_s) == (0.5, 0.055, 0.5)
    assert (times.tick_s, times.link_loss_s) == (0.004, 3.0)


def test_a_stall_that_ends_the_flight_is_a_fault_of_its_own() -> None:
    for state, stalls, after_s in ((State.OFFBOARD, {"is_held": True}, 0.5), (State.RETAKING, {}, 1.5)):
        now = situation(state, AWAY, stalls=stalls)
        assert event(now, after_s) is E.FAULT_HOLD
        assert now.trouble == "stalled-long"


def test_an_estimate_needs_attitude_velocities_height_and_one_horizontal_position() -> None:
    """MAVLink's ESTIMATOR_STATUS_FLAGS: attitude 1, velocities 2 and 4, positions 8 (relative) and 16, height 32."""
    need = 1 + 2 + 4 + 32
    assert estimate_is_good(need + 8)
    assert estimate_is_good(need + 16)
    assert not estimate_is_good(need)
    assert not any(estimate_is_good(need + 24 - flag) for flag in (1, 2, 4, 32))


def test_a_landing_may_take_a_minute_and_the_height_at_three_tenths_of_a_metre_a_second() -> None:
    assert landing_limit_s(3.0) == pytest.approx(70.0)
    assert landing_limit_s(-5.0) == 60.0


def test_what_the_vehicle_said_lately_is_told_once() -> None:
    def texts(now_us: int) -> dict[str, Any]:
        return {"texts": (
            (now_us - 11 * S, 4, "long ago"), (now_us - 5 * S, 4, "lately"), (now_us - S, 6, "no warning"),
            (now_us - S, 4, "low battery"), (now_us, 4, "low battery"), (now_us, 2, "no manual control"),
        )}  # fmt: skip

    now_us, late_us = ENTERED + S, ENTERED + 31 * S
    refused = decide(situation(State.STREAMING, {**FLYING, "armed": False}), ENTERED + 11 * S)
    taken = decide(situation(State.OFFBOARD, {**AWAY, **texts(now_us)}), now_us)
    slow = decide(situation(State.LANDING, {**ARMED, **texts(now_us)}, landing_limit_s=0.5), now_us)
    late = decide(situation(State.STANDBY, {**texts(late_us), "heard_at_us": late_us}, fresh=False), late_us)
    for decision, before in ((taken, ""), (slow, "lately; "), (late, "lately; ")):
        assert decision is not None
        assert decision.reason.endswith(f" (vehicle says: {before}low battery; no manual control)")
    assert refused is not None
    assert refused.event is E.LINK_LOST  # 11 s without a word


@pytest.mark.parametrize(("charge", "words"), [(14, " (vehicle says: battery at 14 %)"), (15, ""), (-1, "")])
def test_a_battery_of_which_px4_warns_is_told(charge: int, words: str) -> None:
    """BAT_LOW_THR is 0.15 by default; -1: not known (MAVLink, SYS_STATUS)."""
    taken = decide(situation(State.OFFBOARD, {**AWAY, "charge_percent": charge}), ENTERED + S)
    assert taken is not None
    assert taken.reason.endswith(f"hands off{words}")


def test_why_a_flight_was_refused_is_told() -> None:
    """The mode is asked for first; arming is what is missing once the vehicle is in OFFBOARD."""
    for view, words in (({}, "OFFBOARD mode refused: no answer (the vehicle gave no reason)"),
                        ({"in_offboard": True}, "arming refused: no answer (the vehicle gave no reason)")):  # fmt: skip
        decision = decide(situation(State.STREAMING, {**view, "heard_at_us": ENTERED + 11 * S}), ENTERED + 11 * S)
        assert decision is not None
        assert (decision.event, decision.reason) == (E.ARM_REFUSED, words)


@pytest.mark.parametrize(
    ("view", "words"),
    [
        ({"params": SimpleNamespace(settled=False, values={}, missing=("A", "B"))}, "parameters not told (A, B)"),
        ({"params": SimpleNamespace(settled=False, values={}, missing=())}, "parameters not told (still asking)"),
        ({"round_trip_us": 56_000}, "link too slow: 56 ms there and back, 55 at most"),
        ({"landed_state": 0}, "landed state unknown"),
        ({"estimator_flags": 1}, "estimate not good (ESTIMATOR_STATUS flags 0x1)"),
    ],
)
def test_what_a_vehicle_lacks_is_told_when_the_time_is_over(view: dict[str, Any], words: str) -> None:
    decision = decide(situation(State.STANDBY, {**view, "heard_at_us": ENTERED + 31 * S}), ENTERED + 31 * S)
    assert decision is not None
    assert decision.reason == f"not ready within 30 s: {words}"


def test_a_landing_that_does_not_end_is_told_with_where_the_vehicle_is() -> None:
    stands = "in the air by its own report, and stands, for its motors idle and it feels its weight: left to PX4"
    for on_ground, idle, where in (
        (True, False, "on the ground by its own report: left to PX4"),
        (True, True, "on the ground by its own report: left to PX4"),
        (False, False, "in the air by its own report: left to PX4"),
        (False, True, stands),
    ):
        view = {**ARMED, "on_ground": on_ground, "stands": idle, "heard_at_us": ENTERED + 3 * S}
        now = situation(State.LANDING, view, landing_limit_s=2.0, landing_for="guard: tipped over")
        decision = decide(now, ENTERED + 3 * S)
        assert decision is not None
        words = f"2 s after Land was commanded the vehicle is armed, {where}"
        assert decision.reason.startswith(f"guard: tipped over; {words}")


def test_a_landing_that_someone_ends_says_why_it_had_begun() -> None:
    view = {**ARMED, "custom_mode": px4.MODE_HOLD, "mode_at_us": ENTERED + S}
    for landing_for, begin in (("", "the mode changed"), ("no estimate", "no estimate; the mode changed")):
        decision = decide(situation(State.LANDING, view, landing_for=landing_for), ENTERED + S)
        assert decision is not None
        assert decision.reason.startswith(begin)


@pytest.mark.parametrize(
    ("state", "view", "asked", "begin"),
    [
        (
            State.STREAMING,
            {"mode_at_us": 3},
            {ARMING: {"accepted": True, "answered_us": 2}},
            "the mode changed to Hold while arming",
        ),
        (State.OFFBOARD, AWAY, {}, "the vehicle left OFFBOARD for Hold"),
    ],
)
def test_a_hold_that_may_be_the_dead_mans_is_nobodys(
    state: State, view: dict[str, Any], asked: dict[Any, Any], begin: str
) -> None:
    """Hands off all the same, without a word of a pilot."""
    stalls = {"asked_lately": lambda mode, now_us: ", 0.2 s after the dead-man had asked for Hold"}
    given = {**view, "custom_mode": px4.MODE_HOLD, "mode_name": "Hold"}
    decision = decide(situation(state, given, asked=asked, stalls=stalls), ENTERED + 6 * S // 10)
    assert decision is not None
    assert decision.event is E.TOOK_OVER
    assert decision.reason == f"{begin}, 0.2 s after the dead-man had asked for Hold: hands off"
