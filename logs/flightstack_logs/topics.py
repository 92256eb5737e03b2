"""The one table of log topics: what each carries, in which units and frames, how often and where it comes from.

A topic is one row here; writer, reader, `log info` and the round-trip test walk the table.  The log time of a message
counts from 0 at the log's start (`log_clock`), microseconds in the API, nanoseconds in the file.
Names keep their meaning across topics: `pos_ned_m` is a position, north-east-down, whether it is the truth's, the
estimate's or the setpoint's.  Viewer topics (`Kind.VIEW`) are in Foxglove's well-known schemas, in frames `world` (ENU)
and `body` (FLU); they repeat what the tables say and are never read back.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from flightstack_logs.topic_fields import (
    COMMAND_FIELDS,
    CONTROL_FIELDS,
    FILTER_FIELDS,
    LEARNER_FIELDS,
    LOG_FIELDS,
    REFERENCE_FIELDS,
    TICK_FIELDS,
    TRUTH_FIELDS,
    f32,
    sample_time,
)
from flightstack_logs.topic_fields import (
    Field as Field,
)


class Kind(Enum):
    """How a topic's messages are encoded."""

    TABLE = "table"
    """Protocol buffer of this project, fields of fixed size: numbers read back as columns."""
    RAW = "raw"
    """Bytes as they were on the wire."""
    LOG = "log"
    """`foxglove.Log`: a line of text with a level; read back as columns `level`, `name`, `text`."""
    VIEW = "view"
    """A Foxglove message for the 3-D or map view."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One row: a topic of the log."""

    name: str
    kind: Kind
    schema: str
    rate_hz: float
    """Nominal; 0 where messages come as things happen."""
    source: str
    text: str
    fields: tuple[Field, ...] = ()

    @property
    def packed(self) -> bool:
        """Whether a compact log (`rows`) holds its messages packed, beside a thinned copy for viewers."""
        return self.name == MESSAGE or (self.kind is Kind.TABLE and self.rate_hz >= _PACKED_FROM_HZ)


MESSAGE = "/vehicle/message"
"""What the vehicle sent that decides something and stands in no table: replay needs it."""
_PACKED_FROM_HZ = 20.0
_DEAD_MAN_TIMES = {
    "alive": "when it said all this",
    "silent": "last setpoint before it took over",
    "began": "when it took over",
    "hold": "its first command to hold",
    "held": "when Hold was seen",
    "mode": "when a mode was heard last",
}
"""Of the dead-man's record, those that are times."""


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file carried inside the log: vehicle file, scenario, settings."""

    name: str
    media_type: str
    data: bytes


SITE_OUTLINES = "site-outlines.json"
"""Attachment of a flight in a site: its lines in metres from the place of arming."""
CERTIFICATE, FINAL_CERTIFICATE = "certificate.json", "certificate-final.json"
RESULT = "result.json"
"""Attachments: the certificate that a flight began with, and the last one that was made in flight."""

LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")
"""Levels of `foxglove.Log`, by number."""

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
"""MAVLink's severities, by number."""

_LEVEL_OF_SEVERITY = ("fatal", "fatal", "fatal", "error", "warning", "info", "info", "debug")


def severity_names(severity: int) -> tuple[str, str]:
    """Foxglove level and MAVLink name of a MAV_SEVERITY; numbers out of range count as the nearest."""
    number = min(max(severity, 0), len(SEVERITIES) - 1)
    return _LEVEL_OF_SEVERITY[number], SEVERITIES[number]


FILTER_STATUS = ("nothing certified", "not engaged", "passed", "changed", "infeasible", "not solved", "falsified")
"""Status of the barrier filter, by number; from `infeasible` on its fallback acts."""

