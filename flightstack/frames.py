"""Frames and attitude: the only place where signs change.

NED world, FRD body, Hamilton quaternions (w, x, y, z), body to world.  Viewers want ENU and FLU: `ned_to_enu`,
`frd_to_flu` and `q_ned_frd_to_enu_flu` are the one way there.
Compiled functions take and return float64 arrays; `rotation` and `rotation_to_quat` plain numbers, to allocate nothing.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit
from flightstack.rows import Q_W, Q_X, Q_Y, Q_Z
from flightstack.types import F64, Tuple3, Tuple4

Rows3 = tuple[Tuple3, Tuple3, Tuple3]
"""Of a matrix; or a vector and its first two derivatives."""


@njit
def quat_multiply(a: F64, b: F64) -> F64:
    """Hamilton product a ⊗ b; (4,), (4,) -> (4,)."""
    out = np.empty(4)
    out[Q_W] = a[Q_W] * b[Q_W] - a[Q_X] * b[Q_X] - a[Q_Y] * b[Q_Y] - a[Q_Z] * b[Q_Z]
    out[Q_X] = a[Q_W] * b[Q_X] + a[Q_X] * b[Q_W] + a[Q_Y] * b[Q_Z] - a[Q_Z] * b[Q_Y]
    out[Q_Y] = a[Q_W] * b[Q_Y] - a[Q_X] * b[Q_Z] + a[Q_Y] * b[Q_W] + a[Q_Z] * b[Q_X]
    out[Q_Z] = a[Q_W] * b[Q_Z] + a[Q_X] * b[Q_Y] - a[Q_Y] * b[Q_X] + a[Q_Z] * b[Q_W]
    return out


@njit
def quat_conjugate(q: F64) -> F64:
    """The inverse rotation of a unit quaternion; (4,) -> (4,)."""
    return np.array([q[Q_W], -q[Q_X], -q[Q_Y], -q[Q_Z]])


@njit
def rotation(q: F64) -> Rows3:
    """Rotation matrix of a unit quaternion (4,), row by row, as plain numbers: nothing is allocated."""
    w, x, y, z = q[Q_W], q[Q_X], q[Q_Y], q[Q_Z]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@njit
def quat_to_matrix(q: F64) -> F64:
    """Rotation matrix R (3, 3) of a unit quaternion: v_world = R v_body; its columns are the body axes in the world."""
    rows, r = rotation(q), np.empty((3, 3))
    for i in range(3):
        r[i, 0], r[i, 1], r[i, 2] = rows[i]
    return r


@njit
def matrix_to_quat(r: F64) -> F64:
    """Unit quaternion (4,) with w >= 0 of a rotation matrix (3, 3)."""
    q = np.empty(4)
    q[Q_W], q[Q_X], q[Q_Y], q[Q_Z] = rotation_to_quat(
        ((r[0, 0], r[0, 1], r[0, 2]), (r[1, 0], r[1, 1], r[1, 2]), (r[2, 0], r[2, 1], r[2, 2]))
    )
    return q


@njit
def rotation_to_quat(r: Rows3) -> Tuple4:
    """The same of plain numbers (w, x, y, z); Shepperd's choice of the largest pivot."""
    a, b, c = r[0][0], r[1][1], r[2][2]
    trace = a + b + c
    if trace >= a and trace >= b and trace >= c:
        w, x, y, z = 1.0 + trace, r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]
    elif a >= b and a >= c:
        w, x, y, z = r[2][1] - r[1][2], 1.0 + 2.0 * a - trace, r[1][0] + r[0][1], r[0][2] + r[2][0]
    elif b >= c:
        w, x, y, z = r[0][2] - r[2][0], r[1][0] + r[0][1], 1.0 + 2.0 * b - trace, r[2][1] + r[1][2]
    else:
        w, x, y, z = r[1][0] - r[0][1], r[0][2] + r[2][0], r[2][1] + r[1][2], 1.0 + 2.0 * c - trace
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    norm = -norm if w < 0.0 else norm
    return w / norm, x / norm, y / norm, z / norm


@njit
def rotate(q: F64, v: F64) -> F64:
    """Turn a body vector into the world: R(q) v; (4,), (3,) -> (3,)."""
    tx = 2.0 * (q[Q_Y] * v[2] - q[Q_Z] * v[1])
    ty = 2.0 * (q[Q_Z] * v[0] - q[Q_X] * v[2])
    tz = 2.0 * (q[Q_X] * v[1] - q[Q_Y] * v[0])
    out = np.empty(3)
    out[0] = v[0] + q[Q_W] * tx + q[Q_Y] * tz - q[Q_Z] * ty
    out[1] = v[1] + q[Q_W] * ty + q[Q_Z] * tx - q[Q_X] * tz
    out[2] = v[2] + q[Q_W] * tz + q[Q_X] * ty - q[Q_Y] * tx
    return out


@njit
def rotate_inverse(q: F64, v: F64) -> F64:
    """Turn a world vector into the body: R(q)^T v; (4,), (3,) -> (3,)."""
    return rotate(quat_conjugate(q), v)


@njit
def quat_from_rotation_vector(phi: F64) -> F64:
    """Exponential map: rotation vector (3,) rad -> unit quaternion (4,)."""
    angle = math.sqrt(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    half = 0.5 * angle
    s = 0.5 - angle * angle / 48.0 if angle < 1e-6 else math.sin(half) / angle
    out = np.empty(4)
    out[Q_W] = math.cos(half)
    out[Q_X] = s * phi[0]
    out[Q_Y] = s * phi[1]
    out[Q_Z] = s * phi[2]
    return out


@njit
def quat_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> F64:
    """Unit quaternion (4,) of ZYX (yaw, pitch, roll) Euler angles."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    out = np.empty(4)
    out[Q_W] = cr * cp * cy + sr * sp * sy
    out[Q_X] = sr * cp * cy - cr * sp * sy
    out[Q_Y] = cr * sp * cy + sr * cp * sy
    out[Q_Z] = cr * cp * sy - sr * sp * cy
    return out


@njit
def euler_from_quat(q: F64) -> F64:
    """(roll, pitch, yaw) rad (3,), ZYX; pitch is clipped at +-90 degrees."""
    w, x, y, z = q[Q_W], q[Q_X], q[Q_Y], q[Q_Z]
    out = np.empty(3)
    out[0] = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    out[1] = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    out[2] = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return out


def ned_to_enu(v: F64) -> F64:
    """World vector(s) (..., 3) from NED to ENU; its own inverse."""
    v = np.asarray(v, dtype=np.float64)
    return np.stack([v[..., 1], v[..., 0], -v[..., 2]], axis=-1)


def frd_to_flu(v: F64) -> F64:
    """Body vector(s) (..., 3) from FRD to FLU; its own inverse."""
    v = np.asarray(v, dtype=np.float64)
    return np.stack([v[..., 0], -v[..., 1], -v[..., 2]], axis=-1)


_SQRT_HALF = math.sqrt(0.5)


def q_ned_frd_to_enu_flu(q: F64) -> F64:
    """Attitude(s) (..., 4) for viewers: q_enu_ned ⊗ q_ned_frd ⊗ q_frd_flu, both fixed turns written out."""
    q = np.asarray(q, dtype=np.float64)
    w, x, y, z = q[..., Q_W], q[..., Q_X], q[..., Q_Y], q[..., Q_Z]
    return _SQRT_HALF * np.stack([w + z, x + y, x - y, w - z], axis=-1)
