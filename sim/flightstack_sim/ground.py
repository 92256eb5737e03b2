"""The ground: a plane at pos_d = 0 under four contact points, at the rotors' places in the CoM's plane.

Along the normal each contact is a spring and a damper that only push (about 13 Hz for the whole vehicle, preloaded so
that the vehicle at rest has its CoM at pos_d = 0).  In the plane Coulomb friction acts as an impulse after the step,
up to what stops the vehicle: it sticks, without creeping, where a smoothed friction force would slide.
"""

from __future__ import annotations

import math

from flightstack.effects import row as at
from flightstack.effects import slung_load
from flightstack.effects.row import Vec
from flightstack.jit import njit
from flightstack.types import F64

FRICTION = 0.7


@njit
def near(p: F64, pos_d: float) -> bool:
    """Whether a contact point may touch at this height of the CoM."""
    return bool(p[at.P_GROUND] != 0.0 and pos_d + p[at.D_GROUND_LEVEL] + p[at.D_GROUND_REACH] > 0.0)


@njit
def push(p: F64, y: F64, down: Vec) -> tuple[float, float, float, float]:
    """The ground's normal force (N, upwards) and its torque (N m) about the body axes.

    `y`: integrated state; `down`: the world's down axis in the body, FRD.
    """
    total = about_x = about_y = about_z = 0.0
    height = y[at.S_POS + 2] + p[at.D_GROUND_LEVEL]
    wx, wy, wz = y[at.S_RATE], y[at.S_RATE + 1], y[at.S_RATE + 2]
    for i in range(4):
        ax, ay = p[at.D_ARM + 3 * i], p[at.D_ARM + 3 * i + 1]  # r = (ax, ay, 0)
        depth = height + down[0] * ax + down[1] * ay
        if depth <= 0.0:
            continue
        sinking = y[at.S_VEL + 2] - down[0] * wz * ay + down[1] * wz * ax + down[2] * (wx * ay - wy * ax)
        force = p[at.D_GROUND_K] * depth + p[at.D_GROUND_C] * sinking
        if force > 0.0:  # the force is -force * down, its torque r x that
            total += force
            about_x -= ay * down[2] * force
            about_y += ax * down[2] * force
            about_z += (ay * down[0] - ax * down[1]) * force
    return (total, about_x, about_y, about_z)


@njit
def stick(p: F64, row: F64, down: Vec) -> None:
    """Coulomb friction over the step just made: on the CoM's horizontal velocity and on the turning about the normal.

    An impulse j spread evenly over the step also takes j dt / 2m off the path: what sticks doesn't creep.
    """
    dt = p[at.P_DT]
    impulse = FRICTION * row[at.S_NORMAL] * dt
    vn, ve = row[at.S_VEL], row[at.S_VEL + 1]
    speed = math.sqrt(vn * vn + ve * ve)
    if speed > 0.0:
        share = min(1.0, impulse / (p[at.D_MASS] * speed))
        dn, de = -share * vn, -share * ve
        row[at.S_VEL] += dn
        row[at.S_VEL + 1] += de
        row[at.S_POS] += 0.5 * dt * dn
        row[at.S_POS + 1] += 0.5 * dt * de
        _add_force(row, dn / dt, de / dt)
        slung_load.follow(p, row, dn, de)
    turning = row[at.S_RATE] * down[0] + row[at.S_RATE + 1] * down[1] + row[at.S_RATE + 2] * down[2]
    if turning != 0.0:
        gx, gy, gz = down[0] / p[at.D_INERTIA], down[1] / p[at.D_INERTIA + 1], down[2] / p[at.D_INERTIA + 2]
        stopping = abs(turning) / (gx * down[0] + gy * down[1] + gz * down[2])  # angular impulse that ends the turning
        twist = -math.copysign(min(stopping, impulse * p[at.D_GROUND_ARM]), turning)
        _turn(row, (twist * gx, twist * gy, twist * gz), dt)


@njit
def _add_force(row: F64, acc_n: float, acc_e: float) -> None:
    """Add a horizontal acceleration (m/s^2, NED) to the specific force in the body."""
    w, x, y, z = row[at.S_Q], row[at.S_Q + 1], row[at.S_Q + 2], row[at.S_Q + 3]
    row[at.S_FORCE] += (1.0 - 2.0 * (y * y + z * z)) * acc_n + 2.0 * (x * y + w * z) * acc_e
    row[at.S_FORCE + 1] += 2.0 * (x * y - w * z) * acc_n + (1.0 - 2.0 * (x * x + z * z)) * acc_e
    row[at.S_FORCE + 2] += 2.0 * (x * z + w * y) * acc_n + 2.0 * (y * z - w * x) * acc_e


@njit
def _turn(row: F64, change: Vec, dt: float) -> None:
    """Change the body rates (rad/s, FRD), and the attitude by half of that over dt."""
    for axis in range(3):
        row[at.S_RATE + axis] += change[axis]
        row[at.S_ANGULAR + axis] += change[axis] / dt
    hx, hy, hz = 0.25 * dt * change[0], 0.25 * dt * change[1], 0.25 * dt * change[2]  # q (x) (1, h)
    w, x, y, z = row[at.S_Q], row[at.S_Q + 1], row[at.S_Q + 2], row[at.S_Q + 3]
    row[at.S_Q] -= x * hx + y * hy + z * hz
    row[at.S_Q + 1] += w * hx + y * hz - z * hy
    row[at.S_Q + 2] += w * hy + z * hx - x * hz
    row[at.S_Q + 3] += w * hz + x * hy - y * hx
