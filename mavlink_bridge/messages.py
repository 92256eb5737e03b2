"""Every MAVLink message the project speaks: one table, a row per message, and all event classes by name.

A row joins an event (a NamedTuple in SI units) to its wire layout; `codec.row` explains the columns.
To add a message: a NamedTuple in `events`, a row here; tests walk the table.
`rate_hz` is the default rate on PX4's onboard link, measured.
"""

from __future__ import annotations

from typing import Any

from mavlink_bridge import events as ev
from mavlink_bridge.codec import Row, row, wire
from mavlink_bridge.events import *  # noqa: F403
from mavlink_bridge.hil_rows import HIL_ROWS

_T_BOOT = wire("time_boot_ms", times=1000)
_Q = wire("q1 q2 q3 q4")
_RATES = wire("rollspeed pitchspeed yawspeed")
_BODY_RATES = wire("body_roll_rate body_pitch_rate body_yaw_rate")
_XYZ = wire("x y z")
_VEL = wire("vx vy vz")
_VEL_CM = wire("vx vy vz", per=100.0)
_ACC = wire("afx afy afz")
_U16 = 0xFFFF
_G = 1000.0 / 9.80665  # mG: flightstack.types has the constant, but would import numpy here
_CMD = wire("param1 param2 param3 param4 x y z")


def _degrees(name: str) -> Any:
    return wire(name, per=1e7)


_ORIGIN: dict[str, Any] = {"lat_deg": _degrees("latitude"), "lon_deg": _degrees("longitude")}
_ORIGIN |= {"alt_msl_m": wire("altitude", per=1000.0), "t_us": "time_usec"}
_SETPOINT: dict[str, Any] = {
    "t_boot_us": _T_BOOT,
    "frame": "coordinate_frame",
    "vel_ned_mps": _VEL,
    "acc_ned_mps2": _ACC,
}
_SETPOINT |= {"yaw_rad": "yaw", "yaw_rate_radps": "yaw_rate"}
_SETPOINT_NAN = "vel_ned_mps acc_ned_mps2 yaw_rad yaw_rate_radps"
_LOCAL: dict[str, Any] = {"pos_ned_m": _XYZ, "nan": "pos_ned_m " + _SETPOINT_NAN}
_GLOBAL: dict[str, Any] = {
    "lat_deg": _degrees("lat_int"),
    "lon_deg": _degrees("lon_int"),
    "alt_m": "alt",
    "nan": "alt_m " + _SETPOINT_NAN,
}

