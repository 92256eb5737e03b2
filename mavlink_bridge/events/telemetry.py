"""What a vehicle tells of itself: one NamedTuple per telemetry and setpoint message, in SI units.

Names carry frame and unit; a field without a unit is MAVLink's own (enum values and bit masks are mavlink.io's).
`t_boot_us` and `t_us` count the vehicle's microseconds since boot unless the field says otherwise.
Angles and positions in degrees carry `_deg`.  NaN means "not known" or, in a setpoint, "not set".
Source: MAVLink common.xml.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from flightstack.types import Tuple3, Tuple4

_ZERO3: Tuple3 = (0.0, 0.0, 0.0)
_ZERO4: Tuple4 = (0.0, 0.0, 0.0, 0.0)
_NAN = float("nan")
_NAN3: Tuple3 = (_NAN, _NAN, _NAN)


class Heartbeat(NamedTuple):
    """A system is there, and what it is (1 Hz)."""

    type: int
    autopilot: int
    base_mode: int
    custom_mode: int
    system_status: int


class SysStatus(NamedTuple):
    """Sensors and battery at a glance."""

    present: int
    enabled: int
    health: int
    """MAV_SYS_STATUS_SENSOR bits; bit 28: can arm."""
    load: int
    """Permille."""
    voltage_v: float = _NAN
    current_a: float = _NAN
    remaining: int = -1
    """Percent, -1 unknown."""
    drop_rate_comm: int = 0
    """Hundredths of a percent."""
    errors_comm: int = 0
    errors_count: tuple[int, int, int, int] = (0, 0, 0, 0)
    present_extended: int = 0
    enabled_extended: int = 0
    health_extended: int = 0


class SystemTime(NamedTuple):
    """Wall clock and boot clock."""

    unix_us: int
    t_boot_us: int


class LinkNodeStatus(NamedTuple):
    """The autopilot's own view of the link."""

    t_boot_us: int
    tx_buf: int
    """Percent free."""
    rx_buf: int
    tx_rate: int
    """Bytes per second."""
    rx_rate: int
    rx_parse_err: int = 0
    tx_overflows: int = 0
    rx_overflows: int = 0
    messages_sent: int = 0
    messages_received: int = 0
    messages_lost: int = 0


class GpsRawInt(NamedTuple):
    """A GPS fix as the receiver gave it."""

    t_us: int
    fix_type: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    hdop: float
    vdop: float
    speed_mps: float
    """Over ground."""
    course_deg: float
    satellites_visible: int
    alt_ellipsoid_m: float = 0.0
    h_acc_m: float = 0.0
    v_acc_m: float = 0.0
    vel_acc_mps: float = 0.0
    hdg_acc_deg: float = 0.0
    yaw: int = 0
    """Hundredths of a degree; 0 not known, 36000 north."""


class ScaledPressure(NamedTuple):
    """Barometer."""

    t_boot_us: int
    press_abs_hpa: float
    press_diff_hpa: float
    temperature_degc: float
    temperature_press_diff_degc: float = 0.0


class Attitude(NamedTuple):
    """Attitude as Euler angles (ZYX)."""

    t_boot_us: int
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    rate_frd_radps: Tuple3


class AttitudeQuaternion(NamedTuple):
    """Attitude as a quaternion, body to world.  MAVLink's repr_offset_q (tail-sitters) is left out."""

    t_boot_us: int
    q_ned_frd: Tuple4
    rate_frd_radps: Tuple3


class LocalPositionNed(NamedTuple):
    """Position and velocity from the estimator's origin."""

    t_boot_us: int
    pos_ned_m: Tuple3
    vel_ned_mps: Tuple3


class GlobalPositionInt(NamedTuple):
    """Position on the globe, filtered."""

    t_boot_us: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    relative_alt_m: float
    vel_ned_mps: Tuple3
    heading_deg: float
    """0..359.99, NaN unknown."""


class ServoOutputRaw(NamedTuple):
    """What the motors were really given: 1000 + 1000 u, 900 while disarmed (PX4)."""

    t_us: int
    port: int
    pwm_us: tuple[int, ...]
    """(16,)"""


class VfrHud(NamedTuple):
    """Figures for a pilot's display."""

    airspeed_mps: float
    groundspeed_mps: float
    heading_deg: int
    throttle: int
    """Percent."""
    alt_msl_m: float
    climb_mps: float


class AttitudeTarget(NamedTuple):
    """The attitude setpoint in use; in PX4's rate offboard only the rates are live."""

    t_boot_us: int
    type_mask: int
    q_ned_frd: Tuple4
    rate_frd_radps: Tuple3
    thrust_norm: float


class SetAttitudeTarget(NamedTuple):
    """Attitude or body rates, and thrust, to fly.  type_mask 128: rates and thrust only."""

    t_boot_us: int
    target_system: int
    target_component: int
    type_mask: int
    q_ned_frd: Tuple4
    rate_frd_radps: Tuple3
    thrust_norm: float
    thrust_body_norm: Tuple3 = _ZERO3
    """Used with bit 32 of type_mask only."""


class SetPositionTargetLocalNed(NamedTuple):
    """Position, velocity, acceleration and yaw to fly, from the estimator's origin (frame 1: NED)."""

    t_boot_us: int
    target_system: int
    target_component: int
    frame: int
    type_mask: int
    pos_ned_m: Tuple3
    vel_ned_mps: Tuple3
    acc_ned_mps2: Tuple3 = _NAN3
    yaw_rad: float = _NAN
    yaw_rate_radps: float = _NAN


