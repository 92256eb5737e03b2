"""PX4's logs, by today's and by old topic names; estimator outputs and IMU, never the simulator's ground truth.

Accelerometer and gyro are taken as sampled (`sensor_combined`: means over an integration interval, neither filtered nor
freed of the biases that the estimator believes in) where they are logged fast enough, else as the controllers use them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from flightstack.gap.checks.speeds import linearised
from flightstack.gap.records import Signal
from flightstack.gap.sources import FREED
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle
from flightstack_logs.reader import Log, Table

ROTORS = 4
_LEAST_RAW_HZ = 80.0
_RESET_S = 0.05
"""Left out round a step that the estimator made in its own state."""
_MOST = 1e6
"""What is greater is no measurement in SI units."""
_FIRST_MOTOR = 101
"""PX4's actuator_function of motor 1."""
_QUARTER_TURN = 0.5 * math.pi


def signals(log: Log, vehicle: Vehicle) -> tuple[dict[str, Signal], list[str]]:
    """Signals of a PX4 log, and what was done to read them; InputError where the airframe isn't the vehicle's."""
    notes: list[str] = []
    found: dict[str, Signal] = {}
    parameters = _parameters(log)
    check_airframe(parameters, vehicle, f"log {log.path}")
    _attitude(log, found, notes)
    _position(log, found, notes)
    _imu(log, found)
    _motors(log, parameters, found, notes)
    _put(found, "rotor_speed_radps", _speeds(log))
    _put(found, "battery_v", _first(log, ("battery_status", "voltage_v"), ("battery_status", "voltage_filtered_v")))
    _put(found, "landed", _first(log, ("vehicle_land_detected", "landed")))
    if "landed" not in found:
        armed = _first(log, ("actuator_armed", "armed"))
        if armed is not None:
            found["landed"] = Signal(armed.t_s, (armed.value < 0.5).astype(np.float64), "actuator_armed armed")
    if "battery_v" in found and not np.any(found["battery_v"].value > 1.0):
        del found["battery_v"]
    return found, notes


def check_airframe(parameters: dict[str, float], vehicle: Vehicle, where: str) -> None:
    """InputError where the log's own geometry has another number of rotors, or has them in another order."""
    count = parameters.get("CA_ROTOR_COUNT", 0.0)
    if count and count != ROTORS:
        raise InputError(f"{where}: flew with {count:.0f} rotors (CA_ROTOR_COUNT), the vehicle file has {ROTORS}; "
                         "name the file of this vehicle")  # fmt: skip
    names = [[f"CA_ROTOR{i}_P{axis}" for axis in "XY"] for i in range(ROTORS)]
    if not count or not all(name in parameters for pair in names for name in pair):
        return
    log_xy = np.array([[parameters[name] for name in pair] for pair in names])
    if not np.linalg.norm(log_xy, axis=1).all():
        return
    turn = np.arctan2(log_xy[:, 1], log_xy[:, 0]) - np.arctan2(*vehicle.rotors.position_m[:, 1::-1].T)
    if np.any(np.abs(np.angle(np.exp(1j * turn))) > 0.5 * _QUARTER_TURN):
        raise InputError(f"{where}: its rotors (CA_ROTOR0_PX, ...) sit elsewhere than the vehicle file's; the file's "
                         "order must be PX4's: front right, rear left, front left, rear right")  # fmt: skip


def _parameters(log: Log) -> dict[str, float]:
    """Parameters as numbers; what is none is left out."""
    out = {}
    for name, text in log.metadata.get("parameters", {}).items():
        try:
            value = float(text)
        except ValueError:
            continue
        if math.isfinite(value):
            out[name] = value
    return out


def _table(log: Log, topic: str, *columns: str) -> Table | None:
    table = log.tables.get(topic)
    return table if table is not None and len(table) > 1 and set(columns) <= table.columns.keys() else None


def _stamps(table: Table) -> F64:
    """When the data were sampled, where the topic says so; else when the message was made; seconds."""
    stamps = table.t_us.astype(np.float64)
    if "timestamp_sample" in table.columns:
        sampled = table["timestamp_sample"].astype(np.float64)
        known = (sampled > 0.0) & (np.abs(stamps - sampled) < 1e6)
        usual = float(np.median((stamps - sampled)[known])) if known.any() else 0.0
        stamps = np.where(known, sampled, stamps - usual)
    return stamps * 1e-6


