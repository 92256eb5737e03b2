"""Crazyflie logs: the table logged at a fixed rate, its columns read through a map; an attitude where it logs none."""

from __future__ import annotations

import numpy as np

from flightstack.gap.checks.motion import G_NED, band
from flightstack.gap.sources import DERIVED_HZ
from flightstack.types import F64
from flightstack_logs.turn import euler_to_quaternion

_LEAST_ROWS = 100


def attitude_from_tilt(t_us: np.ndarray, columns: dict[str, np.ndarray], acc_ned_mps2: F64) -> F64 | None:
    """(N, 4) attitude where a log has roll and yaw, but no pitch: the pitch that its acceleration takes.

    In the heading's frame the specific force of rotors is -f (cos roll sin pitch, -sin roll, cos roll cos pitch); below
    a few Hz, and as far as drag may be neglected, forward and downward parts give the pitch.  None without them.
    """
    if not {"stateEstimate.roll", "stateEstimate.yaw"} <= columns.keys() or len(t_us) < _LEAST_ROWS:
        return None
    roll = np.radians(columns["stateEstimate.roll"].astype(np.float64))
    yaw = -np.radians(columns["stateEstimate.yaw"].astype(np.float64))
    force = acc_ned_mps2 - G_NED
    dt_s = float(np.median(np.diff(t_us))) * 1e-6
    if not (np.isfinite(force).all() and np.isfinite(roll).all() and np.isfinite(yaw).all() and dt_s > 0.0):
        return None
    ahead = force[:, 0] * np.cos(yaw) + force[:, 1] * np.sin(yaw)
    smooth = band(np.stack([ahead, force[:, 2]], axis=1), dt_s, 0.0, DERIVED_HZ)
    pitch = np.arctan2(-smooth[:, 0], np.maximum(-smooth[:, 1], 1.0))
    return euler_to_quaternion(np.stack([roll, pitch, yaw], axis=1))
