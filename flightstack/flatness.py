"""Differential flatness: position and yaw with their derivatives <-> thrust, attitude and body rates.

The vehicle is a point mass with a thrust axis and linear drag (NED, FRD, z_b the body's down axis, thrust T >= 0):
    a = g z_w - (T / m) z_b - (1/m) R D R^T v + d
with d an acceleration that somebody learned (zero otherwise).  Let t = g z_w - a + d - (d_xy / m) v, d_xy the mean of
the drag along body x and y.  Then z_b = t / |t| and T = m |t| - (d_z - d_xy) <z_b, v>: where D = diag(d, d, d_z) this
is exact, because D acts like d everywhere plus (d_z - d) along the thrust axis, which thrust itself cancels
(M. Faessler, A. Franchi, D. Scaramuzza, "Differential Flatness of Quadrotor Dynamics Subject to Rotor Drag for
Accurate Tracking of High-Speed Trajectories", 2018).  Without drag it is the paper's f_FF = -m |a - d - g z_w|.

Attitude.  x_b is the direction of y_c x z_b, y_c = (-sin psi, cos psi, 0): what the paper's
theta = atan2(beta_a, beta_b), phi = atan2(beta_c, sqrt(beta_a^2 + beta_b^2)) says, without its angles, hence without
tan and sec.  Body rates and their derivatives come from d/dt of the three axes.
Heading is undefined only where z_b lies along y_c (rolled by 90 degrees).  Within 3 degrees of that the body x axis
is the hint's, projected onto the plane of the rotors and carried along without turning about z_b; once z_b points
upwards the sign of x_b is the hint's too, so that a roll through 90 degrees and beyond is continuous.  The hint is the
body's present x axis (or the heading itself).  In free fall (|t| below 0.1 m/s^2) the thrust axis is the hint's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.frames import matrix_to_quat, quat_to_matrix
from flightstack.jit import njit
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, FlatOutput, Tuple3

_FREE_FALL_MPS2 = 0.1
_HEADING_SINE = 0.05
_NO_DRAG: Tuple3 = (0.0, 0.0, 0.0)
_ZERO3 = np.zeros(3)
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class BodyMotion:
    """What the vehicle must do to follow a flat output."""

    thrust_n: float
    """Total thrust along body -z, newton; 0 or more wherever thrust can do it."""
    thrust_rate_nps: float
    q_ned_frd: F64
    """(4,) attitude."""
    rate_frd_radps: F64
    """(3,) body rates."""
    angular_acceleration_frd_radps2: F64
    """(3,) time derivative of the body rates (yaw acceleration taken as zero)."""


@dataclass(frozen=True, slots=True, eq=False)
class FlatMotion:
    """What a flying vehicle's attitude, rates and thrust say about its flat outputs."""

    acc_ned_mps2: F64
    jerk_ned_mps3: F64
    yaw_rad: float
    yaw_rate_radps: float


def to_body(
    point: FlatOutput,
    *,
    mass_kg: float,
    drag_kgps: Tuple3 = _NO_DRAG,
    learned_acc_ned_mps2: F64 = _ZERO3,
    learned_jerk_ned_mps3: F64 = _ZERO3,
    hint_q_ned_frd: F64 = _UPRIGHT,
    gravity_mps2: float = STANDARD_GRAVITY_MPS2,
) -> BodyMotion:
    """Thrust (N), attitude, body rates (rad/s) and angular acceleration for one point of a reference.

    `learned_acc_ned_mps2` (3,) is the acceleration that the model does not explain and `learned_jerk_ned_mps3` its
    time derivative: they are fed forward.  `hint_q_ned_frd` (4,) settles the heading where the reference leaves it
    open.  Finite for every finite input.
    """
    out = np.empty(_OUT)
    _to_body(
        (point.vel_ned_mps, point.acc_ned_mps2, point.jerk_ned_mps3, point.snap_ned_mps4),
        (float(point.yaw_rad), float(point.yaw_rate_radps)),
        (np.asarray(learned_acc_ned_mps2, dtype=np.float64), np.asarray(learned_jerk_ned_mps3, dtype=np.float64)),
        np.asarray(hint_q_ned_frd, dtype=np.float64), mass_kg, np.asarray(drag_kgps, dtype=np.float64), gravity_mps2,
        out,
    )  # fmt: skip
    return BodyMotion(
        thrust_n=float(out[0]),
        thrust_rate_nps=float(out[1]),
        q_ned_frd=matrix_to_quat(np.ascontiguousarray(out[8:17].reshape(3, 3))),
        rate_frd_radps=out[2:5].copy(),
        angular_acceleration_frd_radps2=out[5:8].copy(),
    )