def _signal(table: Table, values: F64, source: str, keep: np.ndarray | None = None) -> Signal | None:
    """Finite rows in order of their stamps, each stamp once; None where none are left."""
    t_s, values = _stamps(table), np.asarray(values, np.float64)
    real = np.abs(values) < _MOST
    good = real if values.ndim == 1 else real.all(axis=1)
    rows = np.flatnonzero(good if keep is None else good & keep)
    t_s, first = np.unique(t_s[rows], return_index=True)
    return Signal(t_s, values[rows][first], source) if len(t_s) > 1 else None


def _first(log: Log, *wanted: tuple[str, str], width: int = 0) -> Signal | None:
    """The first of these columns that the log has with data in it."""
    for topic, column in wanted:
        table = _table(log, topic, column)
        if table is None or (table[column].shape[1:] != ((width,) if width else ())):
            continue
        signal = _signal(table, table[column], f"{topic} {column}")
        if signal is not None:
            return signal
    return None


def _put(found: dict[str, Signal], name: str, signal: Signal | None) -> None:
    if signal is not None:
        found[name] = signal


def _attitude(log: Log, found: dict[str, Signal], notes: list[str]) -> None:
    for topic in ("vehicle_attitude", "estimator_attitude", "vehicle_odometry"):
        table = _table(log, topic, "q")
        if table is None or table["q"].shape[1:] != (4,):
            continue
        size = np.linalg.norm(table["q"], axis=1)
        keep = (np.abs(size - 1.0) < 0.05) & _steady(table, ("quat_reset_counter",), topic, notes)
        _put(found, "q_ned_frd", _signal(table, table["q"], f"{topic} q", keep))
        if "q_ned_frd" in found:
            return


def _position(log: Log, found: dict[str, Signal], notes: list[str]) -> None:
    for topic in ("vehicle_local_position", "estimator_local_position"):
        table = _table(log, topic, "x", "y", "z", "vx", "vy", "vz")
        if table is None:
            continue
        counters = tuple(f"{name}_reset_counter" for name in ("xy", "z", "vxy", "vz"))
        steady = _steady(table, counters, topic, notes)
        for name, columns, flags in (
            ("pos_ned_m", ("x", "y", "z"), ("xy_valid", "z_valid")),
            ("vel_ned_mps", ("vx", "vy", "vz"), ("v_xy_valid", "v_z_valid")),
        ):
            keep = steady.copy()
            for flag in flags:
                keep &= table[flag].astype(bool) if flag in table.columns else True
            values = np.stack([table[column] for column in columns], axis=-1)
            _put(found, name, _signal(table, values, f"{topic} {', '.join(columns)}", keep))
        if "vel_ned_mps" in found:
            return
    _put(found, "pos_ned_m", _first(log, ("vehicle_odometry", "position"), width=3))
    _put(found, "vel_ned_mps", _first(log, ("vehicle_odometry", "velocity"), width=3))


def _steady(table: Table, counters: tuple[str, ...], topic: str, notes: list[str]) -> np.ndarray:
    """Rows away from the steps that the estimator counts."""
    t_s, keep, resets = _stamps(table), np.ones(len(table), np.bool_), 0
    for counter in counters:
        if counter in table.columns:
            for row in (np.flatnonzero(np.diff(table[counter])) + 1).tolist():
                resets += 1
                keep &= np.abs(t_s - t_s[row]) > _RESET_S
    if resets:
        notes.append(f"{topic}: the estimator stepped {resets} times; left out round these")
    return keep


