"""The streams: one table of what is sent how often on which link, and the streams of one link.

Default rates were measured on PX4 1.18 (its onboard link and its ground station link); `most_hz` is what its sources
give at most, however much is asked for.  All times are simulated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

from flightstack_sim import builders as b
from flightstack_sim.schedule import STOPPED, Schedule
from flightstack_sim.tick_frames import KINDS, TickFrames, plain
from flightstack_sim.view import View
from mavlink_bridge import messages as m
from mavlink_bridge.link import Link

TICK_HZ: Final = 250.0
_STAGGER_US: Final = 4_000


class LinkKind(Enum):
    """Which of PX4's sets of default streams a link has."""

    ONBOARD = "onboard"
    GCS = "gcs"


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """One row of the table."""

    event: type[Any]
    onboard_hz: float
    """Default rate on the onboard link; 0: on request only."""
    gcs_hz: float
    """Default rate on the ground station link."""
    build: Callable[[View], Any]
    most_hz: float = TICK_HZ
    """What its source gives."""
    fixed: bool = False
    """Its interval can't be changed."""

    @property
    def id(self) -> int:
        """MAVLink id."""
        return m.id_of(self.event)

    def default_us(self, kind: LinkKind) -> int:
        """Default interval on a kind of link, STOPPED where it isn't sent."""
        rate_hz = self.onboard_hz if kind is LinkKind.ONBOARD else self.gcs_hz
        return int(1e6 / rate_hz) if rate_hz > 0.0 else STOPPED

    @property
    def least_us(self) -> int:
        """Shortest interval that its source can serve."""
        return int(1e6 / self.most_hz)


_EVERY_3_S: Final = 1.0 / 3.0
_EVERY_6_S: Final = 1.0 / 6.0

STREAMS: Final[tuple[StreamSpec, ...]] = (
    StreamSpec(m.Heartbeat, 1.0, 1.0, b.heartbeat, fixed=True),
    StreamSpec(m.AttitudeQuaternion, 50.0, 50.0, b.attitude_quaternion, most_hz=198.0),
    StreamSpec(m.LocalPositionNed, 30.0, 50.0, b.local_position_ned, most_hz=125.0),
    StreamSpec(m.ServoOutputRaw, 10.0, 50.0, b.servo_output_raw),
    StreamSpec(m.HighresImu, 50.0, 0.0, b.highres_imu),
    StreamSpec(m.Attitude, 100.0, 50.0, b.attitude, most_hz=198.0),
    StreamSpec(m.Odometry, 30.0, 0.0, b.odometry, most_hz=125.0),
    StreamSpec(m.GlobalPositionInt, 50.0, 50.0, b.global_position_int, most_hz=125.0),
    StreamSpec(m.AttitudeTarget, 10.0, 50.0, b.attitude_target),
    StreamSpec(m.PositionTargetLocalNed, 10.0, 50.0, b.position_target_local_ned, most_hz=125.0),
    StreamSpec(m.PositionTargetGlobalInt, 10.0, 1.0, b.position_target_global_int, most_hz=50.0),
    StreamSpec(m.GpsRawInt, 8.0, 5.0, b.gps_raw_int, most_hz=8.0),
    StreamSpec(m.Timesync, 10.0, 0.0, b.timesync),
    StreamSpec(m.Altitude, 10.0, 1.0, b.altitude),
    StreamSpec(m.DistanceSensor, 10.0, 0.5, b.distance_sensor),
    StreamSpec(m.VfrHud, 10.0, 4.0, b.vfr_hud),
    StreamSpec(m.ExtendedSysState, 5.0, 1.0, b.extended_sys_state),
    StreamSpec(m.SysStatus, 5.0, 1.0, b.sys_status),
    StreamSpec(m.MissionCurrent, 1.0, 1.0, b.mission_current),
    StreamSpec(m.EstimatorStatus, 1.0, 0.5, b.estimator_status),
    StreamSpec(m.OpenDroneIdLocation, 1.0, 1.0, b.open_drone_id_location),
    StreamSpec(m.OpenDroneIdSystem, 1.0, 1.0, b.open_drone_id_system),
    StreamSpec(m.Ping, 1.0, _EVERY_6_S, b.ping),
    StreamSpec(m.ScaledPressure, 1.0, 1.0, b.scaled_pressure),
    StreamSpec(m.SystemTime, 1.0, 0.0, b.system_time),
    StreamSpec(m.LinkNodeStatus, 1.0, 1.0, b.link_node_status),
    StreamSpec(m.BatteryStatus, 0.5, 0.5, b.battery_status),
    StreamSpec(m.CurrentMode, 0.5, 0.5, b.current_mode),
    StreamSpec(m.HomePosition, 0.5, 0.5, b.home_position),
    StreamSpec(m.Vibration, 0.5, _EVERY_6_S, b.vibration),
    StreamSpec(m.TimeEstimateToTarget, 0.5, 0.5, b.time_estimate_to_target),
    StreamSpec(m.CurrentEventSequence, _EVERY_3_S, _EVERY_3_S, b.current_event_sequence, fixed=True),
    StreamSpec(m.HilStateQuaternion, 0.0, 0.0, b.hil_state_quaternion),
    StreamSpec(m.GpsGlobalOrigin, 0.0, 0.0, b.gps_global_origin, most_hz=1.0),
    StreamSpec(m.ScaledImu, 0.0, 0.0, b.scaled_imu),
    StreamSpec(m.ActuatorOutputStatus, 0.0, 0.0, b.actuator_output_status),
)
"""The table, in the order in which messages of one tick go out."""

