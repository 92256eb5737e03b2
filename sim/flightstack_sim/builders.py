"""One builder per telemetry message: `View` -> event, or None where PX4 has nothing to send.

Constants are what PX4 1.18 with its internal simulator sends; everything that moves comes from the vehicle.
"""

from __future__ import annotations

import math
from typing import Any, Final

from flightstack_sim.autopilot import modes
from flightstack_sim.autopilot.failsafe import battery_warning
from flightstack_sim.autopilot.requests import ESTIMATE_READY_US
from flightstack_sim.autopilot.setpoint import ControlKind
from flightstack_sim.battery_state import CURRENT_A
from flightstack_sim.plans import FENCE, MISSION, RALLY
from flightstack_sim.sensors import OFF
from flightstack_sim.view import View
from mavlink_bridge import messages as m

NAN: Final = math.nan

_STANDBY, _ACTIVE, _CRITICAL = 3, 4, 5
_UNUSED_SERVOS, _DISARMED_SERVOS, _NO_OUTPUTS = (900,) * 12, (900,) * 16, (0.0,) * 16
_SENSORS_PRESENT, _SENSORS_ENABLED, _SENSORS_HEALTHY = 0x0300402F, 0x0301402F, 0x0320C83F
_PREARM_CHECK, _HEALTH_BITS = 1 << 28, {"Compass": 4, "Baro": 8}
_RANGEFINDER_M, _TERMINATED = 100.0, 8
_NO_ITEMS, _NO_MISSION = 0xFFFF, 1
_GOOD_RATIOS: Final = (0.05, 0.05, 0.05, 0.05, 0.01)
_CAPABILITIES, _VERSION = 0xE8FF, 0x01120040  # 1.18.0 alpha
_UID, _ALIGNED_US, _HOUR_US = 5283920058631409231, 2_500_000, 3_600_000_000
_CELLS_ABSENT: Final = (NAN,) * 9


# --- motion ---


def attitude(view: View) -> m.Attitude:
    """Euler angles of the estimate."""
    w, x, y, z = view.q_ned_frd
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return m.Attitude(view.stamp_us, roll, pitch, view.heading_rad, view.rate_frd_radps)


def attitude_quaternion(view: View) -> m.AttitudeQuaternion:
    """The estimate's attitude and the rate loop's filtered gyro."""
    return m.AttitudeQuaternion(view.stamp_us, view.q_ned_frd, view.rate_frd_radps)


def local_position_ned(view: View) -> m.LocalPositionNed | None:
    """The estimate's position and velocity; None while it has none."""
    if not view.vehicle.sensors.position_valid:
        return None
    return m.LocalPositionNed(view.stamp_us, view.told_pos_ned_m, view.told_vel_ned_mps)


def odometry(view: View) -> m.Odometry:
    """The whole estimate, velocity in NED (child frame 1), as PX4 sends it; NaN for a position that isn't known."""
    pose, velocity = view.covariances
    pos, vel = view.told_pos_ned_m, view.told_vel_ned_mps
    if not view.vehicle.sensors.position_valid:
        pos = vel = (NAN, NAN, NAN)
    return m.Odometry(
        view.stamp_us, 1, 1, pos, view.q_ned_frd, vel, view.rate_frd_radps,
        view.vehicle.sensors.position_resets & 0xFF, pose, velocity,
    )  # fmt: skip


def global_position_int(view: View) -> m.GlobalPositionInt | None:
    """The estimate on the globe; None while it has no position."""
    if not view.vehicle.sensors.position_valid:
        return None
    north, east, down = view.told_pos_ned_m
    lat, lon = view.frame.to_globe(north, east)
    lower_m = down - view.pos_ned_m[2]
    return m.GlobalPositionInt(
        view.stamp_us, lat, lon, view.altitude_amsl_m - lower_m, view.relative_alt_m - lower_m, view.told_vel_ned_mps,
        view.heading_deg,
    )  # fmt: skip


def highres_imu(view: View) -> m.HighresImu:
    """Means over the last 4 ms of gyro and accelerometer, air data at their own pace."""
    sensors = view.vehicle.sensors
    view.sample_air()
    means = tuple(sensors.mean_imu.tolist())
    return m.HighresImu(
        view.stamp_us, means[3:6], means[0:3], view.mag_frd_gauss, view.pressure_hpa, 0.0, view.altitude_m,
        sensors.imu_degc, view.fields_updated,
    )  # fmt: skip


def scaled_imu(view: View) -> m.ScaledImu:
    """HIGHRES_IMU's motion in whole numbers, without the filter's correction of biases; sent on request only."""
    sensors = view.vehicle.sensors
    x, y, z = sensors.raw_accel_frd_mps2.tolist()
    gyro = tuple(sensors.mean_imu.tolist())[0:3]
    return m.ScaledImu(view.stamp_us, (x, y, z), gyro, view.mag_frd_gauss, sensors.imu_degc)


