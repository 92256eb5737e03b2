"""The companion: link and flight stack joined by the handshake's table.  Sans-IO: bytes in, bytes out, time given.

`step(now_us)` is called every 4 ms, in lockstep and in real time alike.  It reads what the link received, lets the
handshake move on, and while streaming runs one tick of the stack and sends one setpoint.  `now_us` is local time; the
stack lives in the vehicle's time (`vehicle_clock`), in which stamps, delays and the reference's time are counted.
"""

from __future__ import annotations

from dataclasses import dataclass
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
from mavlink_bridge.handshake import FINAL, Event, State, transition
from mavlink_bridge.link import Link, Received
from mavlink_bridge.requests import CommandQueue, stream_requests
from mavlink_bridge.vehicle_view import VehicleView

SECOND_US = 1_000_000
_ESTIMATOR_READY = 0x27
"""ESTIMATOR_STATUS.flags: attitude, horizontal and vertical velocity, height."""
_ESTIMATOR_POSITION = 0x18
"""Horizontal position, relative or absolute: one of them is enough."""
_TIMESYNC_PERIOD_US = 100_000
_FULL_MASK_RATES = 128
"""SET_ATTITUDE_TARGET: ignore the attitude, take body rates and thrust.  Never the throttle-ignore bit (64)."""


@dataclass(frozen=True, slots=True)
class CompanionConfig:
    """How the companion behaves; times in seconds."""

    arm: bool = False
    """Leave to select OFFBOARD and to arm; without it the pilot does both."""
    dry_run: bool = False
    """Connect and check, send no setpoint."""
    heartbeat_timeout_s: float = 10.0
    identify_timeout_s: float = 5.0
    ready_timeout_s: float = 30.0
    arm_timeout_s: float = 10.0
    link_loss_s: float = 3.0
    """Heartbeats missing for so long: the link is lost (PX4 sends 1 Hz)."""
    blind_s: float = 0.5
    """No usable state for so long in flight: land and stop streaming (PX4's own failsafe follows)."""
    stream_before_offboard_s: float = 0.5


class Observer(Protocol):
    """Who wants to know (the log, the progress bar).  Called inside the tick: must be quick and must not raise."""

    def on_event(self, t_us: int, name: str, text: str, severity: str) -> None:
        """A transition, a change of mode, a text of the vehicle; `t_us` in the vehicle's time."""

    def on_tick(self, record: TickRecord) -> None:
        """One tick of the stack."""

    def on_message(self, t_us: int, message: object) -> None:
        """A message of the identified vehicle, at vehicle time `t_us`."""


