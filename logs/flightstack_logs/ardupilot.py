"""What ArduPilot's parameters and events say of its logs: how the board sits, which output drives which motor.

ArduPilot tells attitude of the frame and logs the IMU in the board's axes; AHRS_TRIM is the rotation between the two
(AP_AHRS).  A trim of 2 degrees read as none looks like an accelerometer bias of 0.3 m/s^2.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.types import F64, I64, InputError, Mask
from flightstack_logs.tables import Table

_MOTOR_1, _MOTORS = 33, 4
"""SERVOn_FUNCTION of the first motor; of a quadrotor."""
_QUAD = 1
"""FRAME_CLASS."""
_IN_PX4_ORDER = {12: (1, 2, 3, 0), 18: (1, 2, 3, 0), 13: (0, 2, 1, 3), 14: (0, 2, 3, 1)}
"""FRAME_TYPE (Betaflight X, the same reversed, DJI X, clockwise X; AP_MotorsMatrix) -> its motors from front right by
rear left, front left and rear right; X, V and H have that order."""
_X_FRAMES, _REVERSED = (1, 3), 18
"""X and H; the one whose rotors turn the other way."""
_MOST_TRIM_RAD = math.radians(45.0)
_ARMED, _DISARMED, _LANDED, _FLYING = 10, 11, 18, 28
"""LogEvent of EV messages."""
_LEAST_US, _MOST_US = 500.0, 2500.0


def parameters(tables: dict[str, Table]) -> dict[str, float]:
    """Parameters by name, the last value of each: PARM of a DataFlash log, PARAM_VALUE of a telemetry log."""
    for name, key, value in (("PARM", "Name", "Value"), ("PARAM_VALUE", "param_id", "param_value")):
        table = tables.get(name)
        if table is not None and {key, value} <= table.columns.keys() and _plain(table[value]) and table[key].ndim == 1:
            return {str(k): float(v) for k, v in zip(table[key], table[value], strict=True) if math.isfinite(v)}
    return {}


def _plain(column: np.ndarray) -> bool:
    """Whether it is a number a row: a log says itself what its columns are."""
    return column.ndim == 1 and column.dtype.kind in "iuf"


def board_to_frame(said: dict[str, float]) -> F64:
    """(3, 3) that turns what the board measures into the frame's axes; the identity where nothing is said."""
    roll, pitch, yaw = (said.get(f"AHRS_TRIM_{axis}", 0.0) for axis in "XYZ")
    if max(abs(roll), abs(pitch), abs(yaw)) > _MOST_TRIM_RAD:
        return np.eye(3)
    cr, sr, cp, sp, cy, sy = (f(angle) for angle in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def as_px4(said: dict[str, float], source: str) -> dict[str, float]:
    """What PX4's parameters would say of the same vehicle: geometry free of scale, hover thrust, thrust curve.

    InputError, one line, where it is no quadrotor of four rotors in an X.
    """
    kind = said.get("FRAME_CLASS")
    if kind != _QUAD:
        what = "is not told: no ArduCopter, or one before 3.5" if kind is None else f"= {kind:g}"
        raise InputError(f"{source}: FRAME_CLASS {what}; only quadrotors can be described")
    frame = said.get("FRAME_TYPE", 1.0)
    if frame not in (*_X_FRAMES, *_IN_PX4_ORDER):
        raise InputError(f"{source}: FRAME_TYPE = {frame:g} is no X; write the vehicle file by hand (docs/vehicle.md)")
    turns = -1.0 if frame == _REVERSED else 1.0
    told = {"MPC_THR_HOVER": said.get("MOT_THST_HOVER"), "THR_MDL_FAC": said.get("MOT_THST_EXPO")}
    out = {name: value for name, value in told.items() if value is not None}
    for k, (x, y, turn) in enumerate(((1.0, 1.0, 1.0), (-1.0, -1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0))):
        out |= {f"CA_ROTOR{k}_PX": x, f"CA_ROTOR{k}_PY": y, f"CA_ROTOR{k}_KM": turns * turn}
    return out


def motors_first(said: dict[str, float], pulses_us: I64) -> I64:
    """The outputs (n, 16), those of a quadrotor's motors first, from front right by rear left, front left, rear right.

    Pulses between MOT_PWM_MIN and MOT_PWM_MAX, where these are set, become ones between 1000 and 2000.
    """
    motors = [
        next((c for c in range(pulses_us.shape[1]) if said.get(f"SERVO{c + 1}_FUNCTION") == _MOTOR_1 + k), None)
        for k in range(_MOTORS)
    ]
    found = [channel for channel in motors if channel is not None]
    if len(found) < _MOTORS or said.get("FRAME_CLASS", _QUAD) != _QUAD:
        return pulses_us
    order = [found[k] for k in _IN_PX4_ORDER.get(int(said.get("FRAME_TYPE", 1)), (0, 1, 2, 3))]
    rest = [channel for channel in range(pulses_us.shape[1]) if channel not in order]
    out = pulses_us[:, [*order, *rest]].copy()
    low, high = said.get("MOT_PWM_MIN", 0.0), said.get("MOT_PWM_MAX", 0.0)
    if _LEAST_US <= low < high <= _MOST_US:
        driven = out[:, :_MOTORS]
        out[:, :_MOTORS] = np.where(driven > 0, np.round(1000.0 + 1000.0 * (driven - low) / (high - low)), 0.0)
    return out


def states(tables: dict[str, Table]) -> tuple[I64, Mask, Mask] | None:
    """When arming or landing changed (us), and armed and on the ground from then on; None where no event says so."""
    events = tables.get("EV")
    if events is None or "Id" not in events.columns or not _plain(events["Id"]):
        return None
    known = np.isin(events["Id"], (_ARMED, _DISARMED, _LANDED, _FLYING))
    if not (events["Id"] == _FLYING).any():
        return None
    armed, ground, rows = True, True, []
    for number in events["Id"][known].tolist():
        armed = armed if number in (_LANDED, _FLYING) else number == _ARMED
        ground = number != _FLYING if number in (_LANDED, _FLYING) else ground or number == _DISARMED
        rows.append((armed, ground))
    flags = np.array(rows, np.bool_)
    return events.t_us[known], flags[:, 0], flags[:, 1]