def servo_output_raw(view: View) -> m.ServoOutputRaw:
    """What the motors get: 1000 + 1000 u, 900 while disarmed or stopped (no finite thrust)."""
    setpoint = view.setpoint
    if setpoint.kind is ControlKind.OFF or not math.isfinite(setpoint.thrust_norm):
        return m.ServoOutputRaw(view.stamp_us, 0, _DISARMED_SERVOS)
    u1, u2, u3, u4 = view.vehicle.motor_command.tolist()
    pwm = (int(1000.5 + 1000.0 * u1), int(1000.5 + 1000.0 * u2), int(1000.5 + 1000.0 * u3), int(1000.5 + 1000.0 * u4))
    return m.ServoOutputRaw(view.stamp_us, 0, pwm + _UNUSED_SERVOS)


def actuator_output_status(view: View) -> m.ActuatorOutputStatus:
    """The motors' outputs once more; sent on request only."""
    outputs = tuple(float(pwm) for pwm in servo_output_raw(view).pwm_us)
    return m.ActuatorOutputStatus(view.stamp_us, len(outputs), outputs + _NO_OUTPUTS)


def vfr_hud(view: View) -> m.VfrHud:
    """A pilot's display."""
    v_north, v_east, v_down = view.vel_ned_mps
    thrust = view.vehicle.control.thrust_setpoint if view.commander.armed else 0.0
    throttle = round(100.0 * thrust) if math.isfinite(thrust) else 0
    speed = math.hypot(v_north, v_east)
    heading_deg = view.heading_deg  # not finite where the plant's state isn't
    heading = int(heading_deg) if math.isfinite(heading_deg) else 0
    return m.VfrHud(NAN, speed, heading, throttle, view.altitude_amsl_m, -v_down)


def altitude(view: View) -> m.Altitude:
    """Heights; the ground is at home's height."""
    home_m, amsl_m, relative_m = view.home_altitude_m, view.altitude_amsl_m, view.relative_alt_m
    return m.Altitude(
        view.stamp_us, amsl_m, amsl_m, -view.pos_ned_m[2], relative_m, home_m - view.frame.altitude_m, relative_m
    )


def distance_sensor(view: View) -> m.DistanceSensor:
    """A rangefinder that looks down."""
    distance_m = min(max(view.relative_alt_m, 0.0), _RANGEFINDER_M)
    return m.DistanceSensor(view.stamp_us, 0.0, _RANGEFINDER_M, distance_m, 0, 0, 25, 0)


def hil_state_quaternion(view: View) -> m.HilStateQuaternion:
    """The simulator's truth: sent on request only; time and accelerations are 0, as PX4's simulator leaves them."""
    plant = view.vehicle.plant
    north, east, down = plant.pos_ned_m.tolist()
    lat, lon = view.frame.to_globe(north, east)
    w, x, y, z = plant.q_ned_frd.tolist()
    p, q, r = plant.rate_frd_radps.tolist()
    v_north, v_east, v_down = plant.vel_ned_mps.tolist()
    height_m = view.frame.altitude_m - down
    return m.HilStateQuaternion(0, (w, x, y, z), (p, q, r), lat, lon, height_m, (v_north, v_east, v_down))


# --- setpoints ---


def attitude_target(view: View) -> m.AttitudeTarget:
    """The attitude setpoint: stale but for the rates while body rates are flown, as on PX4."""
    t_us, q, thrust = view.attitude_target()
    x, y, z = view.vehicle.rate_setpoint_frd_radps.tolist()
    return m.AttitudeTarget(t_us, 0, q, (x, y, z), thrust)


def _position_target(view: View) -> tuple[int, list[float]]:
    """(type_mask, position + velocity + acceleration + yaw) of the position loop."""
    control = view.vehicle.control
    if not control.armed or view.commander.landed:
        return 0x3F, [NAN, NAN, NAN, NAN, NAN, NAN, 0.0, 0.0, 100.0, view.heading_rad]
    values = control.guidance.position.setpoint.tolist()[:10]
    mask = sum(1 << place for place, value in enumerate(values[:-1]) if math.isnan(value))
    return mask | (0 if math.isfinite(values[-1]) else 0x400), values


def position_target_local_ned(view: View) -> m.PositionTargetLocalNed | None:
    """The position setpoint; None while attitude or rates are flown."""
    if not view.has_position_target:
        return None
    mask, (x, y, z, vx, vy, vz, ax, ay, az, yaw) = _position_target(view)
    return m.PositionTargetLocalNed(view.stamp_us, 1, mask, (x, y, z), (vx, vy, vz), (ax, ay, az), yaw, 0.0)