_VEHICLE_TOPICS = (
    Topic(
        "/vehicle/attitude",
        Kind.TABLE,
        "flightstack.Attitude",
        200.0,
        "ATTITUDE_QUATERNION",
        "attitude and body rates as the vehicle reports them",
        (
            sample_time("t_boot_us"),
            f32("q_ned_frd", 4, "1", "attitude (w, x, y, z), body to world"),
            f32("rate_frd_radps", 3, "rad/s", "body rates"),
        ),
    ),
    Topic(
        "/vehicle/local_position",
        Kind.TABLE,
        "flightstack.LocalPosition",
        125.0,
        "LOCAL_POSITION_NED",
        "position and velocity as the vehicle reports them",
        (
            sample_time("t_boot_us"),
            f32("pos_ned_m", 3, "m", "position"),
            f32("vel_ned_mps", 3, "m/s", "velocity"),
        ),
    ),
    Topic(
        "/vehicle/imu",
        Kind.TABLE,
        "flightstack.Imu",
        250.0,
        "HIGHRES_IMU",
        "inertial sensors as the vehicle reports them",
        (
            sample_time("t_us"),
            f32("accel_frd_mps2", 3, "m/s^2", "specific force"),
            f32("rate_frd_radps", 3, "rad/s", "body rates"),
        ),
    ),
    Topic(
        "/vehicle/motors",
        Kind.TABLE,
        "flightstack.Motors",
        100.0,
        "SERVO_OUTPUT_RAW",
        "outputs to the motors as the vehicle reports them",
        (
            sample_time("t_us"),
            Field("pwm_us", "int32", 16, "us", "pulse width of each output, 0 where unused"),
        ),
    ),
    Topic(
        "/vehicle/battery",
        Kind.TABLE,
        "flightstack.Battery",
        1.0,
        "SYS_STATUS",
        "battery as the vehicle reports it",
        (
            f32("voltage_v", 0, "V", "voltage, NaN if not known"),
            f32("current_a", 0, "A", "current, NaN if not known"),
            Field("remaining", "int32", 0, "%", "charge left, -1 if not known"),
        ),
    ),
    Topic(
        "/vehicle/status",
        Kind.TABLE,
        "flightstack.Status",
        1.0,
        "HEARTBEAT, EXTENDED_SYS_STATE",
        "flight mode, arming and landing state as the vehicle reports them",
        (
            Field("mode", "string", 0, "", "name of the flight mode"),
            Field("armed", "bool", 0, "", "whether the motors are armed"),
            Field("landed", "bool", 0, "", "whether the vehicle says that it is on the ground"),
        ),
    ),
    Topic("/vehicle/statustext", Kind.LOG, "foxglove.Log", 0.0, "STATUSTEXT", "what the vehicle says", LOG_FIELDS),
)

_STACK_TOPICS = (
    Topic(
        "/truth",
        Kind.TABLE,
        "flightstack.Truth",
        25.0,
        "simulator",
        "the TRUTH, from the simulator; no controller ever sees it",
        TRUTH_FIELDS,
    ),
    Topic(
        "/setpoint",
        Kind.TABLE,
        "flightstack.Setpoint",
        25.0,
        "companion",
        "the scenario's reference at this tick",
        REFERENCE_FIELDS,
    ),
    Topic(
        "/command",
        Kind.TABLE,
        "flightstack.Command",
        250.0,
        "companion",
        "what was sent to the vehicle",
        COMMAND_FIELDS,
    ),
    Topic(
        "/tick",
        Kind.TABLE,
        "flightstack.Tick",
        250.0,
        "companion",
        "why the command is what it is: the stack's record of this tick",
        TICK_FIELDS,
    ),
    Topic(
        "/control",
        Kind.TABLE,
        "flightstack.Control",
        25.0,
        "companion",
        "the controller's parts of the command",
        CONTROL_FIELDS,
    ),
    Topic(
        "/learner",
        Kind.TABLE,
        "flightstack.Learner",
        25.0,
        "companion",
        "what the learner knows at this tick; absent where nothing learns",
        LEARNER_FIELDS,
    ),
    Topic(
        "/estimate",
        Kind.TABLE,
        "flightstack.Estimate",
        25.0,
        "companion",
        "how far the vehicle's velocity is from the derivative of its own position, and what of that is used",
        (
            f32("disagreement_ned_mps", 3, "m/s", "c: d(position)/dt less velocity, observed"),
            f32("rms_ned_mps", 3, "m/s", "root mean square of c over 15 s: the estimator's health"),
            f32("weight", 3, "1", "share of c that is added to the velocity"),
        ),
    ),
    Topic(
        "/filter",
        Kind.TABLE,
        "flightstack.Filter",
        25.0,
        "companion",
        "what the barrier filter did with the command, and by what margins; absent where nothing filters",
        FILTER_FIELDS,
    ),
    Topic(
        "/events",
        Kind.LOG,
        "foxglove.Log",
        0.0,
        "companion",
        "state and mode changes, phases of the flight, timed effects",
        LOG_FIELDS,
    ),
    Topic(
        "/clock",
        Kind.TABLE,
        "flightstack.Clock",
        1.0,
        "companion",
        "UTC and the vehicle's own time at this log time; also wherever the vehicle's clock leaps",
        (
            Field("utc_us", "int64", 0, "us", "UTC since 1970"),
            Field("vehicle_us", "int64", 0, "us", "the vehicle's time since its boot, -1 before it was known"),
        ),
    ),
    Topic(
        "/timing",
        Kind.TABLE,
        "flightstack.Timing",
        250.0,
        "companion",
        "how punctual the loop was; real time only",
        (
            f32("lateness_us", 0, "us", "start of the tick after its deadline"),
            f32("tick_us", 0, "us", "time that the tick took"),
            Field("missed", "int32", 0, "1", "deadlines missed so far"),
        ),
    ),
    Topic(
        "/step",
        Kind.TABLE,
        "flightstack.Step",
        250.0,
        "companion",
        "this machine's clock at each step: with it a flight in real time is replayed",
        (
            Field("received_us", "int64", 0, "us", "when what had arrived was taken"),
            Field("decided_us", "int64", 0, "us", "when the companion decided"),
        ),
    ),
    Topic(
        "/certifier",
        Kind.TABLE,
        "flightstack.CertifierAnswer",
        0.0,
        "companion",
        "when the process beside the flight answered, with a certificate or without",
        (
            Field("call", "int64", 0, "1", "which order"),
            Field("before", "int64", 0, "1", "ticks until the process was free for it"),
            Field("after", "int64", 0, "1", "ticks from then until the answer"),
        ),
    ),
    Topic(
        "/dead_man",
        Kind.TABLE,
        "flightstack.DeadMan",
        0.0,
        "dead-man",
        "what the dead-man did last, where that changed; times of this machine's clock",
        (
            *(Field(f"{name}_ns", "int64", 0, "ns", what) for name, what in _DEAD_MAN_TIMES.items()),
            Field("acts", "int64", 0, "1", "how often it took over"),
            Field("mode", "int64", 0, "1", "the vehicle's custom mode as it saw it"),
            Field("touched", "int64", 0, "1", "whether anybody else has changed the mode since"),
            Field("ended", "bool", 0, "1", "whether its process has ended"),
        ),
    ),
)