def _imu(log: Log, found: dict[str, Signal]) -> None:
    """Raw where it is fast, else filtered, else raw however slow."""
    raw = _table(log, "sensor_combined", "gyro_rad", "accelerometer_m_s2")
    fast = raw is not None and (len(raw) - 1) * 1e6 > _LEAST_RAW_HZ * max(1, int(raw.t_us[-1] - raw.t_us[0]))
    sampled = ("sensor_combined", "gyro_rad"), ("sensor_combined", "accelerometer_m_s2")
    rates = [("vehicle_angular_velocity", "xyz")]
    forces = [("vehicle_acceleration", "xyz")]
    rates = [sampled[0], *rates] if fast else [*rates, sampled[0]]
    forces = [sampled[1], *forces] if fast else [*forces, sampled[1]]
    _put(found, "rate_frd_radps", _first(log, *rates, width=3))
    _put(found, "accel_frd_mps2", _first(log, *forces, width=3))
    accel = found.get("accel_frd_mps2")
    if accel is not None and accel.source.startswith("vehicle_acceleration"):
        found["accel_frd_mps2"] = replace(accel, source=f"{accel.source}, {FREED}")
    old = _table(log, "vehicle_attitude", "rollspeed", "pitchspeed", "yawspeed")
    if "rate_frd_radps" not in found and old is not None:
        values = np.stack([old[name] for name in ("rollspeed", "pitchspeed", "yawspeed")], axis=-1)
        _put(found, "rate_frd_radps", _signal(old, values, "vehicle_attitude rollspeed, pitchspeed, yawspeed"))


def _motors(log: Log, parameters: dict[str, float], found: dict[str, Signal], notes: list[str]) -> None:
    """Commands as they reach the motors: `actuator_motors`, then THR_MDL_FAC; in old logs the outputs' pulse width."""
    table = _table(log, "actuator_motors", "control")
    if table is not None and table["control"].shape[1] >= ROTORS:
        control = table["control"].astype(np.float64)
        used = np.isfinite(control) & (control != 0.0)
        if used[:, ROTORS:].any():
            raise InputError(f"log {log.path}: drives more than {ROTORS} motors; the vehicle file has {ROTORS} rotors")
        factor = parameters.get("THR_MDL_FAC", 0.0)
        command = linearised(np.clip(np.nan_to_num(control[:, :ROTORS]), 0.0, 1.0), factor)
        if factor:
            notes.append(f"motors: THR_MDL_FAC {factor:g} of the log applied, as PX4 does after actuator_motors")
        _put(found, "motor", _signal(table, command, "actuator_motors control"))
        return
    for name in ("actuator_outputs", "actuator_outputs_1", "actuator_outputs_2"):
        table = _table(log, name, "output")
        if table is None or table["output"].ndim != 2 or table["output"].shape[1] < ROTORS:
            continue
        command = _from_outputs(table["output"][:, :ROTORS].astype(np.float64), parameters)
        if np.ptp(command) > 0.0 or "motor" not in found:
            _put(found, "motor", _signal(table, command, f"{name} output"))
        if np.ptp(command) > 0.0:
            return


def _speeds(log: Log) -> Signal | None:
    """(N, 4) what the speed controllers report, by motor, where each tells its motor; rad/s."""
    names = [f"esc[{i}].{what}" for what in ("esc_rpm", "actuator_function") for i in range(ROTORS)]
    table = _table(log, "esc_status", *names)
    if table is None:
        return None
    rpm = np.stack([table[name].astype(np.float64) for name in names[:ROTORS]], axis=-1)
    motors = [int(np.median(table[name])) - _FIRST_MOTOR for name in names[ROTORS:]]
    if sorted(motors) == list(range(ROTORS)):
        rpm[:, motors] = rpm.copy()
    return _signal(table, np.abs(rpm) * math.pi / 30.0, "esc_status esc_rpm") if np.any(rpm) else None


def _from_outputs(output: F64, parameters: dict[str, float]) -> F64:
    """Commands 0..1 of pulse widths (by PWM_MIN, PWM_MAX or PWM_MAIN_MIN1, ...) or of simulated outputs."""
    if np.nanmax(np.abs(output)) <= 1.0:
        return np.asarray(np.clip(np.nan_to_num(output), 0.0, 1.0))
    low = [_bound(parameters, i, ("PWM_MAIN_MIN", "PWM_AUX_MIN"), "PWM_MIN", 1000.0) for i in range(1, ROTORS + 1)]
    high = [_bound(parameters, i, ("PWM_MAIN_MAX", "PWM_AUX_MAX"), "PWM_MAX", 2000.0) for i in range(1, ROTORS + 1)]
    span = np.array(high) - np.array(low)
    return np.asarray(np.clip((output - np.array(low)) / np.where(span > 0.0, span, 1000.0), 0.0, 1.0))


def _bound(parameters: dict[str, float], number: int, names: tuple[str, ...], old: str, default: float) -> float:
    for name in names:
        value = parameters.get(f"{name}{number}", 0.0)
        if value > 0.0:
            return value
    return parameters.get(old, default)