def to_flat(
    motion: BodyMotion,
    *,
    mass_kg: float,
    vel_ned_mps: F64 = _ZERO3,
    drag_kgps: Tuple3 = _NO_DRAG,
    learned_acc_ned_mps2: F64 = _ZERO3,
    learned_jerk_ned_mps3: F64 = _ZERO3,
) -> FlatMotion:
    """Acceleration, jerk, yaw and yaw rate of a vehicle with this attitude, rates and thrust: the way back.

    Exact for any drag table (it uses the full R D R^T).
    """
    thrust_n, thrust_rate_nps = motion.thrust_n, motion.thrust_rate_nps
    r = quat_to_matrix(np.asarray(motion.q_ned_frd, dtype=np.float64))
    wx, wy, wz = (float(value) for value in motion.rate_frd_radps)
    turn = r @ np.array([[0.0, -wz, wy], [wz, 0.0, -wx], [-wy, wx, 0.0]])
    drag = np.diag(drag_kgps)
    down = np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
    acc = down + learned_acc_ned_mps2 - (thrust_n * r[:, 2] + r @ drag @ r.T @ vel_ned_mps) / mass_kg
    drag_rate = (turn @ drag @ r.T + r @ drag @ turn.T) @ vel_ned_mps + r @ drag @ r.T @ acc
    jerk = learned_jerk_ned_mps3 - (thrust_rate_nps * r[:, 2] + thrust_n * turn[:, 2] + drag_rate) / mass_kg
    forward, forward_rate = r[:2, 0], turn[:2, 0]
    horizontal = max(float(forward @ forward), 1e-12)
    return FlatMotion(
        acc_ned_mps2=acc,
        jerk_ned_mps3=jerk,
        yaw_rad=math.atan2(forward[1], forward[0]),
        yaw_rate_radps=float(forward[0] * forward_rate[1] - forward[1] * forward_rate[0]) / horizontal,
    )


_OUT, _THRUST, _RATE, _ANGULAR = 17, 0, 2, 5
"""Flat result of the compiled map: thrust, its rate, body rates (3), angular accelerations (3), R (9, row by row)."""


# A vector with its first two time derivatives is a (3, 3) array: order, axis.


@njit
def _dot(a: F64, b: F64) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]


@njit
def _add_cross(scale: float, a: F64, b: F64, out: F64) -> None:
    out[0] += scale * (a[1] * b[2] - a[2] * b[1])
    out[1] += scale * (a[2] * b[0] - a[0] * b[2])
    out[2] += scale * (a[0] * b[1] - a[1] * b[0])


@njit
def _cross(a: F64, b: F64) -> F64:
    """Cross product with its derivatives (Leibniz); (3, 3), (3, 3) -> (3, 3)."""
    out = np.zeros((3, 3))
    _add_cross(1.0, a[0], b[0], out[0])
    _add_cross(1.0, a[1], b[0], out[1])
    _add_cross(1.0, a[0], b[1], out[1])
    _add_cross(1.0, a[2], b[0], out[2])
    _add_cross(2.0, a[1], b[1], out[2])
    _add_cross(1.0, a[0], b[2], out[2])
    return out


@njit
def _unit(v: F64, size: float) -> F64:
    """v / size with its derivatives, size = |v| or -|v|; (3, 3) -> (3, 3)."""
    out = np.empty((3, 3))
    for i in range(3):
        out[0, i] = v[0, i] / size
    first = _dot(out[0], v[1])
    for i in range(3):
        out[1, i] = (v[1, i] - first * out[0, i]) / size
    second = _dot(out[1], v[1]) + _dot(out[0], v[2])
    for i in range(3):
        out[2, i] = (v[2, i] - 2.0 * first * out[1, i] - second * out[0, i]) / size
    return out


