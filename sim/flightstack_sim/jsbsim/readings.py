"""JSBSim's numbers as the plant shows them: feet to metres, the globe to a flat world, Euler angles to a quaternion.

Compiled: it runs once a step.  The flat world lies in the tangent plane at the origin; heights are those over the
ellipsoid (to second order), so that level flight keeps its height.  Velocity and attitude are relative to the local
north, east and down, which turn against those of the origin by the distance over the earth's radius.
"""

from __future__ import annotations

import math

from flightstack.jit import Entry, njit
from flightstack.types import F64

R_POS, R_VEL, R_Q, R_RATE, R_FORCE, R_ANGULAR, R_LAST_FORCE = 0, 3, 6, 10, 13, 16, 19
READINGS = 22
"""Position and velocity NED, quaternion, body rates, specific force and angular acceleration FRD (means over the last
step), specific force at its end; SI."""
F_ORIGIN, F_TURN, F_RADII, F_DT, F_PER_POUND = 0, 3, 12, 14, 15
FRAME = 16
"""Origin (ECEF, ft), ECEF to NED (row by row), radii of curvature (north, east; m), the step (s), m/s^2 per pound."""
_FOOT_M = 0.3048


@njit
def read(row: F64, frame: F64, numbers: tuple[float, ...]) -> float:
    """Write one step's end into `row`: ECEF (ft), velocity NED (ft/s), Euler angles, rates (rad/s), force FRD (lb).

    Returns the height, m.  Numbers that are none (a wreck that spins faster than a step can follow) leave the row as
    it is.
    """
    x, y, z, vn, ve, vd, phi, theta, psi, p, q, r, fx, fy, fz = numbers
    if not math.isfinite(x + y + z + vn + ve + vd + p + q + r + fx + fy + fz):
        return float(-row[R_POS + 2])
    dx, dy, dz = x - frame[F_ORIGIN], y - frame[F_ORIGIN + 1], z - frame[F_ORIGIN + 2]
    for i in range(3):
        at = F_TURN + 3 * i
        row[R_POS + i] = _FOOT_M * (frame[at] * dx + frame[at + 1] * dy + frame[at + 2] * dz)
    north, east = row[R_POS], row[R_POS + 1]
    row[R_POS + 2] -= 0.5 * (north * north / frame[F_RADII] + east * east / frame[F_RADII + 1])
    row[R_VEL], row[R_VEL + 1], row[R_VEL + 2] = _FOOT_M * vn, _FOOT_M * ve, _FOOT_M * vd
    _attitude(row, 0.5 * phi, 0.5 * theta, 0.5 * psi)
    dt, scale = frame[F_DT], frame[F_PER_POUND]
    for i, (rate, force) in enumerate(((p, scale * fx), (q, scale * fy), (r, scale * fz))):
        row[R_ANGULAR + i] = (rate - row[R_RATE + i]) / dt
        row[R_RATE + i] = rate
        row[R_FORCE + i] = 0.5 * (row[R_LAST_FORCE + i] + force)
        row[R_LAST_FORCE + i] = force
    return float(-row[R_POS + 2])


@njit
def _attitude(row: F64, phi: float, theta: float, psi: float) -> None:
    """The quaternion of half Euler angles, of the sign that is nearer to the last."""
    cr, sr, cp, sp, cy, sy = (
        math.cos(phi), math.sin(phi), math.cos(theta), math.sin(theta), math.cos(psi), math.sin(psi),
    )  # fmt: skip
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    if w * row[R_Q] + x * row[R_Q + 1] + y * row[R_Q + 2] + z * row[R_Q + 3] < 0.0:
        w, x, y, z = -w, -x, -y, -z
    row[R_Q], row[R_Q + 1], row[R_Q + 2], row[R_Q + 3] = w, x, y, z


READ = Entry(read, "f8[::1], f8[::1], UniTuple(f8, 15)")