class PositionTargetLocalNed(NamedTuple):
    """The position setpoint in use."""

    t_boot_us: int
    frame: int
    type_mask: int
    pos_ned_m: Tuple3
    vel_ned_mps: Tuple3
    acc_ned_mps2: Tuple3 = _NAN3
    yaw_rad: float = _NAN
    yaw_rate_radps: float = _NAN


class SetPositionTargetGlobalInt(NamedTuple):
    """The same with the position on the globe."""

    t_boot_us: int
    target_system: int
    target_component: int
    frame: int
    type_mask: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    vel_ned_mps: Tuple3
    acc_ned_mps2: Tuple3 = _NAN3
    yaw_rad: float = _NAN
    yaw_rate_radps: float = _NAN


class PositionTargetGlobalInt(NamedTuple):
    """The position setpoint in use, on the globe."""

    t_boot_us: int
    frame: int
    type_mask: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    vel_ned_mps: Tuple3
    acc_ned_mps2: Tuple3 = _NAN3
    yaw_rad: float = _NAN
    yaw_rate_radps: float = _NAN


class HighresImu(NamedTuple):
    """IMU, magnetometer and barometer."""

    t_us: int
    accel_frd_mps2: Tuple3
    """Specific force."""
    rate_frd_radps: Tuple3
    mag_frd_gauss: Tuple3
    abs_pressure_hpa: float
    diff_pressure_hpa: float
    pressure_alt_m: float
    temperature_degc: float
    fields_updated: int
    id: int = 0


class HilStateQuaternion(NamedTuple):
    """A simulator's true state."""

    t_us: int
    q_ned_frd: Tuple4
    rate_frd_radps: Tuple3
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    vel_ned_mps: Tuple3
    indicated_airspeed_mps: float = 0.0
    true_airspeed_mps: float = 0.0
    accel_frd_mps2: Tuple3 = _ZERO3
    """Thousandths of standard gravity on the wire."""


class DistanceSensor(NamedTuple):
    """A rangefinder."""

    t_boot_us: int
    min_distance_m: float
    max_distance_m: float
    distance_m: float
    type: int
    id: int
    orientation: int
    covariance: int = 255
    """cm^2; 255 unknown."""
    horizontal_fov_rad: float = 0.0
    vertical_fov_rad: float = 0.0
    q_frd_sensor: Tuple4 = _ZERO4
    signal_quality: int = 0
    """Percent; 0 unknown."""


class Altitude(NamedTuple):
    """Altitude by every definition, up positive."""

    t_us: int
    monotonic_m: float
    amsl_m: float
    local_m: float
    relative_m: float
    terrain_m: float
    bottom_clearance_m: float


class BatteryStatus(NamedTuple):
    """A battery."""

    id: int
    battery_function: int
    type: int
    temperature_degc: float
    voltages_v: tuple[float, ...]
    """(10,) cells, NaN for absent ones."""
    current_a: float
    consumed_mah: int = -1
    consumed_hj: int = -1
    """Hectojoule."""
    remaining: int = -1
    """Percent, -1 unknown."""
    time_remaining_s: int = 0
    charge_state: int = 0
    voltages_ext_v: tuple[float, ...] = _ZERO4
    """(4,) cells 11 to 14, 0 for absent ones."""
    mode: int = 0
    fault_bitmask: int = 0


class EstimatorStatus(NamedTuple):
    """How well the estimator does; ratios below 1 are good."""

    t_us: int
    flags: int
    vel_ratio: float
    pos_horiz_ratio: float
    pos_vert_ratio: float
    mag_ratio: float
    hagl_ratio: float
    tas_ratio: float
    pos_horiz_accuracy_m: float
    pos_vert_accuracy_m: float


class Vibration(NamedTuple):
    """Vibration levels and clipped samples of up to three IMUs."""

    t_us: int
    vibration_frd: Tuple3
    clipping: tuple[int, int, int]


class Odometry(NamedTuple):
    """Pose and velocity with covariances.  `vel_mps` is in the frame that `child_frame_id` names (PX4: local NED)."""

    t_us: int
    frame_id: int
    child_frame_id: int
    pos_ned_m: Tuple3
    q_ned_frd: Tuple4
    vel_mps: Tuple3
    rate_frd_radps: Tuple3
    reset_counter: int
    pose_covariance: tuple[float, ...] = (_NAN,) + (0.0,) * 20
    """(21,) upper triangle, rows first; NaN first: unknown."""
    velocity_covariance: tuple[float, ...] = (_NAN,) + (0.0,) * 20
    """(21,)"""
    estimator_type: int = 0
    quality: int = 0
    """Percent; 0 unknown."""


class ExtendedSysState(NamedTuple):
    """landed_state: 1 on the ground, 2 in the air, 3 taking off, 4 landing."""

    vtol_state: int
    landed_state: int


class TimeEstimateToTarget(NamedTuple):
    """Seconds until each target, -1 unknown."""

    safe_return_s: int = -1
    land_s: int = -1
    mission_next_item_s: int = -1
    mission_end_s: int = -1
    commanded_action_s: int = -1