@njit
def _to_body(
    motion: tuple[F64, F64, F64, F64], heading: tuple[float, float], unexplained: tuple[F64, F64],
    hint_q: F64, mass: float, drag: F64, gravity: float, out: F64,
) -> None:  # fmt: skip
    """The map of the module's header; `out` (17,) as _OUT says.

    motion: velocity to snap; heading: yaw and its rate; unexplained: acceleration and jerk.
    """
    (vel, acc, jerk, snap), (yaw, yaw_rate), (learned, learned_rate) = motion, heading, unexplained
    hint = quat_to_matrix(hint_q)
    d = 0.5 * (drag[0] + drag[1]) / mass
    t = np.empty((3, 3))
    for i in range(3):
        t[0, i] = learned[i] - acc[i] - d * vel[i]
        t[1, i] = learned_rate[i] - jerk[i] - d * acc[i]
        t[2, i] = -snap[i] - d * jerk[i]
    t[0, 2] += gravity
    size = math.sqrt(_dot(t[0], t[0]))
    if size < _FREE_FALL_MPS2:
        z = np.zeros((3, 3))
        for i in range(3):
            z[0, i] = hint[i, 2]
    else:
        z = _unit(t, size)
    extra = drag[2] - 0.5 * (drag[0] + drag[1])
    out[_THRUST] = mass * size - extra * _dot(z[0], vel)
    out[_THRUST + 1] = mass * _dot(z[0], t[1]) - extra * (_dot(z[1], vel) + _dot(z[0], acc))
    x = _forward(z, yaw, yaw_rate, hint)
    y = _cross(z, x)
    out[_RATE] = -_dot(y[0], z[1])
    out[_RATE + 1] = _dot(x[0], z[1])
    out[_RATE + 2] = _dot(y[0], x[1])
    out[_ANGULAR] = -_dot(y[1], z[1]) - _dot(y[0], z[2])
    out[_ANGULAR + 1] = _dot(x[1], z[1]) + _dot(x[0], z[2])
    out[_ANGULAR + 2] = _dot(y[1], x[1]) + _dot(y[0], x[2])
    for i in range(3):
        out[8 + 3 * i] = x[0, i]
        out[9 + 3 * i] = y[0, i]
        out[10 + 3 * i] = z[0, i]


@njit
def _forward(z: F64, yaw: float, yaw_rate: float, hint: F64) -> F64:
    """Body x axis with its derivatives for a thrust axis with its own, a heading and the hint's axes (columns)."""
    c, s = math.cos(yaw), math.sin(yaw)
    east = np.zeros((3, 3))
    east[0, 0], east[0, 1] = -s, c
    east[1, 0], east[1, 1] = -c * yaw_rate, -s * yaw_rate
    east[2, 0], east[2, 1] = s * yaw_rate * yaw_rate, -c * yaw_rate * yaw_rate
    cross = _cross(east, z)
    size = math.sqrt(_dot(cross[0], cross[0]))
    if size < _HEADING_SINE:
        return _carried(z, c, s, hint)
    if z[0, 2] < 0.0 and cross[0, 0] * hint[0, 0] + cross[0, 1] * hint[1, 0] + cross[0, 2] * hint[2, 0] < 0.0:
        size = -size
    return _unit(cross, size)


@njit
def _carried(z: F64, cosine: float, sine: float, hint: F64) -> F64:
    """Where heading is undefined: the hint's x axis (else the heading) projected, carried along without turning."""
    x = np.zeros((3, 3))
    x[0, 0], x[0, 1], x[0, 2] = hint[0, 0], hint[1, 0], hint[2, 0]
    if abs(_dot(x[0], z[0])) > 1.0 - 1e-9:  # the hint's x axis is this z axis; the heading is nearly normal to it here
        x[0, 0], x[0, 1], x[0, 2] = cosine, sine, 0.0
    along = _dot(x[0], z[0])
    for i in range(3):
        x[0, i] -= along * z[0, i]
    size = math.sqrt(_dot(x[0], x[0]))
    for i in range(3):
        x[0, i] /= size
    first, second = _dot(x[0], z[1]), _dot(x[0], z[2])
    for i in range(3):
        x[1, i] = -first * z[0, i]
    cross = _dot(x[1], z[1])
    for i in range(3):
        x[2, i] = -(second + cross) * z[0, i] - first * z[1, i]
    return x