_TELEMETRY: tuple[Row, ...] = (
    row(ev.Heartbeat, rate_hz=1.0, fixed={"mavlink_version": 3}),
    row(
        ev.SysStatus,
        rate_hz=5.0,
        present="onboard_control_sensors_present",
        enabled="onboard_control_sensors_enabled",
        health="onboard_control_sensors_health",
        voltage_v=wire("voltage_battery", per=1000.0, unknown=_U16),
        current_a=wire("current_battery", per=100.0, unknown=-1),
        remaining="battery_remaining",
        errors_count="errors_count1 errors_count2 errors_count3 errors_count4",
        present_extended="onboard_control_sensors_present_extended",
        enabled_extended="onboard_control_sensors_enabled_extended",
        health_extended="onboard_control_sensors_health_extended",
    ),
    row(ev.SystemTime, rate_hz=1.0, unix_us="time_unix_usec", t_boot_us=_T_BOOT),
    row(
        ev.LinkNodeStatus,
        rate_hz=1.0,
        t_boot_us="timestamp",  # MAVLink says milliseconds, PX4 sends microseconds
    ),
    row(
        ev.GpsRawInt,
        rate_hz=8.0,
        t_us="time_usec",
        lat_deg=_degrees("lat"),
        lon_deg=_degrees("lon"),
        alt_msl_m=wire("alt", per=1000.0),
        hdop=wire("eph", per=100.0, unknown=_U16),
        vdop=wire("epv", per=100.0, unknown=_U16),
        speed_mps=wire("vel", per=100.0, unknown=_U16),
        course_deg=wire("cog", per=100.0, unknown=_U16),
        alt_ellipsoid_m=wire("alt_ellipsoid", per=1000.0),
        h_acc_m=wire("h_acc", per=1000.0),
        v_acc_m=wire("v_acc", per=1000.0),
        vel_acc_mps=wire("vel_acc", per=1000.0),
        hdg_acc_deg=wire("hdg_acc", per=1e5),
    ),
    row(
        ev.ScaledPressure,
        rate_hz=1.0,
        t_boot_us=_T_BOOT,
        press_abs_hpa="press_abs",
        press_diff_hpa="press_diff",
        temperature_degc=wire("temperature", per=100.0),
        temperature_press_diff_degc=wire("temperature_press_diff", per=100.0),
    ),
    row(
        ev.Attitude,
        rate_hz=100.0,
        t_boot_us=_T_BOOT,
        roll_rad="roll",
        pitch_rad="pitch",
        yaw_rad="yaw",
        rate_frd_radps=_RATES,
    ),
    row(ev.AttitudeQuaternion, rate_hz=50.0, t_boot_us=_T_BOOT, q_ned_frd=_Q, rate_frd_radps=_RATES),
    row(ev.LocalPositionNed, rate_hz=30.0, t_boot_us=_T_BOOT, pos_ned_m=_XYZ, vel_ned_mps=_VEL),
    row(
        ev.GlobalPositionInt,
        rate_hz=50.0,
        t_boot_us=_T_BOOT,
        lat_deg=_degrees("lat"),
        lon_deg=_degrees("lon"),
        alt_msl_m=wire("alt", per=1000.0),
        relative_alt_m=wire("relative_alt", per=1000.0),
        vel_ned_mps=_VEL_CM,
        heading_deg=wire("hdg", per=100.0, unknown=_U16),
    ),
    row(ev.ServoOutputRaw, rate_hz=10.0, t_us="time_usec", pwm_us=" ".join(f"servo{i}_raw" for i in range(1, 17))),
    row(ev.ActuatorOutputStatus, t_us="time_usec", outputs="actuator"),
    row(
        ev.VfrHud,
        rate_hz=10.0,
        airspeed_mps="airspeed",
        groundspeed_mps="groundspeed",
        heading_deg="heading",
        alt_msl_m="alt",
        climb_mps="climb",
        nan="airspeed_mps",
    ),
    row(
        ev.HighresImu,
        rate_hz=50.0,
        t_us="time_usec",
        accel_frd_mps2="xacc yacc zacc",
        rate_frd_radps="xgyro ygyro zgyro",
        mag_frd_gauss="xmag ymag zmag",
        abs_pressure_hpa="abs_pressure",
        diff_pressure_hpa="diff_pressure",
        pressure_alt_m="pressure_alt",
        temperature_degc="temperature",
        nan="mag_frd_gauss abs_pressure_hpa diff_pressure_hpa pressure_alt_m temperature_degc",
    ),
    row(
        ev.ScaledImu,
        t_boot_us=_T_BOOT,
        accel_frd_mps2=wire("xacc yacc zacc", per=_G),
        rate_frd_radps=wire("xgyro ygyro zgyro", per=1000.0),
        mag_frd_gauss=wire("xmag ymag zmag", per=1000.0),
        temperature_degc=wire("temperature", per=100.0),
    ),
    row(
        ev.HilStateQuaternion,
        t_us="time_usec",
        q_ned_frd="attitude_quaternion",
        rate_frd_radps=_RATES,
        lat_deg=_degrees("lat"),
        lon_deg=_degrees("lon"),
        alt_msl_m=wire("alt", per=1000.0),
        vel_ned_mps=_VEL_CM,
        indicated_airspeed_mps=wire("ind_airspeed", per=100.0),
        true_airspeed_mps=wire("true_airspeed", per=100.0),
        accel_frd_mps2=wire("xacc yacc zacc", per=_G),
    ),
    row(
        ev.DistanceSensor,
        rate_hz=10.0,
        t_boot_us=_T_BOOT,
        min_distance_m=wire("min_distance", per=100.0),
        max_distance_m=wire("max_distance", per=100.0),
        distance_m=wire("current_distance", per=100.0),
        horizontal_fov_rad="horizontal_fov",
        vertical_fov_rad="vertical_fov",
        q_frd_sensor="quaternion",
        nan="horizontal_fov_rad vertical_fov_rad q_frd_sensor",
    ),
    row(
        ev.Altitude,
        rate_hz=10.0,
        t_us="time_usec",
        monotonic_m="altitude_monotonic",
        amsl_m="altitude_amsl",
        local_m="altitude_local",
        relative_m="altitude_relative",
        terrain_m="altitude_terrain",
        bottom_clearance_m="bottom_clearance",
        nan="monotonic_m amsl_m local_m relative_m terrain_m bottom_clearance_m",
    ),
    row(
        ev.BatteryStatus,
        rate_hz=0.5,
        temperature_degc=wire("temperature", per=100.0, unknown=0x7FFF),
        voltages_v=wire("voltages", per=1000.0, unknown=_U16),
        current_a=wire("current_battery", per=100.0, unknown=-1),
        consumed_mah="current_consumed",
        consumed_hj="energy_consumed",
        remaining="battery_remaining",
        time_remaining_s="time_remaining",
        voltages_ext_v=wire("voltages_ext", per=1000.0),
    ),
    row(
        ev.EstimatorStatus,
        rate_hz=1.0,
        t_us="time_usec",
        pos_horiz_accuracy_m="pos_horiz_accuracy",
        pos_vert_accuracy_m="pos_vert_accuracy",
        nan="vel_ratio pos_horiz_ratio pos_vert_ratio mag_ratio hagl_ratio tas_ratio",
    ),
    row(
        ev.Vibration,
        rate_hz=0.5,
        t_us="time_usec",
        vibration_frd="vibration_x vibration_y vibration_z",
        clipping="clipping_0 clipping_1 clipping_2",
        nan="vibration_frd",
    ),
    row(
        ev.Odometry,
        rate_hz=30.0,
        t_us="time_usec",
        pos_ned_m=_XYZ,
        q_ned_frd="q",
        vel_mps=_VEL,
        rate_frd_radps=_RATES,
        nan="pos_ned_m q_ned_frd vel_mps rate_frd_radps pose_covariance velocity_covariance",
    ),
    row(ev.ExtendedSysState, rate_hz=5.0),
    row(
        ev.TimeEstimateToTarget,
        rate_hz=0.5,
        safe_return_s="safe_return",
        land_s="land",
        mission_next_item_s="mission_next_item",
        mission_end_s="mission_end",
        commanded_action_s="commanded_action",
    ),
)

