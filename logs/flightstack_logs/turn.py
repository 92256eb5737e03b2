"""Turning whole columns: quaternions (N, 4) and vectors (N, 3) between frames, in plain NumPy.

`flightstack.frames` does the same for one vector in flight; here logs are turned, which may hold NaN.
"""

from __future__ import annotations

import numpy as np

from flightstack.types import F64


def multiply(a: F64, b: F64) -> F64:
    """Hamilton product a ⊗ b, row by row; rows of one are repeated."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: F64) -> F64:
    """Inverse rotations of unit quaternions."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def rotate(q: F64, v: F64) -> F64:
    """R(q) v, row by row, of unit quaternions; rows of one are repeated."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    vx, vy, vz = np.moveaxis(v, -1, 0)
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return np.stack(
        [vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx], axis=-1
    )


def rotate_inverse(q: F64, v: F64) -> F64:
    """R(q)^T v, row by row."""
    return rotate(conjugate(q), v)


def turned(phi: F64) -> F64:
    """(N, 4) unit quaternions of (N, 3) rotation vectors."""
    half = 0.5 * np.linalg.norm(phi, axis=1, keepdims=True)
    return np.hstack([np.cos(half), 0.5 * phi * np.sinc(half / np.pi)])


def rotation_vector(q: F64) -> F64:
    """(N, 3) rotation vectors of (N, 4) unit quaternions, the short way round."""
    q = np.where(q[:, :1] < 0.0, -q, q)
    norm = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(norm, q[:, :1])
    return np.asarray(q[:, 1:] * np.where(norm > 1e-12, angle / np.maximum(norm, 1e-12), 2.0))


def continuous(q: F64) -> F64:
    """The same attitudes, unit length, with signs such that neighbours are near; NaN rows stay NaN."""
    unit = q / np.linalg.norm(q, axis=1, keepdims=True)
    filled = unit.copy()
    good = np.isfinite(unit).all(axis=1)
    filled[~good] = 0.0
    rows = np.flatnonzero(good)
    if len(rows) > 1:
        dots = np.einsum("ij,ij->i", unit[rows[1:]], unit[rows[:-1]])
        signs = np.cumprod(np.where(dots < 0.0, -1.0, 1.0))
        filled[rows[1:]] = unit[rows[1:]] * signs[:, None]
    filled[~good] = np.nan
    return np.asarray(filled)


def euler_to_quaternion(rpy_rad: F64) -> F64:
    """(N, 3) roll, pitch, yaw (about x, y, z, yaw first) -> (N, 4)."""
    roll, pitch, yaw = np.moveaxis(0.5 * rpy_rad, -1, 0)
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def world_to_ned(v: F64, frame: str) -> F64:
    """Vectors given in `frame` (ned, enu, nwu, neu) in NED."""
    if frame == "neu":
        return np.asarray(v * np.array([1.0, 1.0, -1.0]))
    if frame == "enu":
        return np.stack([v[:, 1], v[:, 0], -v[:, 2]], axis=-1)
    return v * np.array([1.0, -1.0, -1.0]) if frame == "nwu" else v


def body_to_frd(v: F64, frame: str) -> F64:
    """Vectors given in `frame` (frd, flu) in FRD."""
    return v * np.array([1.0, -1.0, -1.0]) if frame == "flu" else v


def headings(q: F64) -> F64:
    """(N,) yaw in rad of attitudes (N, 4), scalar first; NED and FRD."""
    w, x, y, z = q.T
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
