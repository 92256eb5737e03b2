"""What the companion knows of the vehicle, gathered from its messages; nothing here is ever assumed or commanded."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

import numpy as np

from flightstack.predictor import Streams, sampled
from flightstack.types import STANDARD_GRAVITY_MPS2
from mavlink_bridge import messages as m
from mavlink_bridge.command_latency import CommandLatency
from mavlink_bridge.command_way import CommandWay
from mavlink_bridge.px4 import ARMED_BIT, MAIN_OFFBOARD, STATE_TERMINATED, describe_mode, main_mode
from mavlink_bridge.vehicle_clock import VehicleClock
from mavlink_bridge.vehicle_params import ParamReader

_TEXT_MEMORY = 50
_WARNING = 4
"""MAV_SEVERITY."""
_LOW_PERCENT = 15
"""Below it PX4 warns by default (BAT_LOW_THR)."""
_HEARTBEAT_LATE_US = 2_500_000
"""PX4 sends one a second, and a vehicle's second beside a busy machine lasts longer."""
_MODE_AND_INTENTION_US = 1_000_000
_IDLE_SHARE = 0.3
"""Of the thrust that hovers; PX4's default of that stands well where the true one is twice or half as much."""
_WEIGHT_OFF_MPS2 = 1.0
_QUICK_US = 40_000
"""A round trip of a link that is quick enough now and then, whatever most take."""
_ROUND_TRIPS, _LATEST = 6_000, 10
"""Ten minutes of them, and a second."""


