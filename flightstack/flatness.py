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

from flightstack.frames import Rows3, matrix_to_quat, quat_to_matrix, rotation
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
    (thrust, thrust_rate), rate, angular, axes = _to_body(
        (point.vel_ned_mps, point.acc_ned_mps2, point.jerk_ned_mps3, point.snap_ned_mps4),
        (float(point.yaw_rad), float(point.yaw_rate_radps)),
        (np.asarray(learned_acc_ned_mps2, dtype=np.float64), np.asarray(learned_jerk_ned_mps3, dtype=np.float64)),
        rotation(np.asarray(hint_q_ned_frd, dtype=np.float64)), mass_kg, np.asarray(drag_kgps, dtype=np.float64),
        gravity_mps2,
    )  # fmt: skip
    return BodyMotion(
        thrust_n=thrust,
        thrust_rate_nps=thrust_rate,
        q_ned_frd=matrix_to_quat(np.array(axes).T.copy()),
        rate_frd_radps=np.array(rate),
        angular_acceleration_frd_radps2=np.array(angular),
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


@njit
def _dot(a: Tuple3, b: Tuple3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def _added(onto: Tuple3, scale: float, a: Tuple3, b: Tuple3) -> Tuple3:
    """onto + scale a x b."""
    return (
        onto[0] + scale * (a[1] * b[2] - a[2] * b[1]),
        onto[1] + scale * (a[2] * b[0] - a[0] * b[2]),
        onto[2] + scale * (a[0] * b[1] - a[1] * b[0]),
    )


@njit
def _cross(a: Rows3, b: Rows3) -> Rows3:
    """Cross product of two vectors with their derivatives (Leibniz)."""
    none = (0.0, 0.0, 0.0)
    first = _added(_added(none, 1.0, a[1], b[0]), 1.0, a[0], b[1])
    second = _added(_added(_added(none, 1.0, a[2], b[0]), 2.0, a[1], b[1]), 1.0, a[0], b[2])
    return _added(none, 1.0, a[0], b[0]), first, second


@njit
def _unit(v: Rows3, size: float) -> Rows3:
    """v / size with its derivatives, size = |v| or -|v|."""
    u = (v[0][0] / size, v[0][1] / size, v[0][2] / size)
    first = _dot(u, v[1])
    w = ((v[1][0] - first * u[0]) / size, (v[1][1] - first * u[1]) / size, (v[1][2] - first * u[2]) / size)
    second = _dot(w, v[1]) + _dot(u, v[2])
    x = (v[2][0] - 2.0 * first * w[0] - second * u[0]) / size
    y = (v[2][1] - 2.0 * first * w[1] - second * u[1]) / size
    z = (v[2][2] - 2.0 * first * w[2] - second * u[2]) / size
    return u, w, (x, y, z)


@njit
def _to_body(
    motion: tuple[F64, F64 | Tuple3, F64, F64], heading: tuple[float, float], unexplained: tuple[F64, F64],
    hint: Rows3, mass: float, drag: F64, gravity: float,
) -> tuple[tuple[float, float], Tuple3, Tuple3, Rows3]:  # fmt: skip
    """The map of the module's header: thrust and its rate, body rates, their derivatives, body axes x, y, z.

    motion: velocity to snap; heading: yaw and its rate; unexplained: acceleration and jerk; hint: a rotation matrix.
    Plain numbers: nothing is allocated.
    """
    (vel, acc, jerk, snap), (yaw, yaw_rate), (learned, learned_rate) = motion, heading, unexplained
    d = 0.5 * (drag[0] + drag[1]) / mass
    t = (
        (
            learned[0] - acc[0] - d * vel[0],
            learned[1] - acc[1] - d * vel[1],
            learned[2] - acc[2] - d * vel[2] + gravity,
        ),
        (
            learned_rate[0] - jerk[0] - d * acc[0],
            learned_rate[1] - jerk[1] - d * acc[1],
            learned_rate[2] - jerk[2] - d * acc[2],
        ),
        (-snap[0] - d * jerk[0], -snap[1] - d * jerk[1], -snap[2] - d * jerk[2]),
    )
    size, none = math.sqrt(_dot(t[0], t[0])), (0.0, 0.0, 0.0)
    z = ((hint[0][2], hint[1][2], hint[2][2]), none, none)
    if not size < _FREE_FALL_MPS2:
        z = _unit(t, size)
    extra = drag[2] - 0.5 * (drag[0] + drag[1])
    speed, change = (vel[0], vel[1], vel[2]), (acc[0], acc[1], acc[2])
    thrust = mass * size - extra * _dot(z[0], speed)
    thrust_rate = mass * _dot(z[0], t[1]) - extra * (_dot(z[1], speed) + _dot(z[0], change))
    x = _forward(z, yaw, yaw_rate, hint)
    y = _cross(z, x)
    rate = (-_dot(y[0], z[1]), _dot(x[0], z[1]), _dot(y[0], x[1]))
    angular = (
        -_dot(y[1], z[1]) - _dot(y[0], z[2]),
        _dot(x[1], z[1]) + _dot(x[0], z[2]),
        _dot(y[1], x[1]) + _dot(y[0], x[2]),
    )
    return (thrust, thrust_rate), rate, angular, (x[0], y[0], z[0])


@njit
def _forward(z: Rows3, yaw: float, yaw_rate: float, hint: Rows3) -> Rows3:
    """Body x axis with its derivatives for a thrust axis with its own, a heading and the hint's axes (columns)."""
    c, s = math.cos(yaw), math.sin(yaw)
    east = (
        (-s, c, 0.0),
        (-c * yaw_rate, -s * yaw_rate, 0.0),
        (s * yaw_rate * yaw_rate, -c * yaw_rate * yaw_rate, 0.0),
    )
    cross = _cross(east, z)
    size = math.sqrt(_dot(cross[0], cross[0]))
    if size < _HEADING_SINE:
        return _carried(z, c, s, hint)
    if z[0][2] < 0.0 and cross[0][0] * hint[0][0] + cross[0][1] * hint[1][0] + cross[0][2] * hint[2][0] < 0.0:
        size = -size
    return _unit(cross, size)


@njit
def _carried(z: Rows3, cosine: float, sine: float, hint: Rows3) -> Rows3:
    """Where heading is undefined: the hint's x axis (else the heading) projected, carried along without turning."""
    x = (hint[0][0], hint[1][0], hint[2][0])
    if abs(_dot(x, z[0])) > 1.0 - 1e-9:  # the hint's x axis is this z axis; the heading is nearly normal to it here
        x = (cosine, sine, 0.0)
    x = _less(x, _dot(x, z[0]), z[0])
    size = math.sqrt(_dot(x, x))
    x = (x[0] / size, x[1] / size, x[2] / size)
    first, second = _dot(x, z[1]), _dot(x, z[2])
    turned = (-first * z[0][0], -first * z[0][1], -first * z[0][2])
    along = -(second + _dot(turned, z[1]))
    return x, turned, _less((along * z[0][0], along * z[0][1], along * z[0][2]), first, z[1])


@njit
def _less(a: Tuple3, share: float, b: Tuple3) -> Tuple3:
    """a - share b."""
    return a[0] - share * b[0], a[1] - share * b[1], a[2] - share * b[2]
