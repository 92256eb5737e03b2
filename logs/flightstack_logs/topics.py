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
class Field:
    """One field of a TABLE topic."""

    name: str
    type: str
    """double, float, int64, int32, bool or string."""
    size: int
    """0 for a scalar, else the length of the array."""
    unit: str
    text: str
    path: str = ""
    """Attribute path within the record, where it isn't the name."""


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


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file carried inside the log: vehicle file, scenario, settings."""

    name: str
    media_type: str
    data: bytes


CERTIFICATE, FINAL_CERTIFICATE = "certificate.json", "certificate-final.json"
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


def _f64(name: str, size: int, unit: str, text: str, path: str = "") -> Field:
    return Field(name, "double", size, unit, text, path)


def _f32(name: str, size: int, unit: str, text: str, path: str = "") -> Field:
    return Field(name, "float", size, unit, text, path)


def _measured(name: str, size: int, unit: str, text: str) -> Field:
    return _f64(name, size, unit, text, f"measurement.{name}")


def _proposed(name: str, size: int, unit: str, text: str) -> Field:
    return _f32(name, size, unit, text, f"proposal.{name}")


def _sample_time(name: str) -> Field:
    return Field(name, "int64", 0, "us", "sample time by the vehicle's clock, since its boot")


_REFERENCE_FIELDS = (
    _f64("pos_ned_m", 3, "m", "position"),
    _f32("vel_ned_mps", 3, "m/s", "velocity"),
    _f32("acc_ned_mps2", 3, "m/s^2", "acceleration"),
    _f32("jerk_ned_mps3", 3, "m/s^3", "jerk"),
    _f32("snap_ned_mps4", 3, "m/s^4", "snap"),
    _f32("yaw_rad", 0, "rad", "heading"),
    _f32("yaw_rate_radps", 0, "rad/s", "rate of the heading"),
)

_COMMAND_FIELDS = (
    _f64("thrust_n", 0, "N", "total thrust along body -z that the model expects"),
    _f64("thrust_norm", 0, "1", "the same as normalised collective thrust, 0..1"),
    _f64("rate_frd_radps", 3, "rad/s", "body rates"),
)

_TICK_FIELDS = (
    Field("vehicle_us", "int64", 0, "us", "the tick's time by the vehicle's clock, since its boot", "t_us"),
    _measured("pos_ned_m", 3, "m", "measured position, predicted to the tick"),
    _measured("vel_ned_mps", 3, "m/s", "measured velocity, predicted to the tick"),
    _measured("q_ned_frd", 4, "1", "measured attitude (w, x, y, z), body to world"),
    _measured("rate_frd_radps", 3, "rad/s", "measured body rates"),
    _measured("specific_force_frd_mps2", 3, "m/s^2", "measured specific force"),
    _measured("motor_command", 4, "1", "motor commands last reported, NaN if not"),
    Field("position_age_us", "int64", 0, "us", "age of the position sample", "measurement.position_age_us"),
    Field("attitude_age_us", "int64", 0, "us", "age of the attitude sample", "measurement.attitude_age_us"),
    Field("imu_age_us", "int64", 0, "us", "age of the IMU sample", "measurement.imu_age_us"),
    Field("thrust_saturated", "bool", 0, "", "whether thrust was limited"),
    _f64("latency_s", 0, "s", "delay of commands that the learner goes by, NaN where nothing learns"),
    Field("digest", "int64", 0, "", "CRC-32 of all that the stack said at this tick, logged or not"),
    Field("guard", "string", 0, "", "what the guard did instead of the command; empty if nothing"),
)

_CONTROL_FIELDS = (
    _proposed("nominal_acc_ned_mps2", 3, "m/s^2", "nominal acceleration that the command realises"),
    _proposed("nominal_jerk_ned_mps3", 3, "m/s^3", "nominal jerk that the command realises"),
    _proposed("thrust_ff_n", 0, "N", "feed-forward part of the thrust"),
    _proposed("thrust_fb_n", 0, "N", "feedback part of the thrust"),
    _proposed("rate_ff_frd_radps", 3, "rad/s", "feed-forward part of the body rates"),
    _proposed("rate_fb_frd_radps", 3, "rad/s", "feedback part of the body rates"),
    _proposed("attitude_error_rad", 3, "rad", "rotation vector from the measured to the wanted attitude"),
)

_LEARNER_FIELDS = (
    _f32("acc_ned_mps2", 3, "m/s^2", "unexplained acceleration that is fed forward at the reference"),
    _f32("jerk_ned_mps3", 3, "m/s^3", "its time derivative along the reference"),
    _f32("thrust_gain", 0, "1", "delivered over believed thrust per mass"),
    _f32("thrust_gain_sigma", 0, "1", "its standard deviation"),
    _f32("confidence", 0, "1", "1 where the bound is nothing, 0 from 0.1 g on"),
    _f32("stage", 0, "1", "0 nothing, 1 calculable, 2 valid, 3 used, 4 used but frozen"),
    _f32("residual_frd_mps2", 3, "m/s^2", "expected unexplained specific force at the measured state"),
    _f32("sigma_frd_mps2", 3, "m/s^2", "its calibrated standard deviation"),
    _f32("target_frd_mps2", 3, "m/s^2", "unexplained specific force as measured, NaN without a sample"),
    _f32("rate_residual_frd_radps", 3, "rad/s", "expected body rates less those of the rate loop's model"),
    _f32("rate_sigma_frd_radps", 3, "rad/s", "its standard deviation"),
    _f32("applied_thrust_n", 0, "N", "thrust that acted by the model, after latency and lag"),
    _f32("latency_s", 0, "s", "from sending a command to its first effect, NaN until it is evident"),
    _f32("points", 0, "1", "points held"),
    _f32("fed", 0, "1", "samples taken so far"),
    _f32("refused", 0, "1", "samples refused so far"),
    _f32("changes", 0, "1", "sudden changes noticed so far"),
    _f32("surprise", 0, "1", "largest recent error of prediction, in its own standard deviations"),
)

_FILTER_FIELDS = (
    _f32("h", 0, "1", "least barrier value of the predicted state, at least 0 inside the certified region"),
    _f32("h_state", 0, "1", "the same at the measured position and velocity"),
    _f32("status", 0, "1", "0 nothing certified, 1 not engaged, 2 passed, 3 changed, 4 to 6 fallback (FILTER_STATUS)"),
    _f32("margin_ps", 0, "1/s", "least margin of the barrier condition at the acceleration that is sent"),
    _f32("iterations", 0, "1", "iterations of the quadratic program's solver"),
    _f32("residual", 0, "m/s^2", "largest violation of a row of the quadratic program by its solution"),
    _f32("version", 0, "1", "version of the certificate"),
    _f32("intervened", 0, "1", "1 where the command was changed"),
    _f32("wanted_acc_ned_mps2", 3, "m/s^2", "acceleration that the controller's command steers towards"),
    _f32("safe_acc_ned_mps2", 3, "m/s^2", "acceleration that the sent command steers towards"),
    _f32("low_ned_mps2", 3, "m/s^2", "least acceleration that the barriers allow"),
    _f32("high_ned_mps2", 3, "m/s^2", "greatest acceleration that the barriers allow"),
    _f32("margins_ned_ps", 3, "1/s", "margin of each axis' condition at its best command"),
    _f32("error_ned_m", 3, "m", "predicted distance from the region's centre"),
    _f32("rate_ned_mps", 3, "m/s", "its rate"),
    _f32("bound_ned_mps2", 3, "m/s^2", "how far the acceleration may be off, as the certificate says"),
    _f32("wanted_thrust_n", 0, "N", "thrust asked for before filtering"),
    _f32("premise", 0, "1", "number of the certificate's premise that is broken, 0 none (docs/barrier.md)"),
    _f32("ended_by", 0, "1", "number of the premise whose breach ended the certificate, 0 none"),
)

FILTER_STATUS = ("nothing certified", "not engaged", "passed", "changed", "infeasible", "not solved", "falsified")
"""Status of the barrier filter, by number; from `infeasible` on its fallback acts."""

_TRUTH_FIELDS = (
    _f64("pos_ned_m", 3, "m", "true position"),
    _f32("vel_ned_mps", 3, "m/s", "true velocity"),
    _f32("q_ned_frd", 4, "1", "true attitude (w, x, y, z), body to world"),
    _f32("rate_frd_radps", 3, "rad/s", "true body rates"),
    _f32("specific_force_frd_mps2", 3, "m/s^2", "true specific force"),
    _f32("angular_acceleration_frd_radps2", 3, "rad/s^2", "true angular acceleration"),
    _f32("motor_u", 4, "1", "motor state after lag, as a normalised command"),
    _f32("rotor_thrust_n", 4, "N", "thrust of each rotor"),
    _f32("wind_ned_mps", 3, "m/s", "velocity of the air over ground"),
    _f32("battery_v", 0, "V", "battery voltage"),
    Field("on_ground", "bool", 0, "", "whether the vehicle touches the ground"),
)

_LOG_FIELDS = (
    Field("level", "string", 0, "", "debug, info, warning, error or fatal"),
    Field("name", "string", 0, "", "what kind of event; for /vehicle/statustext MAVLink's severity"),
    Field("text", "string", 0, "", "what happened, in words"),
)

_VEHICLE_TOPICS = (
    Topic(
        "/vehicle/attitude",
        Kind.TABLE,
        "flightstack.Attitude",
        200.0,
        "ATTITUDE_QUATERNION",
        "attitude and body rates as the vehicle reports them",
        (
            _sample_time("t_boot_us"),
            _f32("q_ned_frd", 4, "1", "attitude (w, x, y, z), body to world"),
            _f32("rate_frd_radps", 3, "rad/s", "body rates"),
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
            _sample_time("t_boot_us"),
            _f32("pos_ned_m", 3, "m", "position"),
            _f32("vel_ned_mps", 3, "m/s", "velocity"),
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
            _sample_time("t_us"),
            _f32("accel_frd_mps2", 3, "m/s^2", "specific force"),
            _f32("rate_frd_radps", 3, "rad/s", "body rates"),
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
            _sample_time("t_us"),
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
            _f32("voltage_v", 0, "V", "voltage, NaN if not known"),
            _f32("current_a", 0, "A", "current, NaN if not known"),
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
    Topic("/vehicle/statustext", Kind.LOG, "foxglove.Log", 0.0, "STATUSTEXT", "what the vehicle says", _LOG_FIELDS),
)

_STACK_TOPICS = (
    Topic(
        "/truth",
        Kind.TABLE,
        "flightstack.Truth",
        25.0,
        "simulator",
        "the TRUTH, from the simulator; no controller ever sees it",
        _TRUTH_FIELDS,
    ),
    Topic(
        "/setpoint",
        Kind.TABLE,
        "flightstack.Setpoint",
        25.0,
        "companion",
        "the scenario's reference at this tick",
        _REFERENCE_FIELDS,
    ),
    Topic(
        "/command",
        Kind.TABLE,
        "flightstack.Command",
        250.0,
        "companion",
        "what was sent to the vehicle",
        _COMMAND_FIELDS,
    ),
    Topic(
        "/tick",
        Kind.TABLE,
        "flightstack.Tick",
        250.0,
        "companion",
        "why the command is what it is: the stack's record of this tick",
        _TICK_FIELDS,
    ),
    Topic(
        "/control",
        Kind.TABLE,
        "flightstack.Control",
        25.0,
        "companion",
        "the controller's parts of the command",
        _CONTROL_FIELDS,
    ),
    Topic(
        "/learner",
        Kind.TABLE,
        "flightstack.Learner",
        25.0,
        "companion",
        "what the learner knows at this tick; absent where nothing learns",
        _LEARNER_FIELDS,
    ),
    Topic(
        "/estimate",
        Kind.TABLE,
        "flightstack.Estimate",
        25.0,
        "companion",
        "how far the vehicle's velocity is from the derivative of its own position, and what of that is used",
        (
            _f32("disagreement_ned_mps", 3, "m/s", "c: d(position)/dt less velocity, observed"),
            _f32("rms_ned_mps", 3, "m/s", "root mean square of c over 15 s: the estimator's health"),
            _f32("weight", 3, "1", "share of c that is added to the velocity"),
        ),
    ),
    Topic(
        "/filter",
        Kind.TABLE,
        "flightstack.Filter",
        25.0,
        "companion",
        "what the barrier filter did with the command, and by what margins; absent where nothing filters",
        _FILTER_FIELDS,
    ),
    Topic(
        "/events",
        Kind.LOG,
        "foxglove.Log",
        0.0,
        "companion",
        "state and mode changes, phases of the flight, timed effects",
        _LOG_FIELDS,
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
            _f32("lateness_us", 0, "us", "start of the tick after its deadline"),
            _f32("tick_us", 0, "us", "time that the tick took"),
            Field("missed", "int32", 0, "1", "deadlines missed so far"),
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