class VehicleView:
    """The latest of every message that matters, with its local time of receipt (`*_at_us`, -1 before the first)."""

    def __init__(self) -> None:
        self.clock = VehicleClock()
        self.heartbeat: m.Heartbeat | None = None
        self.heartbeat_at_us = -1
        self.heard_at_us = -1
        """The latest message of any kind: on a lossy link three heartbeats in a row may be lost."""
        self.stood_us = 0
        """For so long, local time, stamps of the vehicle have come that did not move on."""
        self.custom_mode = 0
        self.intended_mode = 0
        self.intended_at_us = -1
        self.mode_at_us = -1
        self.landed_state = 0
        self.estimator_flags = 0
        self.accuracy_m = math.nan, math.nan
        """One standard deviation of position, across and down, as the estimator states it; NaN: not stated."""
        self.place: tuple[float, float] | None = None
        """Latitude and longitude; None: not told."""
        self.params = ParamReader()
        self.latency = CommandLatency()
        self.way = CommandWay()
        self.version: m.AutopilotVersion | None = None
        self.streams = Streams()
        self.battery_v = float("nan")
        self.charge_percent = -1
        """Of the battery; -1: not told."""
        self.can_arm = False
        self.other_system = 0
        """Another autopilot that speaks to our port from one of its own; 0: none."""
        self.texts: deque[tuple[int, int, str]] = deque(maxlen=_TEXT_MEMORY)
        """(local time of receipt, severity, text), whole messages only."""
        self.round_trips_us: deque[int] = deque(maxlen=_ROUND_TRIPS)
        """Local microseconds from our TIMESYNC questions to their answers."""
        self.least_round_trip_us = 0
        """Quickest of the last ten round trips, a second; 0 before the tenth.  A stall does not show in it."""
        self.round_trip_us = 0
        """Median of the last ten round trips; 0 before the third one."""
        self.counts: Counter[type] = Counter()
        """Messages taken one by one, by kind."""
        self._partial_text = ""

    @property
    def armed(self) -> bool:
        """Armed according to the last heartbeat (1 Hz)."""
        return self.heartbeat is not None and bool(self.heartbeat.base_mode & ARMED_BIT)

    def ended_by_others(self, since_us: int) -> str:
        """Why nothing that is sent flies the vehicle any more, by a heartbeat after local time `since_us`; empty: it
        does.  Killed or terminated by a failsafe PX4 stays armed and shows the mode of before."""
        if self.heartbeat is None or self.heartbeat_at_us <= since_us:
            return ""
        if not self.armed:
            return "the vehicle was disarmed by someone else"
        stopped = self.heartbeat.system_status == STATE_TERMINATED
        return "the vehicle's motors are stopped (kill switch or flight termination): hands off" if stopped else ""

    @property
    def in_offboard(self) -> bool:
        """OFFBOARD according to the latest of HEARTBEAT and CURRENT_MODE."""
        return main_mode(self.custom_mode) == MAIN_OFFBOARD

    @property
    def intends_offboard(self) -> bool:
        """OFFBOARD is what PX4 goes back to as soon as setpoints arrive."""
        return main_mode(self.intended_mode) == MAIN_OFFBOARD

    @property
    def would_return(self) -> bool:
        """Another mode flies, as in a failsafe, and setpoints would bring OFFBOARD back: by one report of both."""
        return self.intends_offboard and not self.in_offboard and self.intended_at_us >= self.mode_at_us

    @property
    def may_return(self) -> bool:
        """As `would_return`, where a HEARTBEAT has told the mode since: CURRENT_MODE, which tells both, comes soon."""
        together = self.mode_at_us - self.intended_at_us < _MODE_AND_INTENTION_US
        return self.intends_offboard and not self.in_offboard and together

    @property
    def heartbeat_is_missing(self) -> bool:
        """It speaks, but its last heartbeat is old."""
        return self.heard_at_us - self.heartbeat_at_us > _HEARTBEAT_LATE_US

    @property
    def on_ground(self) -> bool:
        """The land detector says so (unknown counts as not on the ground)."""
        return self.landed_state == 1

    @property
    def stands(self) -> bool:
        """Something else than its motors carries it, whatever the estimator makes of that.

        Thrust goes with the command, or with more than its first power: three tenths of what hovers carry no half.
        """
        seen = sampled(self.streams, self.streams.imu_us, corrected=False)
        if seen is None:
            return False
        command, weight = float(np.mean(seen.motor_command)), float(np.linalg.norm(seen.specific_force_frd_mps2))
        idle = command < _IDLE_SHARE * self.params.values.get("MPC_THR_HOVER", math.nan)
        return idle and abs(weight - STANDARD_GRAVITY_MPS2) < _WEIGHT_OFF_MPS2

    def is_slower_than(self, round_trip_s: float) -> bool:
        """Whether the link has become slower: half of a second's trips, and none of them was a quick one."""
        return self.round_trip_us > 1e6 * round_trip_s and self.least_round_trip_us > _QUICK_US

    @property
    def mode_name(self) -> str:
        """The mode in PX4's words."""
        return describe_mode(self.custom_mode)

    def note_mode(self, custom_mode: int, at_us: int) -> None:
        """A mode that somebody else heard of at a local time; counts where it is news."""
        if at_us > self.mode_at_us:
            self.custom_mode, self.mode_at_us = custom_mode, at_us

    def update(self, message: object, now_us: int) -> None:
        """Take one message of the identified vehicle, received at local time `now_us`."""
        self.heard_at_us = now_us
        self.counts[type(message)] += 1
        handler = _HANDLERS.get(type(message))
        if handler is not None:
            handler(self, message, now_us)

    def says(self, now_us: int, window_s: int) -> str:
        """Its warnings (or worse) of the last seconds and a low battery, in brackets; empty where there are none."""
        since_us = now_us - window_s * 1_000_000
        texts = [text for at_us, severity, text in self.texts if at_us >= since_us and severity <= _WARNING]
        if 0 <= self.charge_percent < _LOW_PERCENT:
            texts.append(f"battery at {self.charge_percent} %")
        return f" (vehicle says: {'; '.join(dict.fromkeys(texts))})" if texts else ""

    def _on_heartbeat(self, message: m.Heartbeat, now_us: int) -> None:
        self.heartbeat, self.heartbeat_at_us = message, now_us
        self.custom_mode, self.mode_at_us = message.custom_mode, now_us

    def _on_current_mode(self, message: m.CurrentMode, now_us: int) -> None:
        self.custom_mode, self.mode_at_us = message.custom_mode, now_us
        self.intended_mode, self.intended_at_us = message.intended_custom_mode, now_us

    def _on_attitude(self, message: m.AttitudeQuaternion, now_us: int) -> None:
        self.streams.attitude(message.t_boot_us, message.q_ned_frd, message.rate_frd_radps)

    def _on_position(self, message: m.LocalPositionNed, now_us: int) -> None:
        self.streams.position(message.t_boot_us, message.pos_ned_m, message.vel_ned_mps)

    def _on_imu(self, message: m.HighresImu, now_us: int) -> None:
        self.streams.imu(message.t_us, message.accel_frd_mps2, message.rate_frd_radps)
        self.clock.observe(message.t_us, now_us)  # the one stream whose stamps have microseconds, not milliseconds

    def _on_raw_imu(self, message: m.ScaledImu, now_us: int) -> None:
        self.streams.raw_imu(message.t_boot_us, message.accel_frd_mps2)

    def _on_motors(self, message: m.ServoOutputRaw, now_us: int) -> None:
        if message.port == 0:
            commands = self.params.outputs_now.commands(message.pwm_us)
            self.streams.motors(message.t_us, commands)
            self.latency.reported(message.t_us, commands)

    def _on_globe(self, message: m.GlobalPositionInt, now_us: int) -> None:
        self.place = message.lat_deg, message.lon_deg

    def _on_landed(self, message: m.ExtendedSysState, now_us: int) -> None:
        self.landed_state = message.landed_state

    def _on_estimator(self, message: m.EstimatorStatus, now_us: int) -> None:
        self.estimator_flags = message.flags
        self.accuracy_m = message.pos_horiz_accuracy_m, message.pos_vert_accuracy_m

    def _on_param(self, message: m.ParamValue | m.ParamError, now_us: int) -> None:
        self.params.take(message)

    def _on_version(self, message: m.AutopilotVersion, now_us: int) -> None:
        self.version = message

    def _on_status(self, message: m.SysStatus, now_us: int) -> None:
        self.can_arm = bool(message.health & _PREARM_BIT)
        self.battery_v, self.charge_percent = message.voltage_v, message.remaining

    def _on_text(self, message: m.Statustext, now_us: int) -> None:
        """Put the 50-character chunks of a long text together; a chunk that is full has a next one."""
        self._partial_text += message.text
        if message.id and len(message.text) >= 50:
            return
        text, self._partial_text = self._partial_text.strip(), ""
        if text:
            self.texts.append((now_us, message.severity, text))

    def _on_timesync(self, message: m.Timesync, now_us: int) -> None:
        """The answer to a question of ours carries our own stamp; the vehicle's own questions have tc1 0."""
        if message.tc1_ns:
            self.round_trips_us.append(max(0, now_us - message.ts1_ns // 1000))
            latest = sorted(list(self.round_trips_us)[-_LATEST:])
            self.least_round_trip_us = latest[0] if len(latest) >= _LATEST else 0
            self.round_trip_us = latest[len(latest) // 2] if len(latest) >= 3 else 0
            asked_us, vehicle_us = message.ts1_ns // 1000, message.tc1_ns // 1000
            self.clock.observe_round_trip(asked_us, vehicle_us, now_us)
            trip_us = round(self.clock.rate * (now_us - asked_us))
            self.way.answered(vehicle_us - self.clock.vehicle_us(asked_us), trip_us)


def what_is_lost(view: VehicleView, now_us: int, most_s: float) -> str:
    """Why there is nothing to fly with any more; empty where there is.

    The stamps of a real PX4 whose estimator was stopped went on by 0.1 s in two minutes: by its own clock nothing was
    ever old.
    """
    silent_s, stood_s = 1e-6 * (now_us - view.heard_at_us), 1e-6 * view.stood_us
    if silent_s > most_s:
        return f"link lost: nothing heard for {silent_s:.1f} s"
    return f"the vehicle's clock has stood still for {stood_s:.1f} s" if stood_s > most_s else ""


_PREARM_BIT = 1 << 28

_HANDLERS: dict[type, Callable[[VehicleView, Any, int], None]] = {
    m.Heartbeat: VehicleView._on_heartbeat,
    m.CurrentMode: VehicleView._on_current_mode,
    m.AttitudeQuaternion: VehicleView._on_attitude,
    m.LocalPositionNed: VehicleView._on_position,
    m.HighresImu: VehicleView._on_imu,
    m.ScaledImu: VehicleView._on_raw_imu,
    m.ServoOutputRaw: VehicleView._on_motors,
    m.ExtendedSysState: VehicleView._on_landed,
    m.GlobalPositionInt: VehicleView._on_globe,
    m.EstimatorStatus: VehicleView._on_estimator,
    m.AutopilotVersion: VehicleView._on_version,
    m.SysStatus: VehicleView._on_status,
    m.ParamValue: VehicleView._on_param,
    m.ParamError: VehicleView._on_param,
    m.Statustext: VehicleView._on_text,
    m.Timesync: VehicleView._on_timesync,
}
