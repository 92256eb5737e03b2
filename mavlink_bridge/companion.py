"""The companion: link and flight stack joined by the handshake's table.  Sans-IO: bytes in, bytes out, time given.

`step(now_us)` is called every 4 ms, in lockstep and in real time alike.  It reads what the link received, lets the
handshake move on, and while streaming runs one tick of the stack and sends one setpoint.  `now_us` is local time; the
stack lives in the vehicle's time (`vehicle_clock`), in which stamps, delays and the reference's time are counted.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flightstack.guard import stale
from flightstack.mission import Mission, plan
from flightstack.predictor import predict
from flightstack.scenario import Scenario
from flightstack.stack import Stack, StackState
from flightstack.types import F64, Command, FlatOutput, Measurement, TickRecord
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.decide import SECOND_US, CompanionConfig, Situation, decide
from mavlink_bridge.handshake import FINAL, Event, State, transition
from mavlink_bridge.link import Link, Received
from mavlink_bridge.requests import CommandQueue, stream_requests
from mavlink_bridge.vehicle_view import VehicleView

__all__ = ["Companion", "CompanionConfig", "Observer", "Planner"]

_REST_TICKS = 1_000
"""Ticks over which the position at rest is averaged; on a longer wait the last 4 s or so count."""
_TIMESYNC_PERIOD_US = 100_000
_FULL_MASK_RATES = 128
"""SET_ATTITUDE_TARGET: ignore the attitude, take body rates and thrust.  Never the throttle-ignore bit (64)."""


class Observer(Protocol):
    """Who wants to know (the log, the progress bar).  Called inside the tick: must be quick and must not raise."""

    def on_event(self, t_us: int, name: str, text: str, severity: str) -> None:
        """A transition, a change of mode, a text of the vehicle; `t_us` in the vehicle's time."""

    def on_tick(self, record: TickRecord) -> None:
        """One tick of the stack."""

    def on_message(self, t_us: int, message: object) -> None:
        """A message of the identified vehicle, at vehicle time `t_us`."""


class Planner(Protocol):
    """Who changes the mission while it is flown."""

    def step(self, mission: Mission, t_s: float, record: TickRecord) -> Mission:
        """The mission from here on, after a tick at mission time `t_s`; mostly the same one."""