SILENT: Final = frozenset({65, 231})
"""RC_CHANNELS and WIND_COV: an interval is taken, but without sticks and airspeed PX4 has nothing to send."""

_INDEX: Final = {spec.id: index for index, spec in enumerate(STREAMS)}
_BUILDERS: Final = tuple(spec.build for spec in STREAMS)
_COMPILED: Final = tuple(KINDS.index(spec.event) + 1 if spec.event in KINDS else 0 for spec in STREAMS)
"""Number in `tick_frames`, 0 for what is built message by message."""
_IMU, _POSITION = KINDS.index(m.HighresImu) + 1, KINDS.index(m.LocalPositionNed) + 1

_ONCE: Final[dict[int, Callable[[View], Any]]] = {
    m.id_of(m.AutopilotVersion): b.autopilot_version,
    m.id_of(m.ProtocolVersion): b.protocol_version,
    m.id_of(m.FlightInformation): b.flight_information,
}
"""What REQUEST_MESSAGE gives besides the streams."""


def build_once(message_id: int, view: View) -> Any | None:
    """A message asked for by id; None where there is none to give."""
    index = _INDEX.get(message_id)
    build = _BUILDERS[index] if index is not None else _ONCE.get(message_id)
    return build(view) if build is not None else None


class LinkStreams:
    """The streams of one link."""

    __slots__ = ("_asked_us", "_frames", "_kind", "_schedule")

    def __init__(self, kind: LinkKind, start_us: int = 0) -> None:
        self._kind = kind
        self._schedule = Schedule()
        self._frames = TickFrames()
        self._asked_us: dict[int, int] = {}
        for index in range(len(STREAMS)):
            self._start(index, STREAMS[index].default_us(kind), start_us)

    def interval_us(self, message_id: int) -> int:
        """What GET_MESSAGE_INTERVAL answers: the interval asked for or the default; -1 stopped or unknown."""
        index = _INDEX.get(message_id)
        return self._asked_us.get(index, STOPPED) if index is not None else STOPPED

    def set_interval(self, message_id: int, interval_us: int, now_us: int) -> bool:
        """SET_MESSAGE_INTERVAL: > 0 an interval, 0 the default, < 0 stop; False for what can't be set."""
        if message_id in SILENT:
            return True
        index = _INDEX.get(message_id)
        if index is None or STREAMS[index].fixed:
            return False
        if interval_us == 0:
            interval_us = STREAMS[index].default_us(self._kind)
        self._start(index, interval_us, now_us)
        return True

    def _start(self, index: int, interval_us: int, now_us: int) -> None:
        """Phases differ from stream to stream, so that a tick doesn't carry everything at once."""
        if interval_us <= 0:
            self._asked_us[index] = STOPPED
            self._schedule.stop(index)
            return
        self._asked_us[index] = interval_us
        interval_us = max(interval_us, STREAMS[index].least_us)
        self._schedule.start(index, interval_us, now_us + index * _STAGGER_US % interval_us)

    def emit(self, view: View, link: Link) -> None:
        """Send what is due: runs of the frequent ones in one call each."""
        order, usual = 0, plain(view, link)
        for index in self._schedule.due(view.t_us):
            kind = _COMPILED[index]
            if kind and usual:
                if kind == _IMU:
                    view.sample_air()
                if kind != _POSITION or view.vehicle.sensors.position_valid:
                    order = order * 8 + kind
                continue
            if order:
                self._frames.send(order, view, link)
                order = 0
            message = _BUILDERS[index](view)
            if message is not None and type(message) not in view.silenced:
                link.send(message)
        if order:
            self._frames.send(order, view, link)