_SETPOINTS: tuple[Row, ...] = (
    row(
        ev.SetAttitudeTarget,
        t_boot_us=_T_BOOT,
        q_ned_frd="q",
        rate_frd_radps=_BODY_RATES,
        thrust_norm="thrust",
        thrust_body_norm="thrust_body",
        nan="*",
    ),
    row(
        ev.AttitudeTarget,
        rate_hz=10.0,
        t_boot_us=_T_BOOT,
        q_ned_frd="q",
        rate_frd_radps=_BODY_RATES,
        thrust_norm="thrust",
        nan="*",
    ),
    row(ev.SetPositionTargetLocalNed, **_SETPOINT, **_LOCAL),
    row(ev.PositionTargetLocalNed, rate_hz=10.0, **_SETPOINT, **_LOCAL),
    row(ev.SetPositionTargetGlobalInt, **_SETPOINT, **_GLOBAL),
    row(ev.PositionTargetGlobalInt, **_SETPOINT, **_GLOBAL),
    row(ev.ManualControl, aux="aux1 aux2 aux3 aux4 aux5 aux6"),
)

_PROTOCOLS: tuple[Row, ...] = (
    row(ev.Ping, rate_hz=1.0, t_us="time_usec"),
    row(ev.Timesync, rate_hz=10.0, tc1_ns="tc1", ts1_ns="ts1"),
    row(ev.SetMode),
    row(ev.ParamRequestRead),
    row(ev.ParamRequestList),
    row(ev.ParamValue, bits="param_value"),
    row(ev.ParamSet, bits="param_value"),
    row(ev.ParamError),
    row(ev.CommandLong, params=" ".join(f"param{i}" for i in range(1, 8)), nan="params"),
    row(ev.CommandInt, params=_CMD, nan="params"),
    row(ev.CommandAck),
    row(ev.MessageInterval),
    row(ev.RequestDataStream, req_message_rate_hz="req_message_rate"),
    row(ev.Statustext),
    row(ev.RadioStatus),
    row(ev.Event, t_boot_us=wire("event_time_boot_ms", times=1000)),
    row(ev.CurrentEventSequence, rate_hz=1.0 / 3.0),
    row(ev.RequestEvent),
    row(ev.ResponseEventError),
)

