"""The companion: link and flight stack joined by the handshake's table.  Sans-IO: bytes in, bytes out, time given.

`step(now_us)` is called every 4 ms, in lockstep and in real time alike.  It reads what the link received, lets the
handshake move on, and while streaming runs one tick of the stack and sends one setpoint.  `now_us` is local time; the
stack lives in the vehicle's time (`vehicle_clock`), in which stamps, delays and the reference's time are counted.
"""

from __future__ import annotations

import numpy as np

from flightstack.guard import stale
from flightstack.mission import Mission, plan, run_up_of
from flightstack.predictor import sampled
from flightstack.scenario import Scenario
from flightstack.stack import Stack, StackState
from flightstack.state_observer import StateObserver
from flightstack.types import F64, FlatOutput, Measurement, TickRecord
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.dead_man_frames import CompanionRecord, DeadManRecord
from mavlink_bridge.decide import ROUND_TRIP_MAX_S, SECOND_US, CompanionConfig, Situation, decide, landing_limit_s
from mavlink_bridge.faults import FAULTS
from mavlink_bridge.handshake import FINAL, HandshakeEvent, State, transition
from mavlink_bridge.hearing import Hearing
from mavlink_bridge.last_word import companion_record, hover_at, state_now
from mavlink_bridge.link import Link
from mavlink_bridge.notes import BrokenPremise, GuardNotes, Swinging
from mavlink_bridge.onlookers import MissionPlanner, Observer
from mavlink_bridge.requests import DISARM, FLOWN_BY, CommandQueue, set_mode, stream_requests
from mavlink_bridge.stalls import Stalls
from mavlink_bridge.vehicle_params import remarks
from mavlink_bridge.vehicle_view import VehicleView
from mavlink_bridge.voice import Voice, yaw_of
from mavlink_bridge.watchdogs import Watchdogs

__all__ = ["Companion", "CompanionConfig", "MissionPlanner", "Observer"]

_REST_TICKS = 1_000
"""Ticks over which the position at rest is averaged; on a longer wait the last 4 s or so count."""
_CALM_US = 1_000_000
"""Safe words go on for so long at most while PX4 is asked to take the vehicle; then silence, and its own failsafe."""
_MODE_KNOWN_US = 1_500_000
"""An older report of OFFBOARD may be out of date: nothing is commanded that a pilot might not want."""
_BLIND = frozenset({"frozen-attitude", "stale-attitude", "attitude-against-gyro", "estimator-attitude"})
"""Rows after which the attitude is not trusted any more."""