class Companion:
    """One flight: from the first heartbeat to disarmed in Hold, or to the reason why not."""

    def __init__(
        self,
        link: Link,
        stack: Stack,
        scenario: Scenario,
        observer: Observer,
        config: CompanionConfig,
        planner: Planner | None = None,
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
        self.ticks = 0
        self._stack, self._scenario, self._observer, self._config = stack, scenario, observer, config
        self._planner = planner
        self._rest_ned_m: F64 = np.zeros(3)
        self._rested = 0
        self.start_ned_m: F64 = np.zeros(3)
        """Estimated position where the flight began, (3,): the scenario's coordinates are relative to it."""
        self._commands = CommandQueue(link)
        self._now = Situation(config, self.view, self._commands)
        self._heartbeat_due_us = 0
        self._timesync_due_us = 0
        self._stack_state: StackState | None = None
        self._hold: FlatOutput | None = None
        self._mode_seen = -1
        self._mission_complete = False
        self._landing = False
        """PX4 has taken the command to land; that the mode falls back to OFFBOARD after it disarms means nothing."""
        self._t_us = 0
        self._measurement: Measurement | None = None
        """The state at this step; None until every stream has been heard."""
        self._phase_now = ""

    # ---------------------------------------------------------------- outside

    @property
    def state(self) -> State:
        """Where the handshake stands."""
        return self._now.state

    @property
    def done(self) -> bool:
        """Nothing more will happen; what is queued should still be sent."""
        return self.state in FINAL or (self._config.dry_run and self.state is State.STREAMING)

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

    def step(self, now_us: int) -> None:
        """One period: read, decide, act."""
        now = self._now
        if now.entered_us < 0:
            now.entered_us = now_us
        self._t_us = self.view.clock.vehicle_us(now_us)
        self._read(now_us)
        self._t_us = self.view.clock.vehicle_us(now_us)
        if not self.done:
            self._look()
        while (verdict := decide(now, now_us)) is not None:
            self.reason = verdict.reason or self.reason
            after = transition(now.state, verdict.event)
            if after is None:
                break
            self._enter(after, verdict.event, now_us)
        self._act(now_us)

    # ---------------------------------------------------------------- read

    def _read(self, now_us: int) -> None:
        now = self._now
        while (received := self.link.next_event()) is not None:
            if now.system == 0:
                self._meet(received, now_us)
            elif received.system == now.system and received.component == px4.COMPONENT_AUTOPILOT:
                self._take(received.message, now_us)
            elif isinstance(received.message, m.Heartbeat) and received.message.autopilot == px4.AUTOPILOT_PX4:
                now.foreign_system = received.system

    def _meet(self, received: Received, now_us: int) -> None:
        """Before anyone is identified only heartbeats of autopilots count."""
        message = received.message
        if isinstance(message, m.Heartbeat) and received.component == px4.COMPONENT_AUTOPILOT:
            self._now.system = received.system
            self.link.expect_peer(received.system)
            self._take(message, now_us)

    def _take(self, message: object, now_us: int) -> None:
        self.view.update(message, now_us)
        t_us = self._t_us
        self._observer.on_message(t_us, message)
        if isinstance(message, m.CommandAck):
            self._commands.acknowledge(message)
        elif isinstance(message, m.Statustext):
            self._observer.on_event(t_us, "statustext", message.text, "warning" if message.severity <= 4 else "info")
        elif self.view.mode_at_us >= 0 and self.view.custom_mode != self._mode_seen:
            self._mode_seen = self.view.custom_mode
            self._observer.on_event(t_us, "mode", f"vehicle is in {self.view.mode_name}", "info")

    def _look(self) -> None:
        """The state of the vehicle and of the mission at this step."""
        now, t_us = self._now, self._t_us
        self.last_t_us = t_us
        self._measurement = predict(self.view.streams, t_us)
        now.fresh = not stale(self._measurement, self._stack.limits)
        if now.state is State.OFFBOARD and self.mission is not None:
            self._phase_now = self.mission.phase(self._mission_time_s())
            now.mission_done = self._phase_now == "done"

    # ---------------------------------------------------------------- act

    def _enter(self, state: State, event: Event, now_us: int) -> None:
        """What happens once, on the way into a state."""
        self._now.state, self._now.entered_us = state, now_us
        t_us = self._t_us
        severity = "warning" if state in (State.PILOT, State.LOST, State.REFUSED) else "info"
        text = f"{state.value}: {event.value}" + (f" ({self.reason})" if self.reason else "")
        self._observer.on_event(t_us, "state", text, severity)
        if state is State.STANDBY:
            for request in stream_requests():
                self._commands.request(request, now_us)
        elif state is State.OFFBOARD:
            self._engage(now_us, t_us)
        elif state is State.LANDING:
            self.land_command_us = t_us
            if event is Event.STOP and self.mission is not None:
                self.mission = self.mission.stop(self._mission_time_s())
            self._mission_complete = event is Event.MISSION_DONE
            self._set_phase("land", t_us)
            self._command_mode(px4.MODE_LAND, now_us)
        elif state is State.LOST:
            self.land_command_us = t_us if self.land_command_us < 0 else self.land_command_us
            self._command_mode(px4.MODE_LAND, now_us)
        elif state is State.LANDED:
            self._set_phase("landed", t_us)
            self._command_mode(px4.MODE_HOLD, now_us)

    def _engage(self, now_us: int, t_us: int) -> None:
        measurement = self._measurement
        assert measurement is not None  # STREAMING is not entered without one
        self.start_ned_m = measurement.pos_ned_m.copy()
        if self._rested:  # at rest the mean says better where the vehicle stands than any one noisy sample
            self.start_ned_m = self._rest_ned_m.copy()
        self.mission = plan(self._scenario, self.start_ned_m, _yaw(measurement.q_ned_frd))
        self._stack_state = self._stack.init(measurement, self.start_ned_m)
        self._now.last_good_us = now_us
        self.flight_start_us = t_us
        self._phase_now = self.mission.phase(0.0)

    def _act(self, now_us: int) -> None:
        """What happens in every period of a state."""
        state, system = self._now.state, self._now.system
        if state in FINAL and self._now.entered_us != now_us:
            return
        if now_us >= self._heartbeat_due_us and system:
            self._heartbeat_due_us = now_us + SECOND_US
            self._send_heartbeats()
        if now_us >= self._timesync_due_us and system:
            self._timesync_due_us = now_us + _TIMESYNC_PERIOD_US
            self.link.send(m.Timesync(0, now_us * 1000, system, px4.COMPONENT_AUTOPILOT))
        if state is State.OFFBOARD:
            self._fly(now_us)
        elif state is State.IDENTIFYING:
            self._commands.ensure(self._request(m.AutopilotVersion), now_us)
        elif state is State.STREAMING and not self._config.dry_run:
            self._stream_idle()
            if self._config.arm:
                self._ask_for_offboard_and_arm(now_us)
        elif state is State.LANDING:
            self._landing = self._landing or self.view.custom_mode == px4.MODE_LAND
            if not self._landing:  # until PX4 says that it lands, the stack holds the vehicle
                self._fly(now_us)
                self._command_mode(px4.MODE_LAND, now_us)
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
            self._send_setpoint(Command(t_us, 0.0, 0.0, np.zeros(3)))
            if measurement is not None and self.view.on_ground:
                self._rested = min(self._rested + 1, _REST_TICKS)
                self._rest_ned_m += (measurement.pos_ned_m - self._rest_ned_m) / self._rested
            return
        self._rested = 0
        if self._stack_state is None or self._hold is None:
            self._stack_state = self._stack.init(measurement, self.start_ned_m)
            self._hold = _hover_at(measurement)
        self._tick(measurement, self._hold, t_us)

    def _fly(self, now_us: int) -> None:
        assert self.mission is not None
        if self._now.fresh:
            self._now.last_good_us = now_us
        if self._now.state is State.OFFBOARD:
            self._set_phase(self._phase_now, self._t_us)
        t_s = self._mission_time_s()
        record = self._tick(self._measurement, self.mission.reference(t_s), self._t_us)
        if record.filtered.handed_over:
            self.stop("handed over: what kept the flight in its region was falsified by what was measured")
        if self._planner is not None and self._now.state is State.OFFBOARD:
            self.mission = self._planner.step(self.mission, t_s, record)

    def _tick(self, measurement: Measurement | None, setpoint: FlatOutput, t_us: int) -> TickRecord:
        assert self._stack_state is not None
        self._stack_state, command, record = self._stack.tick(self._stack_state, measurement, setpoint, t_us)
        self._send_setpoint(command)
        self._observer.on_tick(record)
        self.ticks += 1
        return record

    def _mission_time_s(self) -> float:
        return (self._t_us - self.flight_start_us) / SECOND_US

    def _set_phase(self, phase: str, t_us: int) -> None:
        if phase != self.phase:
            self.phase = phase
            self._observer.on_event(t_us, "phase", phase, "info")

    # ---------------------------------------------------------------- send

    def _send_heartbeats(self) -> None:
        """As onboard controller, and as a ground station: PX4 sends STATUSTEXT only to links that saw one."""
        self.link.send(m.Heartbeat(px4.TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4))
        self.link.send(m.Heartbeat(px4.TYPE_GCS, 8, 0, 0, 4), component=px4.COMPONENT_GCS)

    def _send_setpoint(self, command: Command) -> None:
        roll, pitch, yaw = command.rate_frd_radps.tolist()
        self.link.send(
            m.SetAttitudeTarget(
                command.t_us,
                self._now.system,
                px4.COMPONENT_AUTOPILOT,
                _FULL_MASK_RATES,
                (1.0, 0.0, 0.0, 0.0),
                (roll, pitch, yaw),
                command.thrust_norm,
            )
        )

    def _command_mode(self, custom_mode: int, now_us: int) -> None:
        params = (1.0, float(px4.main_mode(custom_mode)), float(px4.sub_mode(custom_mode)))
        self._commands.ensure((px4.Cmd.DO_SET_MODE, params), now_us)

    def _request(self, message: type) -> tuple[px4.Cmd, tuple[float, ...]]:
        return px4.Cmd.REQUEST_MESSAGE, (float(m.id_of(message)),)


def _yaw(q_ned_frd: F64) -> float:
    w, x, y, z = (float(value) for value in q_ned_frd)
    return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def _hover_at(measurement: Measurement) -> FlatOutput:
    zero = np.zeros(3)
    return FlatOutput.of(measurement.pos_ned_m, zero, zero, zero, zero, _yaw(measurement.q_ned_frd))
