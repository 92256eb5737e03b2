"""The vehicle's own words under this project's topics, whoever logged them: `/vehicle/attitude`, `/vehicle/imu`, ...

SI units, NED and FRD, quaternions w x y z body to world; times from 0 at the log's first message, sample stamps on the
same line.  What a log lacks is left out; one that never says whether it has landed has while it is disarmed.  Logs of
this project have these topics as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from flightstack.types import F64, I64, STANDARD_GRAVITY_MPS2
from flightstack_logs import ardupilot
from flightstack_logs.readers.csv_file import TABLE as CSV_TABLE
from flightstack_logs.readers.ulog import SAID
from flightstack_logs.tables import Log, Table
from flightstack_logs.topics import TOPICS, severity_names
from flightstack_logs.turn import euler_to_quaternion

_OUTPUTS = 16
_MOST_WHOLE = 1e9
_LOW_US, _SPAN_US = 1000.0, 1000.0
"""Pulse widths of a command of 0, and more at one of 1."""
_ARMED, _IN_AIR = 128, (2, 3, 4)
"""MAV_MODE_FLAG_SAFETY_ARMED; MAV_LANDED_STATE in the air, taking off, landing."""

Found = dict[str, Table]


def with_vehicle_topics(log: Log) -> Log:
    """The log with the standard topics that can be made of it, times from 0; one of this project as it is."""
    make = _KINDS.get(log.kind)
    if make is None:
        return log
    first_us = log.span_us[0]
    tables = {name: replace(table, t_us=table.t_us - first_us) for name, table in log.tables.items()}
    return replace(log, tables={**tables, **make(tables, first_us)})


def _put(found: Found, topic: str, at_us: I64, *columns: np.ndarray) -> None:
    """One standard table, if it has rows: all fields of the topic in their order; what may be missing is NaN."""
    if len(at_us):
        units = {field.name: field.unit for field in TOPICS[topic].fields}
        found[topic] = Table(topic, at_us, dict(zip(units, columns, strict=True)), units)


def _columns(table: Table, *names: str) -> F64:
    """(n, k) of several columns."""
    return np.stack([table[name].astype(np.float64) for name in names], axis=-1)


def _has(table: Table | None, names: Iterable[str], ndim: int = 1) -> bool:
    """Whether a table has rows and all of these columns, numbers of so many dimensions: some logs say their types."""
    if table is None or not len(table):
        return False
    columns = [table.columns.get(name) for name in names]
    return all(column is not None and column.dtype.kind in "biuf" and column.ndim == ndim for column in columns)


def _whole(values: np.ndarray, unknown: int = 0) -> I64:
    """As whole numbers: what is none, or more than any output or share, as `unknown`."""
    known = np.abs(values.astype(np.float64)) < _MOST_WHOLE  # False for NaN
    return np.where(known, values, unknown).astype(np.int64)


def _at(t_us: I64, table: Table, values: F64) -> F64:
    """Rows of `values` at the times, by the latest row of `table` up to each; NaN before the first."""
    entry = np.searchsorted(table.t_us, t_us, side="right") - 1
    out = values[np.maximum(entry, 0)].astype(np.float64)
    out[entry < 0] = np.nan
    return out


def _pulses(command: F64) -> I64:
    """(n, 16) pulse widths of normalised commands (n, k); 0 where there is no output."""
    wide = np.zeros((len(command), _OUTPUTS), np.int64)
    known = np.where(np.isfinite(command), np.clip(command, 0.0, 1.0) * _SPAN_US + _LOW_US, 0.0)
    wide[:, : command.shape[1]] = np.round(known)[:, :_OUTPUTS]
    return wide


def _stamps(table: Table, column: str, times: int) -> I64:
    """The vehicle's stamps on the log's line: the least late message of all is taken for one without delay."""
    boot_us = table[column].astype(np.int64) * times
    return boot_us - int(np.max(boot_us - table.t_us))


# ---------------------------------------------------------------- MAVLink


def _mavlink(tables: Found, first_us: int) -> Found:
    """Of a telemetry log; messages as PX4 and ArduPilot send them."""
    found: Found = {}
    said = ardupilot.parameters(tables)
    quaternion, euler = tables.get("ATTITUDE_QUATERNION"), tables.get("ATTITUDE")
    rates = ("rollspeed", "pitchspeed", "yawspeed")
    if quaternion is not None and _has(quaternion, ("time_boot_ms", "q1", "q2", "q3", "q4", *rates)):
        stamps, q = _stamps(quaternion, "time_boot_ms", 1000), _columns(quaternion, "q1", "q2", "q3", "q4")
        _put(found, "/vehicle/attitude", quaternion.t_us, stamps, q, _columns(quaternion, *rates))
    elif euler is not None and _has(euler, ("time_boot_ms", "roll", "pitch", "yaw", *rates)):
        stamps, angles = _stamps(euler, "time_boot_ms", 1000), _columns(euler, "roll", "pitch", "yaw")
        _put(found, "/vehicle/attitude", euler.t_us, stamps, euler_to_quaternion(angles), _columns(euler, *rates))
    local = tables.get("LOCAL_POSITION_NED")
    if local is not None:
        stamps, place = _stamps(local, "time_boot_ms", 1000), _columns(local, "x", "y", "z")
        _put(found, "/vehicle/local_position", local.t_us, stamps, place, _columns(local, "vx", "vy", "vz"))
    _mavlink_imu(tables, found, ardupilot.board_to_frame(said))
    servo = tables.get("SERVO_OUTPUT_RAW")
    if servo is not None:
        names = [f"servo{i}_raw" for i in range(1, _OUTPUTS + 1) if f"servo{i}_raw" in servo.columns]
        wide = np.zeros((len(servo), _OUTPUTS), np.int64)
        wide[:, : len(names)] = _columns(servo, *names)
        wide = ardupilot.motors_first(said, wide)
        _put(found, "/vehicle/motors", servo.t_us, _stamps(servo, "time_usec", 1), wide)
    power = tables.get("SYS_STATUS")
    if power is not None:
        volts, amperes = power["voltage_battery"].astype(np.float64), power["current_battery"].astype(np.float64)
        volts, amperes = (np.where(good, x, np.nan) for good, x in (
            (volts < 65_535, 1e-3 * volts), (amperes >= 0, 1e-2 * amperes)))  # fmt: skip
        _put(found, "/vehicle/battery", power.t_us, volts, amperes, power["battery_remaining"])
    _mavlink_status(tables, found)
    return found


def _mavlink_imu(tables: Found, found: Found, to_frame: F64) -> None:
    fine, coarse = tables.get("HIGHRES_IMU"), next((t for n in ("RAW_IMU", "SCALED_IMU") if (t := tables.get(n))), None)
    if fine is not None:
        stamps, force = _stamps(fine, "time_usec", 1), _columns(fine, "xacc", "yacc", "zacc")
        _put(found, "/vehicle/imu", fine.t_us, stamps, force, _columns(fine, "xgyro", "ygyro", "zgyro"))
    elif coarse is not None:  # milli-g and mrad/s; RAW_IMU too, as ArduPilot sends it
        stamp, times = ("time_usec", 1) if "time_usec" in coarse.columns else ("time_boot_ms", 1000)
        force = 1e-3 * STANDARD_GRAVITY_MPS2 * _columns(coarse, "xacc", "yacc", "zacc") @ to_frame.T
        rates = 1e-3 * _columns(coarse, "xgyro", "ygyro", "zgyro") @ to_frame.T
        _put(found, "/vehicle/imu", coarse.t_us, _stamps(coarse, stamp, times), force, rates)


def _mavlink_status(tables: Found, found: Found) -> None:
    heart, landed, said = (tables.get(name) for name in ("HEARTBEAT", "EXTENDED_SYS_STATE", "STATUSTEXT"))
    if heart is not None:
        state = np.full(len(heart), np.nan)
        if landed is not None:
            state = _at(heart.t_us, landed, landed["landed_state"])
        modes, armed = np.array([f"{mode:#x}" for mode in heart["custom_mode"]]), (heart["base_mode"] & _ARMED) != 0
        _put(
            found,
            "/vehicle/status",
            heart.t_us,
            modes,
            armed,
            np.where(np.isnan(state), ~armed, ~np.isin(state, _IN_AIR)),
        )
    _put_said(found, said)


def _put_said(found: Found, said: Table | None) -> None:
    """Lines with a severity and a text."""
    if said is not None and len(said):
        levels = [severity_names(int(number)) for number in said["severity"]]
        level, name = (np.array([pair[i] for pair in levels]) for i in (0, 1))
        _put(found, "/vehicle/statustext", said.t_us, level, name, said["text"])


# ---------------------------------------------------------------- ULog


def _ulog(tables: Found, first_us: int) -> Found:
    found: Found = {}
    attitude, rates = tables.get("vehicle_attitude"), tables.get("vehicle_angular_velocity")
    if attitude is not None and _has(attitude, ("q",), 2) and attitude["q"].shape[1:] == (4,):
        turning = np.full((len(attitude), 3), np.nan)
        if rates is not None and _has(rates, ("xyz",), 2):
            turning = _at(attitude.t_us, rates, rates["xyz"])
        elif _has(attitude, ("rollspeed", "pitchspeed", "yawspeed")):
            turning = _columns(attitude, "rollspeed", "pitchspeed", "yawspeed")
        q = attitude["q"].astype(np.float64)
        _put(found, "/vehicle/attitude", attitude.t_us, _sampled(attitude, first_us), q, turning)
    local = tables.get("vehicle_local_position")
    if local is not None and _has(local, ("x", "y", "z", "vx", "vy", "vz")):
        sampled, place = _sampled(local, first_us), _columns(local, "x", "y", "z")
        _put(found, "/vehicle/local_position", local.t_us, sampled, place, _columns(local, "vx", "vy", "vz"))
    imu = tables.get("sensor_combined")
    if imu is not None and _has(imu, ("gyro_rad", "accelerometer_m_s2"), 2):
        force, turning = (imu[name].astype(np.float64) for name in ("accelerometer_m_s2", "gyro_rad"))
        _put(found, "/vehicle/imu", imu.t_us, imu.t_us, force, turning)
    motors, outputs = tables.get("actuator_motors"), tables.get("actuator_outputs")
    if motors is not None and _has(motors, ("control",), 2):
        _put(found, "/vehicle/motors", motors.t_us, _sampled(motors, first_us), _pulses(motors["control"]))
    elif outputs is not None and _has(outputs, ("output",), 2):
        wide = outputs["output"].astype(np.float64)
        simulated = np.nanmax(np.abs(wide)) <= 1.0
        pulses = _pulses(wide) if simulated else np.nan_to_num(wide).astype(np.int64)[:, :_OUTPUTS]
        _put(found, "/vehicle/motors", outputs.t_us, outputs.t_us, pulses)
    _ulog_status(tables, found)
    return found


def _ulog_status(tables: Found, found: Found) -> None:
    power, status, landed = (tables.get(n) for n in ("battery_status", "vehicle_status", "vehicle_land_detected"))
    if power is not None and _has(power, ("voltage_v",)):
        amperes = power["current_a"] if _has(power, ("current_a",)) else np.full(len(power), np.nan)
        left = power["remaining"] if _has(power, ("remaining",)) else np.full(len(power), np.nan)
        share = np.where(np.isfinite(left) & (left >= 0.0), 100.0 * left, -1.0)
        volts, amperes = power["voltage_v"].astype(np.float64), amperes.astype(np.float64)
        _put(found, "/vehicle/battery", power.t_us, volts, amperes, np.round(share).astype(np.int64))
    if status is not None and _has(status, ("nav_state", "arming_state")):
        ground = np.full(len(status), np.nan)
        if landed is not None and _has(landed, ("landed",)):
            ground = _at(status.t_us, landed, landed["landed"].astype(np.float64))
        modes = np.array([f"nav_state {n}" for n in status["nav_state"]])
        armed = status["arming_state"] == 2
        _put(found, "/vehicle/status", status.t_us, modes, armed, np.where(np.isnan(ground), ~armed, ground > 0.5))
    _put_said(found, tables.get(SAID))


def _sampled(table: Table, first_us: int) -> I64:
    """When the data were sampled, where the topic says so."""
    if "timestamp_sample" not in table.columns:
        return table.t_us
    sampled = table["timestamp_sample"].astype(np.int64) - first_us
    return np.where(np.abs(sampled - table.t_us) < 1_000_000, sampled, table.t_us)


# ---------------------------------------------------------------- DataFlash


def _dataflash(tables: Found, first_us: int) -> Found:
    found: Found = {}
    said = ardupilot.parameters(tables)
    to_frame = ardupilot.board_to_frame(said)
    attitude, imu = tables.get("ATT"), tables.get("IMU")
    if attitude is not None and _has(attitude, ("Roll", "Pitch", "Yaw")):
        turning = np.full((len(attitude), 3), np.nan)
        if imu is not None and _has(imu, ("GyrX", "GyrY", "GyrZ")):
            turning = _at(attitude.t_us, imu, _columns(imu, "GyrX", "GyrY", "GyrZ") @ to_frame.T)
        q = euler_to_quaternion(np.deg2rad(_columns(attitude, "Roll", "Pitch", "Yaw")))
        _put(found, "/vehicle/attitude", attitude.t_us, attitude.t_us, q, turning)
    filtered = next((t for n in ("XKF1", "NKF1", "EKF1") if (t := tables.get(n)) is not None), None)
    if filtered is not None and _has(filtered, ("PN", "PE", "PD", "VN", "VE", "VD")):
        state = _columns(filtered, "PN", "PE", "PD", "VN", "VE", "VD")
        runs = np.any(state != 0.0, axis=1)  # a filter that has not begun, or has nothing to go by, logs zeros
        if runs.any():
            t_us = filtered.t_us[runs]
            _put(found, "/vehicle/local_position", t_us, t_us, state[runs, :3], state[runs, 3:])
    if imu is not None and _has(imu, ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")):
        force, turning = _columns(imu, "AccX", "AccY", "AccZ"), _columns(imu, "GyrX", "GyrY", "GyrZ")
        _put(found, "/vehicle/imu", imu.t_us, imu.t_us, force @ to_frame.T, turning @ to_frame.T)
    outputs = tables.get("RCOU")
    if outputs is not None:
        before_3_4 = "Ch" if _has(outputs, ("Ch1",)) else "C"  # ArduCopter's name of a channel changed
        names = [name for i in range(1, _OUTPUTS + 1) if _has(outputs, (name := f"{before_3_4}{i}",))]
        wide = np.zeros((len(outputs), _OUTPUTS), np.int64)
        if names:
            wide[:, : len(names)] = _whole(_columns(outputs, *names))
        _put(found, "/vehicle/motors", outputs.t_us, outputs.t_us, ardupilot.motors_first(said, wide))
    power = tables.get("BAT", tables.get("CURR"))
    if power is not None and _has(power, ("Volt", "Curr")):
        left = power["RemPct"] if _has(power, ("RemPct",)) else np.full(len(power), -1)
        _put(found, "/vehicle/battery", power.t_us, power["Volt"], power["Curr"], _whole(left, -1))
    changes = ardupilot.states(tables)
    if changes is not None:
        at_us, armed, landed = changes
        _put(found, "/vehicle/status", at_us, np.full(len(at_us), ""), armed, landed)
    words = tables.get("MSG")
    if words is not None and "Message" in words.columns and words["Message"].dtype.kind in "US":
        level = np.full(len(words), "info")
        _put(found, "/vehicle/statustext", words.t_us, level, level, words["Message"])
    return found


# ---------------------------------------------------------------- CSV


def _csv(tables: Found, first_us: int) -> Found:
    """Of a table of signals in SI, NED and FRD (`readers.csv_file`)."""
    found: Found = {}
    flight = tables[CSV_TABLE]
    t_us, none = flight.t_us, np.full((len(flight), 3), np.nan)
    if "q_ned_frd" in flight.columns:
        rates = flight.columns.get("rate_frd_radps", none)
        _put(found, "/vehicle/attitude", t_us, t_us, flight["q_ned_frd"], rates)
    if "vel_ned_mps" in flight.columns or "pos_ned_m" in flight.columns:
        place, speed = (flight.columns.get(name, none) for name in ("pos_ned_m", "vel_ned_mps"))
        _put(found, "/vehicle/local_position", t_us, t_us, place, speed)
    if "accel_frd_mps2" in flight.columns or "rate_frd_radps" in flight.columns:
        force, rates = (flight.columns.get(name, none) for name in ("accel_frd_mps2", "rate_frd_radps"))
        _put(found, "/vehicle/imu", t_us, t_us, force, rates)
    if "motor" in flight.columns:
        _put(found, "/vehicle/motors", t_us, t_us, _pulses(flight["motor"]))
    if "battery_v" in flight.columns:
        unknown = np.full(len(flight), np.nan)
        _put(found, "/vehicle/battery", t_us, flight["battery_v"], unknown, np.full(len(flight), -1))
    return found


_KINDS: dict[str, Callable[[Found, int], Found]] = {
    "tlog": _mavlink,
    "ulog": _ulog,
    "dataflash": _dataflash,
    "csv": _csv,
}