class Companion:
    """One flight: from the first heartbeat to disarmed in Hold, or to the reason why not."""

    def __init__(
        self,
        link: Link,
        stack: Stack,
        scenario: Scenario,
        observer: Observer,
        config: CompanionConfig,
        planner: MissionPlanner | None = None,
    ) -> None:
        self.link = link
        self.view = VehicleView()
        self.reason = ""
        """Why the flight ended or was refused, one line; empty after a good one."""
        self.mission: Mission | None = None
        self.phase = "connect"
        self.flight_start_us = -1
        """Vehicle time at which the mission's time began; -1 before."""
        self.land_command_us = -1
        """Vehicle time of the command to land; -1 before."""
        self.last_t_us = 0
        """Vehicle time of the latest step in which something was decided."""
        self.ticks = self._t_us = 0
        self._stack, self._scenario, self._config = stack, scenario, config
        self._observer, self._planner = observer, planner
        self._rest_ned_m: F64 = np.zeros(3)
        self._rested = 0
        self.start_ned_m: F64 = np.zeros(3)
        """Estimated position where the flight began, (3,): the scenario's coordinates are relative to it."""
        self._commands, self._voice = CommandQueue(link), Voice(link, speaks_first=config.speaks_first)
        self._now = Situation(config, self.view, self._commands)
        self._watch = Watchdogs(self.view.clock, config.tick_s)
        errs = config.estimate
        self._refiner = StateObserver(errs) if errs is not None and errs.independent else None
        self._stack_state: StackState | None = None
        self._hold: FlatOutput | None = None
        self._mission_complete = self._landing = False
        """PX4 has taken the command to land; that the mode falls back to OFFBOARD after it disarms means nothing."""
        self._measurement: Measurement | None = None
        """The state at this step; None until every stream has been heard."""
        self._phase_now = self._fault = ""
        """And the row of the fault table that ended the flight; empty: none."""
        self._notes = GuardNotes(observer)
        self._run_up = run_up_of(scenario)
        self._broken, self._swinging = BrokenPremise(observer), Swinging()
        self._hearing = Hearing(link, self._now, self._watch, self._voice, observer)

    @property
    def state(self) -> State:
        """Where the handshake stands."""
        return self._now.state

    @property
    def done(self) -> bool:
        """Nothing more will happen; what is queued should still be sent."""
        state = self._now.state
        return state in FINAL or (self._config.dry_run and state is State.STREAMING)

    @property
    def completed(self) -> bool:
        """The scenario was flown to its end and the vehicle landed and disarmed."""
        return self.state is State.LANDED and self._mission_complete

    def stop(self, reason: str) -> None:
        """Ask for an early end: in flight the vehicle lands, before the flight nothing begins."""
        self._now.stop_requested = self._now.stop_requested or reason

    def receive_datagram(self, data: bytes, now_us: int) -> None:
        """Take what arrived from the wire."""
        self.link.receive_datagram(data, now_us)

    def hear_dead_man(self, report: DeadManRecord, ended: str = "") -> None:
        """Take what the dead-man did of late, before each step; `ended`: why there is none any more."""
        self._now.stalls.hear(report)
        self.view.note_mode(report.mode, report.mode_ns // 1000)
        if ended and not self._now.dead_man_lost:
            self._now.dead_man_lost = ended
            self._observer.on_event(self._t_us, "fault", f"dead-man-lost: {ended}", "warning")

    def last_word(self, sent_us: int) -> CompanionRecord:
        """What the dead-man has to know if nothing follows; `sent_us`: local time of what was sent last."""
        sent = (sent_us, self._t_us)
        record = companion_record(self._now, self._voice, self.link, self._measurement, self._carrying_norm(), sent)
        return record._replace(flags=0) if self._landing else record  # PX4 lands: silence is meant, to disarmed and on

    @property
    def stalls(self) -> Stalls:
        """What the dead-man did, and what became of it."""
        return self._now.stalls

    def step(self, now_us: int) -> None:
        """One period: read, decide, act."""
        now = self._now
        if now.entered_us < 0:
            now.entered_us = now_us
        self._watch.step(now_us)
        self._t_us = self.view.clock.vehicle_us(now_us)
        self._hearing.take_all(self._t_us, now_us)
        self._t_us = self.view.clock.vehicle_us(now_us)
        if not self.done:
            self._look(now_us)
        while (verdict := decide(now, now_us)) is not None:
            self.reason = verdict.reason or self.reason
            after = transition(now.state, verdict.event)
            if after is None:
                break
            self._enter(after, verdict.event, now_us)
        now.parameters_changed = False  # judged
        self._act(now_us)

    def say_last_words(self, reason: str) -> None:
        """The process is about to end, whatever the cause: where it flies the vehicle, level it and ask for Hold."""
        if self.state not in (State.OFFBOARD, State.HOLDING) and not (
            self.state is State.LANDING and not self._landing
        ):
            return
        self.reason = reason
        self._observer.on_event(self._t_us, "fault", f"exception: {reason}: last words, asking for Hold", "warning")
        self._calm()
        self._commands.insist(set_mode(px4.MODE_HOLD))

    def _look(self, now_us: int) -> None:
        """The state of the vehicle and of the mission at this step."""
        now, t_us = self._now, self._t_us
        measured = sampled(self.view.streams, t_us, corrected=self._refiner is None)
        if measured is not None:
            measured.battery_v, measured.late_us = self.view.battery_v, self.view.way.late_us
            measured = self._refiner.refine(measured) if self._refiner else measured
            measured = self._stack.carried(self._stack_state, measured, t_us)
        self._measurement, self.last_t_us = measured, t_us
        if measured is not None and self.view.on_ground and not self.view.armed:
            self._rested = min(self._rested + 1, _REST_TICKS)
            self._rest_ned_m += (measured.pos_ned_m - self._rest_ned_m) / self._rested
        lost = stale(measured, self._stack.limits)
        now.fresh, now.catching_up = not lost, self._watch.pace.has_slept(now_us)
        if now.state is State.OFFBOARD and (lost or self._watch.aid.is_silent(now_us)):
            self._commands.renew(FLOWN_BY if lost else (m.GpsRawInt,), now_us)
        (now.unfit, now.trouble), self.view.stood_us = self._watch.judge(), self._watch.stood_us
        if now.dead_man_lost and self.view.params.needs_dead_man:
            now.trouble = now.trouble or "dead-man-lost"
        if self.view.is_slower_than(ROUND_TRIP_MAX_S):
            now.trouble = now.trouble or "slow-link"
        if now.state is State.LANDING and not self._landing and now.stalls.is_held and not now.stalls.judge(now_us):
            now.entered_us = now_us  # the Hold is ours: landing goes on
            self._commands.insist(set_mode(px4.MODE_LAND))
        if self._notes.guard_s(now_us) > now.config.blind_s:
            now.trouble = f"stale-{lost}" if lost else "guard"
        if now.state is State.OFFBOARD and self.mission is not None:
            self._phase_now = self.mission.phase(self._mission_time_s())
            now.mission_done = self._phase_now == "done"

    def _enter(self, state: State, event: HandshakeEvent, now_us: int) -> None:
        """What happens once, on the way into a state."""
        self._now.state, self._now.entered_us, t_us = state, now_us, self._t_us
        if state in FINAL or event in (HandshakeEvent.FAULT_LAND, HandshakeEvent.FAULT_HOLD):
            self._notes.end(t_us)
        if event in (HandshakeEvent.FAULT_LAND, HandshakeEvent.FAULT_HOLD):
            fault = FAULTS[self._now.trouble]
            text = f"{self._now.trouble}: {fault.what}; {fault.reaction.value}"
            self._observer.on_event(t_us, "fault", text, "warning")
        severity = "warning" if state in (State.PILOT, State.LOST, State.REFUSED, State.HOLDING) else "info"
        text = f"{state.value}: {event.value}" + (f" ({self.reason})" if self.reason else "")
        self._observer.on_event(t_us, "state", text, severity)
        if state is State.STANDBY:
            for request in stream_requests():
                self._commands.request(request, now_us)
        elif state is State.STREAMING:
            params = self.view.params
            self._voice.heed(params)
            self._observer.on_event(t_us, "parameters", remarks(params.values, self._stack.model), "info")
        elif state is State.RETAKING:
            self._observer.on_event(t_us, "fault", f"stalled: {self._now.stalls.words}; taking back", "warning")
            self._commands.forget(px4.Cmd.DO_SET_MODE)
        elif state is State.OFFBOARD and event is HandshakeEvent.RETAKEN:
            self._resume(t_us)
        elif state is State.OFFBOARD:
            self._engage(t_us)
        elif state is State.LANDING:
            self.land_command_us = t_us
            self._now.landing_limit_s = landing_limit_s(self._height_m())
            if event in (HandshakeEvent.STOP, HandshakeEvent.ENDED) and self.mission is not None:
                self.mission = self.mission.stop(self._mission_time_s())
            self._mission_complete = event is HandshakeEvent.MISSION_DONE
            self._now.landing_for = "" if self._mission_complete else self.reason
            self._fault = self._now.trouble if event is HandshakeEvent.FAULT_LAND else ""
            self._set_phase("land", t_us)
            self._command_mode(px4.MODE_LAND, now_us)
        elif state in (State.HOLDING, State.LOST):
            self.land_command_us = t_us if self.land_command_us < 0 else self.land_command_us
            self._fault = self._now.trouble if state is State.HOLDING else self._fault
            if self._ours(now_us):
                self._calm()
                self._command_mode(px4.MODE_HOLD if state is State.HOLDING else px4.MODE_LAND, now_us)
        elif state is State.REFUSED and self._commands.status(px4.Cmd.COMPONENT_ARM_DISARM).request is not None:
            self._commands.insist(DISARM)  # asked to arm: nobody would fly it; PX4 denies this in the air
        elif state is State.LANDED:
            self._set_phase("landed", t_us)
            self._command_mode(px4.MODE_HOLD, now_us)

    def _height_m(self) -> float:
        """Above the place of take-off, as last measured."""
        return 0.0 if self._measurement is None else float(self.start_ned_m[2] - self._measurement.pos_ned_m[2])

    def _engage(self, t_us: int) -> None:
        measurement = self._measurement
        assert measurement is not None  # STREAMING is not entered without one
        self.start_ned_m = measurement.pos_ned_m.copy()
        if self._rested:  # the mean at rest is better than any one noisy sample
            self.start_ned_m = self._rest_ned_m.copy()
        self.mission = plan(self._scenario, self.start_ned_m, yaw_of(measurement.q_ned_frd), self._run_up)
        stands = self._rested > 0 and self.view.on_ground
        self._stack_state = self._stack.init(measurement, self.start_ned_m, stands=stands)
        self._watch.begin()
        self._notes.begin()
        self.flight_start_us = t_us
        self._phase_now = self.mission.phase(0.0)

    def _resume(self, t_us: int) -> None:
        """Go on after a stall: from where the vehicle is back to the reference."""
        measurement, mission, state = self._measurement, self.mission, self._stack_state
        assert measurement is not None
        assert mission is not None
        assert state is not None
        t_s = self._mission_time_s()
        if mission.phase(t_s) != "done":
            self.mission = mission.rejoin(t_s, state_now(measurement))
        self._stack_state = self._stack.resume(state, measurement)
        self._watch.resume()
        self._notes.begin()
        self._now.trouble = ""  # judged before the flight went on

    def _act(self, now_us: int) -> None:
        """What happens in every period of a state."""
        state, system = self._now.state, self._now.system
        if state in FINAL and self._now.entered_us != now_us:
            return
        self._voice.keep_in_touch(now_us, heartbeat_missing=self.view.heartbeat_is_missing)
        if state is State.OFFBOARD:
            self._fly(now_us)
        elif state is State.RETAKING:
            self._calm(turning=True)
            if self._now.fresh and self._now.stalls.hold_is_settled(self.view):
                self._command_mode(px4.MODE_OFFBOARD, now_us)
        elif state is State.IDENTIFYING:
            self._commands.identify(now_us)
        elif state is State.STANDBY:
            self.view.params.ask(self.link, system, now_us)
        elif state is State.STREAMING and not (self._config.dry_run or self._watch.pace.has_slept(now_us)):
            if not self.view.may_return:
                self._stream_idle()
            if self._config.arm:
                self._ask_for_offboard_and_arm(now_us)
        elif state is State.LANDING:
            self._landing = self._landing or self.view.custom_mode == px4.MODE_LAND
            if not self._landing:  # until PX4 says that it lands, the stack holds the vehicle
                self._hand_back(px4.MODE_LAND, now_us)
        elif state is State.HOLDING:
            self._hand_back(px4.MODE_HOLD, now_us)
        self._commands.step(now_us, system)

    def _ask_for_offboard_and_arm(self, now_us: int) -> None:
        if (now_us - self._now.entered_us) / SECOND_US < self._config.stream_before_offboard_s:
            return
        if not self.view.in_offboard:
            self._command_mode(px4.MODE_OFFBOARD, now_us)
        elif not self.view.armed and not self._commands.status(px4.Cmd.COMPONENT_ARM_DISARM).accepted:
            self._commands.ensure((px4.Cmd.COMPONENT_ARM_DISARM, (1.0,)), now_us)

    def _stream_idle(self) -> None:
        """Setpoints that are safe at the moment of the switch: nothing on the ground, hold the place in the air."""
        t_us, measurement = self._t_us, self._measurement
        if measurement is None or self.view.on_ground or not self.view.armed:
            self._stack_state = self._hold = None
            self._voice.stand(t_us)
            return
        self._rested = 0
        if self._stack_state is None or self._hold is None:
            self._stack_state = self._stack.init(measurement, self.start_ned_m)
            self._hold = hover_at(measurement)
        self._tick(measurement, self._hold, t_us)

    def _fly(self, now_us: int) -> None:
        assert self.mission is not None
        if self._now.state is State.OFFBOARD:
            self._set_phase(self._phase_now, self._t_us)
        t_s = self._mission_time_s()
        record = self._tick(self._measurement, self.mission.reference(t_s), self._t_us)
        if self._notes.take(record.guard, self._watch.resets, self._t_us, now_us):
            self.view.streams.observer.reset()
        if reason := self._broken.take(record) or self._swinging.take(record):
            self._now.ending = self._now.ending or reason
        if record.filtered.handed_over:
            self._now.ending = "handed over: what kept the flight in its region was falsified by what was measured"
        if self._planner is not None and self._now.state is State.OFFBOARD:
            self.mission = self._planner.step(self.mission, t_s, record)

    def _tick(self, measurement: Measurement | None, setpoint: FlatOutput, t_us: int) -> TickRecord:
        assert self._stack_state is not None
        if self._now.gains_changed:
            self._stack_state = self._stack.gains_changed(self._stack_state)
        self._stack_state, command, record = self._stack.tick(self._stack_state, measurement, setpoint, t_us)
        self._voice.fly(command)
        self.view.latency.sent(command.t_us, command.thrust_norm)
        self._observer.on_tick(record)
        self.ticks += 1
        return record

    def _hand_back(self, mode: int, now_us: int) -> None:
        """PX4 is asked to take the vehicle; until it has, keep it safe.  Without a fault the stack just flies on."""
        if not self._fault:
            self._fly(now_us)
        elif self._ours(now_us) and now_us - self._now.entered_us < _CALM_US:
            self._calm()
        if self._ours(now_us):
            self._command_mode(mode, now_us)

    def _ours(self, now_us: int) -> bool:
        """Of late the vehicle was in OFFBOARD, after any sleep in which PX4 may have left it: it is ours to command."""
        mode_us, loss_s = self.view.mode_at_us, self.view.params.values.get("COM_OF_LOSS_T", 0.0)
        if self._watch.pace.may_have_acted(mode_us, now_us, loss_s):
            self._commands.ensure(self._request(m.CurrentMode), now_us)
            return False
        return self.view.in_offboard and now_us - mode_us <= _MODE_KNOWN_US

    def _calm(self, *, turning: bool = False) -> None:
        """Safe words: what PX4 may go on with until its own failsafe acts; `turning`: body rates, zero."""
        measurement = self._measurement if self._fault not in _BLIND and not turning else None
        yaw_rad = None if measurement is None else yaw_of(measurement.q_ned_frd)
        self._voice.calm(self._t_us, self._carrying_norm(), yaw_rad)

    def _carrying_norm(self) -> float:
        """Normalised thrust that carried the vehicle of late."""
        state, model = self._stack_state, self._stack.model
        return model.norm_of(model.weight_n if state is None or not np.isfinite(state.carried_n) else state.carried_n)

    def _mission_time_s(self) -> float:
        return (self._t_us - self.flight_start_us) / SECOND_US

    def _set_phase(self, phase: str, t_us: int) -> None:
        if phase != self.phase:
            self.phase = phase
            self._observer.on_event(t_us, "phase", phase, "info")

    def _command_mode(self, custom_mode: int, now_us: int) -> None:
        asked = self._commands.ensure(set_mode(custom_mode), now_us)
        if asked and self.state is State.LANDING and not self._fault and self._measurement is not None:
            self._voice.stay(self._t_us, self._carrying_norm(), self._measurement.q_ned_frd)

    def _request(self, message: type) -> tuple[px4.Cmd, tuple[float, ...]]:
        return px4.Cmd.REQUEST_MESSAGE, (float(m.id_of(message)),)