def position_target_global_int(view: View) -> m.PositionTargetGlobalInt | None:
    """The position setpoint on the globe, in automatic modes."""
    if not view.guided:
        return None
    mask, (x, y, z, vx, vy, vz, ax, ay, az, yaw) = _position_target(view)
    known = math.isfinite(x) and math.isfinite(y)
    lat, lon = view.frame.to_globe(x, y) if known else (0.0, 0.0)
    return m.PositionTargetGlobalInt(
        view.stamp_us, 5, mask, lat, lon, view.frame.altitude_m - z, (vx, vy, vz), (ax, ay, az), yaw, 0.0
    )


# --- state ---


def heartbeat(view: View) -> m.Heartbeat:
    """Mode, arming and whether all is well."""
    commander = view.commander
    mode = commander.mode
    status = 0
    if commander.terminated:
        status = _TERMINATED
    elif commander.armed:
        status = _CRITICAL if commander.in_failsafe else _ACTIVE
    elif view.can_arm:
        status = _STANDBY
    base = modes.base_mode(mode, armed=commander.armed, attitude_controlled=view.attitude_controlled)
    return m.Heartbeat(2, 12, base, mode.custom_mode, status)


def current_mode(view: View) -> m.CurrentMode:
    """The mode that flies and the one intended."""
    commander = view.commander
    return m.CurrentMode(commander.mode.standard_mode, commander.mode.custom_mode, commander.intended.custom_mode)


def extended_sys_state(view: View) -> m.ExtendedSysState:
    """1 on the ground, 2 in the air, 3 taking off (AUTO only), 4 landing."""
    commander = view.commander
    if commander.landed:
        return m.ExtendedSysState(0, 1)
    if commander.mode is modes.TAKEOFF:
        return m.ExtendedSysState(0, 3)
    return m.ExtendedSysState(0, 4 if view.landing else 2)


def sys_status(view: View) -> m.SysStatus:
    """Sensors' health, with the arming checks in bit 28, and the battery."""
    health, battery = _SENSORS_HEALTHY | (_PREARM_CHECK if view.can_arm else 0), view.battery
    for sensor in view.silent():
        health &= ~_HEALTH_BITS[sensor]
    return m.SysStatus(
        _SENSORS_PRESENT, _SENSORS_ENABLED, health, 100, battery.voltage_v, CURRENT_A, round(100.0 * battery.remaining),
        health_extended=1,
    )  # fmt: skip


def battery_status(view: View) -> m.BatteryStatus:
    """One cell slot holds the whole voltage, the current is unknown (-1 A), as PX4's simulator has it."""
    battery = view.battery
    return m.BatteryStatus(
        0, 1, 1, NAN, (battery.voltage_v, *_CELLS_ABSENT), CURRENT_A, remaining=round(100.0 * battery.remaining),
        charge_state=1 + battery_warning(battery.remaining, view.vehicle.params),
    )  # fmt: skip


def estimator_status(view: View) -> m.EstimatorStatus:
    """Flags: 164 while aligning, 229, then 1023 at rest and 895 (no constant position) in flight."""
    sensors, accuracy = view.vehicle.sensors, view.accuracy
    if view.t_us < _ALIGNED_US:
        flags = 164
    elif view.t_us < ESTIMATE_READY_US:
        flags = 229
    else:
        flags = 1023 if view.is_still else 895
    if not sensors.attitude_valid:
        flags &= ~1
    if not sensors.position_valid:
        flags &= ~0x37A
    return m.EstimatorStatus(
        view.stamp_us, flags, *_GOOD_RATIOS, NAN, accuracy.pos_horizontal_std_m, accuracy.pos_vertical_std_m
    )


def home_position(view: View) -> m.HomePosition | None:
    """Where Return goes."""
    home = view.navigator.home_ned_m
    if home is None:
        return None
    lat, lon = view.frame.to_globe(home[0], home[1])
    return m.HomePosition(lat, lon, view.home_altitude_m, home, (1.0, 0.0, 0.0, 0.0), t_us=view.navigator.home_t_us)


def gps_raw_int(view: View) -> m.GpsRawInt | None:
    """The last raw fix."""
    fix = view.vehicle.fix
    if fix is None:
        return None
    view.fixes_reported = view.vehicle.sensors.fix_count
    lat, lon = view.frame.to_globe(fix.pos_ned_m[0], fix.pos_ned_m[1])
    height_m = view.frame.altitude_m - fix.pos_ned_m[2]
    v_north, v_east, _ = fix.vel_ned_mps
    return m.GpsRawInt(
        0, 3, lat, lon, height_m, 0.7, 1.1, math.hypot(v_north, v_east),
        math.degrees(math.atan2(v_east, v_north)) % 360.0, 10, height_m,
        fix.pos_horizontal_std_m, fix.pos_vertical_std_m, fix.vel_std_mps,
    )  # fmt: skip