_VIEW_TOPICS = (
    Topic("/tf", Kind.VIEW, "foxglove.FrameTransforms", 25.0, "companion", "world (ENU) to body (FLU), as estimated"),
    Topic(
        "/truth/tf", Kind.VIEW, "foxglove.FrameTransforms", 25.0, "simulator", "world (ENU) to body_true (FLU), TRUTH"
    ),
    Topic("/pose", Kind.VIEW, "foxglove.PoseInFrame", 5.0, "companion", "estimated pose"),
    Topic("/truth/pose", Kind.VIEW, "foxglove.PoseInFrame", 5.0, "simulator", "true pose"),
    Topic("/path", Kind.VIEW, "foxglove.PosesInFrame", 1.0, "companion", "path flown so far, as estimated"),
    Topic("/truth/path", Kind.VIEW, "foxglove.PosesInFrame", 1.0, "simulator", "path flown so far, TRUTH"),
    Topic("/reference/path", Kind.VIEW, "foxglove.PosesInFrame", 0.0, "companion", "the whole reference path"),
    Topic("/scene", Kind.VIEW, "foxglove.SceneUpdate", 0.0, "companion", "vehicle, ground, safe region, reference"),
    Topic("/scene/path", Kind.VIEW, "foxglove.SceneUpdate", 1.0, "companion", "the flown path as a line"),
    Topic("/scene/region", Kind.VIEW, "foxglove.SceneUpdate", 0.0, "companion", "the certified region of positions"),
    Topic("/outline/vehicle", Kind.VIEW, "foxglove.PointCloud", 0.0, "companion", "rotors and arms as points"),
    Topic("/outline/path", Kind.VIEW, "foxglove.PointCloud", 1.0, "companion", "the flown path as points"),
    Topic("/outline/reference", Kind.VIEW, "foxglove.PointCloud", 0.0, "companion", "the reference path as points"),
    Topic(
        "/outline/region", Kind.VIEW, "foxglove.PointCloud", 0.0, "companion", "edge of the region that is asked for"
    ),
    Topic("/outline/certified", Kind.VIEW, "foxglove.PointCloud", 0.0, "companion", "edge of the certified region"),
    Topic("/outline/site", Kind.VIEW, "foxglove.PointCloud", 0.0, "companion", "edges of the site"),
    Topic("/outline/way", Kind.VIEW, "foxglove.PointCloud", 2.0, "companion", "the site filter's way to a stop"),
    Topic("/scene/way", Kind.VIEW, "foxglove.SceneUpdate", 2.0, "companion", "the site filter's way to a stop"),
    Topic("/scene/filter", Kind.VIEW, "foxglove.SceneUpdate", 10.0, "companion", "wanted and safe acceleration"),
    Topic("/vehicle/location", Kind.VIEW, "foxglove.LocationFix", 5.0, "GLOBAL_POSITION_INT", "place on the map"),
)

TOPICS: dict[str, Topic] = {
    topic.name: topic
    for topic in (
        Topic("/mavlink/rx", Kind.RAW, "mavlink.Datagram", 0.0, "socket", "datagrams that the companion received"),
        Topic("/mavlink/tx", Kind.RAW, "mavlink.Datagram", 0.0, "socket", "datagrams that the companion sent"),
        *_VEHICLE_TOPICS,
        Topic(MESSAGE, Kind.RAW, "mavlink.Message", 0.0, "vehicle", "messages that decide something and have no table"),
        *_STACK_TOPICS,
        *_VIEW_TOPICS,
    )
}
