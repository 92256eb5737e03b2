"""What the vehicle reported, by its own sample times; never the truth.

This project's own logs, and those of ground stations and of ArduPilot under this project's topics.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flightstack.gap.records import Signal
from flightstack.gap.sources import FREED
from flightstack.types import F64, InputError
from flightstack_logs.reader import Log, Table

_STOPPED_US, _FULL_US = 1000.0, 2000.0
"""Pulse widths at command 0 and 1; 900 is disarmed."""
_MOST = 1e6
"""What is greater is no measurement in SI units."""
_BATTERY_LEAST_V = 0.5
_ALIKE = 0.8
"""Correlation from which an output drives a motor."""
_PX4 = 12
"""MAV_AUTOPILOT_PX4."""
_FLIGHT = {
    "tlog": "LOCAL_POSITION_NED, ATTITUDE, HIGHRES_IMU, RAW_IMU and SERVO_OUTPUT_RAW; let the vehicle stream them",
    "dataflash": "XKF1, ATT, IMU and RCOU; set LOG_BITMASK to 180222, or LOG_DISARMED off and fly",
}
"""By kind of log what a flight is told by, and what to do where none of it is there."""


def signals(log: Log) -> tuple[dict[str, Signal], list[str]]:
    """Signals of a companion's log, and what was done to read them."""
    notes: list[str] = []
    found: dict[str, Signal] = {}
    position = _table(log, "/vehicle/local_position", ("t_boot_us", "pos_ned_m", "vel_ned_mps"))
    attitude = _table(log, "/vehicle/attitude", ("t_boot_us", "q_ned_frd", "rate_frd_radps"))
    imu = _table(log, "/vehicle/imu", ("t_us", "accel_frd_mps2", "rate_frd_radps"))
    motors = _table(log, "/vehicle/motors", ("t_us", "pwm_us"))
    if position is not None:
        found["pos_ned_m"] = _signal(position, "t_boot_us", "pos_ned_m")
        found["vel_ned_mps"] = _signal(position, "t_boot_us", "vel_ned_mps")
    if attitude is not None:
        found["q_ned_frd"] = _signal(attitude, "t_boot_us", "q_ned_frd")
        found["rate_frd_radps"] = _signal(attitude, "t_boot_us", "rate_frd_radps")
    if imu is not None:
        accel = _signal(imu, "t_us", "accel_frd_mps2")
        found["accel_frd_mps2"] = replace(accel, source=f"{accel.source}, {FREED}") if _is_freed(log) else accel
        found["rate_frd_radps"] = _signal(imu, "t_us", "rate_frd_radps")
    if motors is not None and motors["pwm_us"].ndim == 2 and motors["pwm_us"].shape[1] >= 4:
        raw = _signal(motors, "t_us", "pwm_us")
        _refuse_more_motors(log, raw.value)
        command = (raw.value[:, :4] - _STOPPED_US) / (_FULL_US - _STOPPED_US)
        found["motor"] = Signal(raw.t_s, np.clip(command, 0.0, 1.0), raw.source)
    battery = _table(log, "/vehicle/battery", ("voltage_v",))
    if battery is not None:
        volts = battery["voltage_v"].astype(np.float64)
        good = np.isfinite(volts) & (volts > _BATTERY_LEAST_V)
        if good.any():
            found["battery_v"] = Signal(battery.t_us[good].astype(np.float64) * 1e-6, volts[good], "/vehicle/battery")
    status = _table(log, "/vehicle/status", ("landed", "armed"))
    if status is not None:
        on_ground = (status["landed"].astype(bool) | ~status["armed"].astype(bool)).astype(np.float64)
        found["landed"] = Signal(status.t_us.astype(np.float64) * 1e-6, on_ground, "/vehicle/status")
    if log.kind in _FLIGHT and not found.keys() - {"landed", "battery_v"}:
        raise InputError(f"log {log.path}: holds no flight: there is none of {_FLIGHT[log.kind]}")
    if not found and log.tables:
        raise InputError(f"log {log.path}: is an MCAP of other origin (no /vehicle topics); convert it to CSV")
    return found, notes


def _is_freed(log: Log) -> bool:
    """Whether the IMU is HIGHRES_IMU as PX4 sends it, less what its filter believes of the accelerometer's bias."""
    if log.kind == "mcap":
        return True
    heart = log.tables.get("HEARTBEAT")
    flown_by = None if heart is None or not len(heart) else int(np.median(heart["autopilot"]))
    return log.kind == "tlog" and "HIGHRES_IMU" in log.tables and flown_by in (None, _PX4)


def _refuse_more_motors(log: Log, pulse_us: F64) -> None:
    """Further outputs that rise and fall with the first four are motors; a gimbal's or a gripper's don't."""
    mean = pulse_us[:, :4].mean(axis=1)
    others = pulse_us[:, 4:]
    moving = others[:, np.ptp(others, axis=0) > 0.0] if len(others) else others
    if np.ptp(mean) == 0.0 or not moving.shape[1]:
        return
    alike = sum(np.corrcoef(mean, each)[0, 1] > _ALIKE for each in moving.T)
    if alike:
        raise InputError(
            f"log {log.path}: drives {4 + alike} motors, a vehicle file has 4 rotors; name a quadrotor's flight"
        )


def _table(log: Log, topic: str, columns: tuple[str, ...]) -> Table | None:
    table = log.tables.get(topic)
    return table if table is not None and len(table) and set(columns) <= table.columns.keys() else None


def _signal(table: Table, stamp: str, column: str) -> Signal:
    """Rows by the vehicle's own sample time, each time once."""
    t_us, first = np.unique(table[stamp].astype(np.int64), return_index=True)
    t_s: F64 = t_us.astype(np.float64) * 1e-6
    values = table[column][first].astype(np.float64)
    good = (np.abs(values) < _MOST).all(axis=1)
    return Signal(t_s[good], values[good], f"{table.name} {column}")