def scaled_pressure(view: View) -> m.ScaledPressure | None:
    """Barometer."""
    sensors = view.vehicle.sensors
    if sensors.barometer.kind != OFF:
        return m.ScaledPressure(view.stamp_us, sensors.pressure_hpa(), 0.0, sensors.air_degc)
    return None


def vibration(view: View) -> m.Vibration:
    """Not modelled: a quiet vehicle."""
    return m.Vibration(view.stamp_us, (0.0, 0.0, 0.0), (0, 0, 0))


# --- clocks, links, information ---


def timesync(view: View) -> m.Timesync:
    """A question about the other side's clock."""
    return m.Timesync(0, 1000 * view.stamp_us)


def system_time(view: View) -> m.SystemTime:
    """The simulated wall clock."""
    return m.SystemTime(view.unix_at_boot_us + view.stamp_us, view.stamp_us)


def ping(view: View) -> m.Ping:
    """A ping to everybody."""
    view.ping_sequence += 1
    return m.Ping(view.stamp_us, view.ping_sequence - 1, 0, 0)


def mission_current(view: View) -> m.MissionCurrent:
    """The mission's item in force; what is flown of it."""
    plans, navigator = view.plans, view.navigator
    total = len(plans.mission)
    if not total:
        return m.MissionCurrent(0, _NO_ITEMS, _NO_MISSION, navigator.mission_mode)
    ids = plans.ids
    if not view.mission_valid:
        return m.MissionCurrent(plans.current, total, _NO_MISSION, navigator.mission_mode)
    return m.MissionCurrent(
        plans.current, total, navigator.mission_state, navigator.mission_mode, ids[MISSION], ids[FENCE], ids[RALLY]
    )


def current_event_sequence(view: View) -> m.CurrentEventSequence:
    """Number of the last event."""
    return m.CurrentEventSequence(view.event_sequence)


def link_node_status(view: View) -> m.LinkNodeStatus:
    """Not measured: an idle link."""
    return m.LinkNodeStatus(view.stamp_us, 0, 0, 0, 0)


def time_estimate_to_target(view: View) -> m.TimeEstimateToTarget:
    """Nothing is on its way; disarmed the vehicle is back already."""
    return m.TimeEstimateToTarget(safe_return_s=-1 if view.commander.armed else 0)


def open_drone_id_location(view: View) -> m.OpenDroneIdLocation:
    """Remote identification: where the aircraft is."""
    lat, lon = view.frame.to_globe(view.pos_ned_m[0], view.pos_ned_m[1])
    v_north, v_east, v_down = view.vel_ned_mps
    course = math.degrees(math.atan2(v_east, v_north)) % 360.0
    return m.OpenDroneIdLocation(
        0, 0, status=1 if view.commander.landed else 2, direction_deg=course,
        speed_horizontal_mps=math.hypot(v_north, v_east), speed_vertical_mps=-v_down, lat_deg=lat, lon_deg=lon,
        alt_geodetic_m=view.altitude_amsl_m, height_m=view.relative_alt_m,
        timestamp_s=1e-6 * (view.stamp_us % _HOUR_US),
    )  # fmt: skip


def open_drone_id_system(view: View) -> m.OpenDroneIdSystem:
    """Remote identification: the operator stands at home."""
    home = view.navigator.home_ned_m or (0.0, 0.0, 0.0)
    lat, lon = view.frame.to_globe(home[0], home[1])
    return m.OpenDroneIdSystem(
        0, 0, operator_lat_deg=lat, operator_lon_deg=lon, operator_alt_geo_m=view.home_altitude_m
    )


def autopilot_version(view: View) -> m.AutopilotVersion:
    """PX4 1.18 alpha and what it can."""
    return m.AutopilotVersion(_CAPABILITIES, _VERSION, _VERSION, 101854463, 1, uid=_UID + view.sysid - 1)


def protocol_version(view: View) -> m.ProtocolVersion:
    """MAVLink 2."""
    return m.ProtocolVersion(200, 100, 203)


def flight_information(view: View) -> m.FlightInformation:
    """Times of this flight: not kept."""
    return m.FlightInformation(view.stamp_us, 0, 0, 0)


def gps_global_origin(view: View) -> m.GpsGlobalOrigin:
    """Where the local frame begins."""
    frame = view.frame
    return m.GpsGlobalOrigin(frame.latitude_deg, frame.longitude_deg, frame.altitude_m, 0)


def available_modes(view: View) -> tuple[Any, ...]:
    """All modes, one message each; the places for external modes are empty."""
    listed = [(mode.standard_mode, mode.custom_mode, mode.properties, mode.label) for mode in modes.LISTED_MODES]
    listed += [(0, custom_mode, 2, "(Mode not available)") for custom_mode in modes.EXTERNAL_SLOTS]
    return tuple(m.AvailableModes(len(listed), index, *mode) for index, mode in enumerate(listed, 1))
