"""The fields of the log's TABLE topics: name, type, size, unit and meaning of each (`topics` has the topics)."""

from __future__ import annotations

from dataclasses import dataclass


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


def _f64(name: str, size: int, unit: str, text: str, path: str = "") -> Field:
    return Field(name, "double", size, unit, text, path)


def f32(name: str, size: int, unit: str, text: str, path: str = "") -> Field:
    """A number, or `size` of them, in single precision."""
    return Field(name, "float", size, unit, text, path)


def _measured(name: str, size: int, unit: str, text: str) -> Field:
    return _f64(name, size, unit, text, f"measurement.{name}")


def _proposed(name: str, size: int, unit: str, text: str) -> Field:
    return f32(name, size, unit, text, f"proposal.{name}")


def sample_time(name: str) -> Field:
    """A stamp of the vehicle."""
    return Field(name, "int64", 0, "us", "sample time by the vehicle's clock, since its boot")


REFERENCE_FIELDS = (
    _f64("pos_ned_m", 3, "m", "position"),
    f32("vel_ned_mps", 3, "m/s", "velocity"),
    f32("acc_ned_mps2", 3, "m/s^2", "acceleration"),
    f32("jerk_ned_mps3", 3, "m/s^3", "jerk"),
    f32("snap_ned_mps4", 3, "m/s^4", "snap"),
    f32("yaw_rad", 0, "rad", "heading"),
    f32("yaw_rate_radps", 0, "rad/s", "rate of the heading"),
)

COMMAND_FIELDS = (
    _f64("thrust_n", 0, "N", "total thrust along body -z that the model expects"),
    _f64("thrust_norm", 0, "1", "the same as normalised collective thrust, 0..1"),
    _f64("rate_frd_radps", 3, "rad/s", "body rates"),
)

TICK_FIELDS = (
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
    _f64("delay_s", 0, "s", "delay of commands that the learner goes by, NaN where nothing learns"),
    Field("digest", "int64", 0, "", "CRC-32 of all that the stack said at this tick, logged or not"),
    Field("guard", "string", 0, "", "what the guard did instead of the command; empty if nothing"),
)

CONTROL_FIELDS = (
    _proposed("nominal_acc_ned_mps2", 3, "m/s^2", "nominal acceleration that the command realises"),
    _proposed("nominal_jerk_ned_mps3", 3, "m/s^3", "nominal jerk that the command realises"),
    _proposed("thrust_ff_n", 0, "N", "feed-forward part of the thrust"),
    _proposed("thrust_fb_n", 0, "N", "feedback part of the thrust"),
    _proposed("rate_ff_frd_radps", 3, "rad/s", "feed-forward part of the body rates"),
    _proposed("rate_fb_frd_radps", 3, "rad/s", "feedback part of the body rates"),
    _proposed("attitude_error_rad", 3, "rad", "rotation vector from the measured to the wanted attitude"),
)

LEARNER_FIELDS = (
    f32("acc_ned_mps2", 3, "m/s^2", "unexplained acceleration that is fed forward at the reference"),
    f32("jerk_ned_mps3", 3, "m/s^3", "its time derivative along the reference"),
    f32("thrust_gain", 0, "1", "delivered over believed thrust per mass"),
    f32("thrust_gain_sigma", 0, "1", "its standard deviation"),
    f32("confidence", 0, "1", "1 where the bound is nothing, 0 from 0.1 g on"),
    f32("stage", 0, "1", "0 nothing, 1 calculable, 2 valid, 3 used, 4 used but frozen"),
    f32("residual_frd_mps2", 3, "m/s^2", "expected unexplained specific force at the measured state"),
    f32("sigma_frd_mps2", 3, "m/s^2", "its calibrated standard deviation"),
    f32("target_frd_mps2", 3, "m/s^2", "unexplained specific force as measured, NaN without a sample"),
    f32("rate_residual_frd_radps", 3, "rad/s", "expected body rates less those of the rate loop's model"),
    f32("rate_sigma_frd_radps", 3, "rad/s", "its standard deviation"),
    f32("applied_thrust_n", 0, "N", "thrust that acted by the model, after latency and lag"),
    f32("latency_s", 0, "s", "from sending a command to its first effect, NaN until it is evident"),
    f32("points", 0, "1", "points held"),
    f32("fed", 0, "1", "samples taken so far"),
    f32("refused", 0, "1", "samples refused so far"),
    f32("changes", 0, "1", "sudden changes noticed so far"),
    f32("surprise", 0, "1", "largest recent error of prediction, in its own standard deviations"),
)

FILTER_FIELDS = (
    f32("h", 0, "1", "least barrier value of the predicted state, at least 0 inside the certified region"),
    f32("h_state", 0, "1", "the same at the measured position and velocity"),
    f32("status", 0, "1", "0 nothing certified, 1 not engaged, 2 passed, 3 changed, 4 to 6 fallback (FILTER_STATUS)"),
    f32("margin_ps", 0, "1/s", "least margin of the barrier condition at the acceleration that is sent"),
    f32("iterations", 0, "1", "iterations of the quadratic program's solver"),
    f32("residual", 0, "m/s^2", "largest violation of a row of the quadratic program by its solution"),
    f32("version", 0, "1", "version of the certificate"),
    f32("intervened", 0, "1", "1 where the command was changed"),
    f32("wanted_acc_ned_mps2", 3, "m/s^2", "acceleration that the controller's command steers towards"),
    f32("safe_acc_ned_mps2", 3, "m/s^2", "acceleration that the sent command steers towards"),
    f32("low_ned_mps2", 3, "m/s^2", "least acceleration that the barriers allow"),
    f32("high_ned_mps2", 3, "m/s^2", "greatest acceleration that the barriers allow"),
    f32("margins_ned_ps", 3, "1/s", "margin of each axis' condition at its best command"),
    f32("error_ned_m", 3, "m", "predicted distance from the region's centre"),
    f32("rate_ned_mps", 3, "m/s", "its rate"),
    f32("bound_ned_mps2", 3, "m/s^2", "how far the acceleration may be off, as the certificate says"),
    f32("wanted_thrust_n", 0, "N", "thrust asked for before filtering"),
    f32("premise", 0, "1", "number of the certificate's premise that is broken, 0 none (docs/barrier.md)"),
    f32("ended_by", 0, "1", "number of the premise whose breach ended the certificate, 0 none"),
)


TRUTH_FIELDS = (
    _f64("pos_ned_m", 3, "m", "true position"),
    f32("vel_ned_mps", 3, "m/s", "true velocity"),
    f32("q_ned_frd", 4, "1", "true attitude (w, x, y, z), body to world"),
    f32("rate_frd_radps", 3, "rad/s", "true body rates"),
    f32("specific_force_frd_mps2", 3, "m/s^2", "true specific force"),
    f32("angular_acceleration_frd_radps2", 3, "rad/s^2", "true angular acceleration"),
    f32("motor_u", 4, "1", "motor state after lag, as a normalised command"),
    f32("rotor_thrust_n", 4, "N", "thrust of each rotor"),
    f32("wind_ned_mps", 3, "m/s", "velocity of the air over ground"),
    f32("battery_v", 0, "V", "battery voltage"),
    Field("on_ground", "bool", 0, "", "whether the vehicle touches the ground"),
)

LOG_FIELDS = (
    Field("level", "string", 0, "", "debug, info, warning, error or fatal"),
    Field("name", "string", 0, "", "what kind of event; for /vehicle/statustext MAVLink's severity"),
    Field("text", "string", 0, "", "what happened, in words"),
)
