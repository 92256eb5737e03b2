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
from mavlink_bridge.events import hil

_U16 = 0xFFFF
_SETPOINT_NAN = "vel_ned_mps acc_ned_mps2 yaw_rad yaw_rate_radps"
_LOCAL_NAN, _GLOBAL_NAN = f"pos_ned_m {_SETPOINT_NAN}", f"alt_m {_SETPOINT_NAN}"
_FIX: dict[str, Any] = {
    "hdop": wire("eph", per=100.0, unknown=_U16),
    "vdop": wire("epv", per=100.0, unknown=_U16),
    "speed_mps": wire("vel", per=100.0, unknown=_U16),
    "course_deg": wire("cog", per=100.0, unknown=_U16),
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
    row(ev.SystemTime, rate_hz=1.0, unix_us="time_unix_usec"),
    row(ev.LinkNodeStatus, rate_hz=1.0, t_boot_us="timestamp"),  # MAVLink says milliseconds, PX4 sends microseconds
    row(ev.GpsRawInt, rate_hz=8.0, **_FIX),
    row(ev.ScaledPressure, rate_hz=1.0),
    row(ev.Attitude, rate_hz=100.0),
    row(ev.AttitudeQuaternion, rate_hz=50.0),
    row(ev.LocalPositionNed, rate_hz=30.0),
    row(ev.GlobalPositionInt, rate_hz=50.0, heading_deg=wire("hdg", per=100.0, unknown=_U16)),
    row(ev.ServoOutputRaw, rate_hz=10.0, pwm_us=" ".join(f"servo{i}_raw" for i in range(1, 17))),
    row(ev.ActuatorOutputStatus, outputs="actuator"),
    row(ev.VfrHud, rate_hz=10.0, nan="airspeed_mps"),
    row(
        ev.HighresImu,
        rate_hz=50.0,
        nan="mag_frd_gauss abs_pressure_hpa diff_pressure_hpa pressure_alt_m temperature_degc",
    ),
    row(ev.ScaledImu),
    row(ev.HilStateQuaternion, indicated_airspeed_mps=wire("ind_airspeed", per=100.0)),
    row(
        ev.DistanceSensor,
        rate_hz=10.0,
        distance_m=wire("current_distance", per=100.0),
        q_frd_sensor="quaternion",
        nan="horizontal_fov_rad vertical_fov_rad q_frd_sensor",
    ),
    row(
        ev.Altitude,
        rate_hz=10.0,
        monotonic_m="altitude_monotonic",
        amsl_m="altitude_amsl",
        local_m="altitude_local",
        relative_m="altitude_relative",
        terrain_m="altitude_terrain",
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
    ),
    row(
        ev.EstimatorStatus,
        rate_hz=1.0,
        nan="vel_ratio pos_horiz_ratio pos_vert_ratio mag_ratio hagl_ratio tas_ratio",
    ),
    row(
        ev.Vibration,
        rate_hz=0.5,
        vibration_frd="vibration_x vibration_y vibration_z",
        clipping="clipping_0 clipping_1 clipping_2",
        nan="vibration_frd",
    ),
    row(
        ev.Odometry,
        rate_hz=30.0,
        vel_mps="vx vy vz",
        nan="pos_ned_m q_ned_frd vel_mps rate_frd_radps pose_covariance velocity_covariance",
    ),
    row(ev.ExtendedSysState, rate_hz=5.0),
    row(ev.TimeEstimateToTarget, rate_hz=0.5),
)

_SETPOINTS: tuple[Row, ...] = (
    row(ev.SetAttitudeTarget, nan="*"),
    row(ev.AttitudeTarget, rate_hz=10.0, nan="*"),
    row(ev.SetPositionTargetLocalNed, nan=_LOCAL_NAN),
    row(ev.PositionTargetLocalNed, rate_hz=10.0, nan=_LOCAL_NAN),
    row(ev.SetPositionTargetGlobalInt, nan=_GLOBAL_NAN),
    row(ev.PositionTargetGlobalInt, nan=_GLOBAL_NAN),
    row(ev.ManualControl, aux="aux1 aux2 aux3 aux4 aux5 aux6"),
)

_PROTOCOLS: tuple[Row, ...] = (
    row(ev.Ping, rate_hz=1.0),
    row(ev.Timesync, rate_hz=10.0),
    row(ev.SetMode),
    row(ev.ParamRequestRead),
    row(ev.ParamRequestList),
    row(ev.ParamValue, bits="param_value"),
    row(ev.ParamSet, bits="param_value"),
    row(ev.ParamError),
    row(ev.CommandLong, nan="params"),
    row(ev.CommandInt, nan="params"),
    row(ev.CommandAck),
    row(ev.MessageInterval),
    row(ev.RequestDataStream),
    row(ev.Statustext),
    row(ev.RadioStatus),
    row(ev.Event),
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
    row(ev.ComponentInformation),
    row(ev.ComponentMetadata),
    row(
        ev.FlightInformation,
        arming_utc_us="arming_time_utc",
        takeoff_utc_us="takeoff_time_utc",
        landing_us=wire("landing_time", times=1000),
    ),
    row(
        ev.HomePosition,
        rate_hz=0.5,
        approach_ned_m="approach_x approach_y approach_z",
        nan="pos_ned_m q_ned_frd approach_ned_m",
    ),
    row(ev.GpsGlobalOrigin),
    row(ev.SetGpsGlobalOrigin),
    row(ev.MissionCurrent, rate_hz=1.0),
    row(ev.MissionRequestList),
    row(ev.MissionCount, items="count"),
    row(ev.MissionClearAll),
    row(ev.MissionAck),
    row(ev.MissionRequestInt),
    row(ev.MissionRequest),
    row(ev.MissionSetCurrent),
    row(ev.MissionItemInt, nan="params"),
    row(ev.MissionItem, nan="params"),
    row(ev.MissionItemReached),
    row(ev.FileTransferProtocol),
    row(
        ev.OpenDroneIdLocation,
        rate_hz=1.0,
        direction_deg=wire("direction", per=100.0, unknown=36100),
        speed_horizontal_mps=wire("speed_horizontal", per=100.0, unknown=25500),
        speed_vertical_mps=wire("speed_vertical", per=100.0, unknown=6300),
        alt_barometric_m="altitude_barometric",
        alt_geodetic_m="altitude_geodetic",
        nan="alt_barometric_m alt_geodetic_m height_m timestamp_s",
    ),
    row(
        ev.OpenDroneIdSystem,
        rate_hz=1.0,
        operator_lat_deg=wire("operator_latitude", per=1e7),
        operator_lon_deg=wire("operator_longitude", per=1e7),
        operator_alt_geo_m="operator_altitude_geo",
        nan="area_ceiling_m area_floor_m operator_alt_geo_m",
    ),
)

_HIL: tuple[Row, ...] = (
    row(hil.HilSensor),
    row(
        hil.HilGps,
        **_FIX,
        vel_north_mps=wire("vn", per=100.0),
        vel_east_mps=wire("ve", per=100.0),
        vel_down_mps=wire("vd", per=100.0),
    ),
    row(hil.HilActuatorControls, nan="controls"),
)
"""For the physics behind a PX4."""

MESSAGES: tuple[Row, ...] = _TELEMETRY + _SETPOINTS + _PROTOCOLS + _INFORMATION + _HIL
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