class Companion:
    """One flight: from the first heartbeat to disarmed in Hold, or to the reason why not."""

    def __init__(
        self, link: Link, stack: Stack, scenario: Scenario, observer: Observer, config: CompanionConfig
    ) -> None:
        self.link = link
        self.view = VehicleView()
        self.state = State.DISCONNECTED
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
        self.start_ned_m: F64 = np.zeros(3)
        """Estimated position where the flight began, (3,): the scenario's coordinates are relative to it."""
        self._system = 0
        self._foreign_system = 0
        self._commands = CommandQueue(link)
        self._entered_us = -1
        self._started_us = -1
        self._heartbeat_due_us = 0
        self._timesync_due_us = 0
        self._stack_state: StackState | None = None
        self._last_good_us = -1
        self._stop_requested = ""
        self._hold: FlatOutput | None = None
        self._mode_seen = -1
        self._mission_complete = False
        self._landing = False
        """PX4 has taken the command to land; that the mode falls back to OFFBOARD after it disarms means nothing."""
        self._t_us = 0
        self._measured: Measurement | None = None
        self._decide = {
            State.DISCONNECTED: self._event_disconnected,
            State.IDENTIFYING: self._event_identifying,
            State.STANDBY: self._event_standby,
            State.STREAMING: self._event_streaming,
            State.OFFBOARD: self._event_offboard,
            State.LANDING: self._event_landing,
        }

    # ---------------------------------------------------------------- outside

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
        self._stop_requested = self._stop_requested or reason

    def receive_datagram(self, data: bytes, now_us: int) -> None:
        """Take what arrived from the wire."""
        self.link.receive_datagram(data, now_us)

    def step(self, now_us: int) -> None:
        """One period: read, decide, act."""
        if self._started_us < 0:
            self._started_us = self._entered_us = now_us
        self._t_us = self.view.clock.vehicle_us(now_us)
        self._read(now_us)
        self._t_us = self.view.clock.vehicle_us(now_us)
        self._measured = None
        if not self.done:
            self.last_t_us = self._t_us
        for _ in range(len(State)):  # a chain of transitions within one period is at most that long
            event = self._event(now_us)
            after = transition(self.state, event) if event is not None else None
            if event is None or after is None:
                break
            self._enter(after, event, now_us)
        self._act(now_us)

    # ---------------------------------------------------------------- read

    def _read(self, now_us: int) -> None:
        while (received := self.link.next_event()) is not None:
            if self._system == 0:
                self._meet(received, now_us)
            elif received.system == self._system and received.component == px4.COMPONENT_AUTOPILOT:
                self._take(received, now_us)
            elif isinstance(received.message, m.Heartbeat) and received.message.autopilot == px4.AUTOPILOT_PX4:
                self._foreign_system = received.system

    def _meet(self, received: Received, now_us: int) -> None:
        """Before anyone is identified only heartbeats of autopilots count."""
        message = received.message
        if isinstance(message, m.Heartbeat) and received.component == px4.COMPONENT_AUTOPILOT:
            self._system = received.system
            self.link.expect_peer(received.system)
            self._take(received, now_us)

    def _take(self, received: Received, now_us: int) -> None:
        message = received.message
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

    # ---------------------------------------------------------------- decide

    def _event(self, now_us: int) -> Event | None:
        """The first thing that matters in the present state."""
        if self.state in FINAL:
            return None
        in_state_s = (now_us - self._entered_us) / SECOND_US
        if self._stop_requested and self.state is not State.LANDING:
            self.reason = self._stop_requested
            return Event.STOP
        if self.state is not State.DISCONNECTED and self._link_lost(now_us):
            return Event.LINK_LOST
        if self._foreign_system and self.state in (State.IDENTIFYING, State.STANDBY, State.STREAMING):
            self.reason = f"two autopilots on one link (systems {self._system} and {self._foreign_system}): refusing"
            return Event.FOREIGN
        decide = self._decide.get(self.state)
        return decide(now_us, in_state_s) if decide is not None else None

    def _event_disconnected(self, now_us: int, in_state_s: float) -> Event | None:
        if self._system:
            return Event.HEARTBEAT
        if in_state_s > self._config.heartbeat_timeout_s:
            self.reason = (
                f"no heartbeat of an autopilot within {self._config.heartbeat_timeout_s:g} s: "
                "check that the vehicle or simulator runs and sends to this address and port"
            )
            return Event.TIMEOUT
        return None

    def _event_identifying(self, now_us: int, in_state_s: float) -> Event | None:
        heartbeat = self.view.heartbeat
        assert heartbeat is not None
        if heartbeat.autopilot != px4.AUTOPILOT_PX4:
            self.reason = (
                f"the autopilot of system {self._system} is no PX4 (MAV_AUTOPILOT {heartbeat.autopilot}, "
                f"PX4 is {px4.AUTOPILOT_PX4}): this companion flies PX4 only"
            )
            return Event.FOREIGN
        if heartbeat.type != px4.TYPE_QUADROTOR:
            self.reason = (
                f"the vehicle is no quadrotor (MAV_TYPE {heartbeat.type}): this companion flies quadrotors only"
            )
            return Event.FOREIGN
        if self.view.version is not None:
            return Event.IDENTIFIED
        if in_state_s > self._config.identify_timeout_s:
            self.reason = f"system {self._system} did not answer who it is (AUTOPILOT_VERSION): is the link two-way?"
            return Event.TIMEOUT
        return None

    def _event_standby(self, now_us: int, in_state_s: float) -> Event | None:
        view = self.view
        if view.armed and (self._config.arm or view.in_offboard or view.intends_offboard):
            # Setpoints would make PX4 go back to OFFBOARD by itself, even out of a failsafe that has landed.
            self.reason = f"the vehicle is already armed (in {view.mode_name}), not by this companion: not taking over"
            return Event.BUSY
        missing = self._missing(now_us)
        if not missing:
            return Event.READY
        if in_state_s > self._config.ready_timeout_s:
            texts = "; ".join(dict.fromkeys(view.recent_texts(now_us, 10 * SECOND_US)))
            self.reason = f"not ready within {self._config.ready_timeout_s:g} s: {', '.join(missing)}" + (
                f" (vehicle says: {texts})" if texts else ""
            )
            return Event.TIMEOUT
        return None

    def _missing(self, now_us: int) -> list[str]:
        """What stands between the vehicle and a flight, in words."""
        view = self.view
        missing = []
        if not self._fresh(self._measure(now_us)):
            missing.append("no fresh attitude, position and IMU streams")
        flags = view.estimator_flags
        if flags & _ESTIMATOR_READY != _ESTIMATOR_READY or not flags & _ESTIMATOR_POSITION:
            missing.append(f"estimate not good (ESTIMATOR_STATUS flags {flags:#x})")
        if view.landed_state == 0:
            missing.append("landed state unknown")
        return missing

    def _event_streaming(self, now_us: int, in_state_s: float) -> Event | None:
        view, config = self.view, self._config
        if view.armed and view.in_offboard:
            return Event.ENGAGED
        if not config.arm:
            return None
        if in_state_s < config.stream_before_offboard_s:
            return None
        arm_request = self._commands.status(px4.Cmd.COMPONENT_ARM_DISARM)
        if arm_request.accepted and view.mode_at_us > arm_request.answered_us and not view.in_offboard:
            self.reason = f"the mode changed to {view.mode_name} while arming: leaving the vehicle to the pilot"
            return Event.TOOK_OVER
        if in_state_s > config.stream_before_offboard_s + config.arm_timeout_s:
            what = "arming" if view.in_offboard else "OFFBOARD mode"
            command = px4.Cmd.COMPONENT_ARM_DISARM if view.in_offboard else px4.Cmd.DO_SET_MODE
            self.reason = f"{what} refused: {self._why_refused(command, now_us)}"
            return Event.ARM_REFUSED
        return None

    def _why_refused(self, command: px4.Cmd, now_us: int) -> str:
        result = self._commands.status(command).result
        answer = "no answer" if result is None else px4.describe_result(result)
        texts = "; ".join(dict.fromkeys(self.view.recent_texts(now_us, 12 * SECOND_US)))
        return f"{answer} (vehicle says: {texts})" if texts else f"{answer} (the vehicle gave no reason)"

    def _event_offboard(self, now_us: int, in_state_s: float) -> Event | None:
        view = self.view
        if view.heartbeat_at_us > self._entered_us and not view.armed:
            self.reason = "the vehicle was disarmed by someone else"
            return Event.TOOK_OVER
        if view.mode_at_us > self._entered_us and not view.in_offboard:
            texts = "; ".join(dict.fromkeys(view.recent_texts(now_us, 3 * SECOND_US)))
            self.reason = f"the vehicle left OFFBOARD for {view.mode_name}, not by this companion: hands off" + (
                f" (vehicle says: {texts})" if texts else ""
            )
            return Event.TOOK_OVER
        if self.mission is not None and self.mission.phase(self._mission_time_s(now_us)) == "done":
            self._mission_complete = True
            return Event.MISSION_DONE
        return None

    def _event_landing(self, now_us: int, in_state_s: float) -> Event | None:
        view = self.view
        if view.heartbeat_at_us > self._entered_us and not view.armed:
            return Event.DISARMED
        settled = view.mode_at_us > self._entered_us + SECOND_US // 2
        if settled and view.custom_mode not in (px4.MODE_LAND, px4.MODE_OFFBOARD):
            self.reason = f"the mode changed to {view.mode_name} while landing: leaving the vehicle to the pilot"
            self._mission_complete = False
            return Event.TOOK_OVER
        return None

    def _link_lost(self, now_us: int) -> bool:
        silent_s = (now_us - self.view.heartbeat_at_us) / SECOND_US
        if silent_s > self._config.link_loss_s:
            self.reason = f"link lost: no heartbeat for {silent_s:.1f} s"
            return True
        if self.state is State.OFFBOARD and self._last_good_us >= 0:
            blind_s = (now_us - self._last_good_us) / SECOND_US
            if blind_s > self._config.blind_s:
                self.reason = f"no usable state for {blind_s:.1f} s: landing commanded, setpoints stopped"
                return True
        return False

    # ---------------------------------------------------------------- act

    def _enter(self, state: State, event: Event, now_us: int) -> None:
        """What happens once, on the way into a state."""
        self.state, self._entered_us = state, now_us
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
                self.mission = self.mission.stop(self._mission_time_s(now_us))
            self._set_phase("land", t_us)
            self._command_mode(px4.MODE_LAND, now_us)
        elif state is State.LOST:
            self.land_command_us = t_us if self.land_command_us < 0 else self.land_command_us
            self._command_mode(px4.MODE_LAND, now_us)
        elif state is State.LANDED:
            self._set_phase("landed", t_us)
            self._command_mode(px4.MODE_HOLD, now_us)

    def _engage(self, now_us: int, t_us: int) -> None:
        measurement = self._measure(now_us)
        assert measurement is not None  # STREAMING is not entered without one
        self.mission = plan(self._scenario, measurement.pos_ned_m, _yaw(measurement.q_ned_frd))
        self.start_ned_m = measurement.pos_ned_m.copy()
        self._stack_state = self._stack.init(measurement)
        self._last_good_us = now_us
        self.flight_start_us = t_us

    def _act(self, now_us: int) -> None:
        """What happens in every period of a state."""
        if self.state in FINAL and self._entered_us != now_us:
            return
        if now_us >= self._heartbeat_due_us and self._system:
            self._heartbeat_due_us = now_us + SECOND_US
            self._send_heartbeats()
        if now_us >= self._timesync_due_us and self._system:
            self._timesync_due_us = now_us + _TIMESYNC_PERIOD_US
            self.link.send(m.Timesync(0, now_us * 1000, self._system, px4.COMPONENT_AUTOPILOT))
        if self.state is State.IDENTIFYING:
            self._commands.ensure(self._request(m.AutopilotVersion), now_us)
        elif self.state is State.STREAMING and not self._config.dry_run:
            self._stream_idle(now_us)
            if self._config.arm:
                self._ask_for_offboard_and_arm(now_us)
        elif self.state is State.OFFBOARD:
            self._fly(now_us)
        elif self.state is State.LANDING:
            self._landing = self._landing or self.view.custom_mode == px4.MODE_LAND
            if not self._landing:  # until PX4 says that it lands, the stack holds the vehicle
                self._fly(now_us)
                self._command_mode(px4.MODE_LAND, now_us)
        self._commands.step(now_us, self._system)

    def _ask_for_offboard_and_arm(self, now_us: int) -> None:
        if (now_us - self._entered_us) / SECOND_US < self._config.stream_before_offboard_s:
            return
        if not self.view.in_offboard:
            self._command_mode(px4.MODE_OFFBOARD, now_us)
        elif not self.view.armed and not self._commands.status(px4.Cmd.COMPONENT_ARM_DISARM).accepted:
            self._commands.ensure((px4.Cmd.COMPONENT_ARM_DISARM, (1.0,)), now_us)

    def _stream_idle(self, now_us: int) -> None:
        """Setpoints that are safe at the moment of the switch: nothing on the ground, hold the place in the air."""
        t_us = self._t_us
        measurement = self._measure(now_us)
        if measurement is None or self.view.on_ground or not self.view.armed:
            self._stack_state = self._hold = None
            self._send_setpoint(Command(t_us, 0.0, 0.0, np.zeros(3)))
            return
        if self._stack_state is None or self._hold is None:
            self._stack_state = self._stack.init(measurement)
            self._hold = _hover_at(measurement)
        self._tick(measurement, self._hold, t_us)

    def _fly(self, now_us: int) -> None:
        assert self.mission is not None
        t_us = self._t_us
        measurement = self._measure(now_us)
        if self._fresh(measurement):
            self._last_good_us = now_us
        mission_s = self._mission_time_s(now_us)
        if self.state is State.OFFBOARD:
            self._set_phase(self.mission.phase(mission_s), t_us)
        self._tick(measurement, self.mission.reference(mission_s), t_us)

    def _tick(self, measurement: Measurement | None, setpoint: FlatOutput, t_us: int) -> None:
        assert self._stack_state is not None
        self._stack_state, command, record = self._stack.tick(self._stack_state, measurement, setpoint, t_us)
        self._send_setpoint(command)
        self._observer.on_tick(record)
        self.ticks += 1

    def _measure(self, now_us: int) -> Measurement | None:
        """The state at this step, predicted once."""
        if self._measured is None:
            self._measured = predict(self.view.streams, self._t_us)
        return self._measured

    def _fresh(self, measurement: Measurement | None) -> bool:
        return not stale(measurement, self._stack.limits)

    def _mission_time_s(self, now_us: int) -> float:
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
        rates = command.rate_frd_radps
        self.link.send(
            m.SetAttitudeTarget(
                command.t_us,
                self._system,
                px4.COMPONENT_AUTOPILOT,
                _FULL_MASK_RATES,
                (1.0, 0.0, 0.0, 0.0),
                (float(rates[0]), float(rates[1]), float(rates[2])),
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
    return FlatOutput(measurement.pos_ned_m.copy(), zero, zero, zero, zero, _yaw(measurement.q_ned_frd))