_INFORMATION: tuple[Row, ...] = (
    row(ev.CurrentMode, rate_hz=0.5),
    row(ev.AvailableModes),
    row(ev.AvailableModesMonitor),
    row(ev.AutopilotVersion),
    row(ev.ProtocolVersion),
    row(ev.ComponentInformation, t_boot_us=_T_BOOT),
    row(ev.ComponentMetadata, t_boot_us=_T_BOOT),
    row(
        ev.FlightInformation,
        t_boot_us=_T_BOOT,
        arming_utc_us="arming_time_utc",
        takeoff_utc_us="takeoff_time_utc",
        landing_us=wire("landing_time", times=1000),
    ),
    row(
        ev.HomePosition,
        rate_hz=0.5,
        lat_deg=_degrees("latitude"),
        lon_deg=_degrees("longitude"),
        alt_msl_m=wire("altitude", per=1000.0),
        pos_ned_m=_XYZ,
        q_ned_frd="q",
        approach_ned_m="approach_x approach_y approach_z",
        t_us="time_usec",
        nan="pos_ned_m q_ned_frd approach_ned_m",
    ),
    row(ev.GpsGlobalOrigin, **_ORIGIN),
    row(ev.SetGpsGlobalOrigin, **_ORIGIN),
    row(ev.MissionCurrent, rate_hz=1.0),
    row(ev.MissionRequestList),
    row(ev.MissionCount, items="count"),
    row(ev.MissionClearAll),
    row(ev.MissionAck),
    row(ev.MissionRequestInt),
    row(ev.MissionRequest),
    row(ev.MissionSetCurrent),
    row(ev.MissionItemInt, params=_CMD, nan="params"),
    row(ev.MissionItem, params=_CMD, nan="params"),
    row(ev.MissionItemReached),
    row(ev.FileTransferProtocol),
    row(
        ev.OpenDroneIdLocation,
        rate_hz=1.0,
        direction_deg=wire("direction", per=100.0, unknown=36100),
        speed_horizontal_mps=wire("speed_horizontal", per=100.0, unknown=25500),
        speed_vertical_mps=wire("speed_vertical", per=100.0, unknown=6300),
        lat_deg=_degrees("latitude"),
        lon_deg=_degrees("longitude"),
        alt_barometric_m="altitude_barometric",
        alt_geodetic_m="altitude_geodetic",
        height_m="height",
        timestamp_s="timestamp",
        nan="alt_barometric_m alt_geodetic_m height_m timestamp_s",
    ),
    row(
        ev.OpenDroneIdSystem,
        rate_hz=1.0,
        operator_lat_deg=_degrees("operator_latitude"),
        operator_lon_deg=_degrees("operator_longitude"),
        area_radius_m="area_radius",
        area_ceiling_m="area_ceiling",
        area_floor_m="area_floor",
        operator_alt_geo_m="operator_altitude_geo",
        timestamp_s="timestamp",
        nan="area_ceiling_m area_floor_m operator_alt_geo_m",
    ),
)

MESSAGES: tuple[Row, ...] = _TELEMETRY + _SETPOINTS + _PROTOCOLS + _INFORMATION + HIL_ROWS
"""The table."""

BY_ID: dict[int, Row] = {entry.id: entry for entry in MESSAGES}
BY_EVENT: dict[type[Any], Row] = {entry.event: entry for entry in MESSAGES}


def prepare() -> None:
    """Generate every codec now (some milliseconds) instead of at a message's first use: for real-time loops."""
    for entry in MESSAGES:
        _ = entry.decode, entry.encode


def id_of(event: type[Any]) -> int:
    """MAVLink id of an event class."""
    return BY_EVENT[event].id
