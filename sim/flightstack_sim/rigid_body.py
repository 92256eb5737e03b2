"""Six degrees of freedom: the equations that sum what the effects contribute, and their integration.

    pos' = vel      m vel' = m g + R f + f_world      q' = q (x) (0, omega) / 2      I omega' = tau - omega x I omega

The classic Runge-Kutta method of fourth order integrates them; motors (exactly), gusts (exactly), battery and
friction (both once a step) stand beside it.  The order in which the effects act is in docs/physics.md.
"""

from __future__ import annotations

import math

from flightstack.effects import battery_sag, rotor_gyroscopic, slung_load, thrust_curve, transport_delay, turbulence
from flightstack.effects import row as at
from flightstack.effects.row import Vec
from flightstack.jit import njit
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_sim import composed, ground
from flightstack_sim.battery import discharge

_G = STANDARD_GRAVITY_MPS2
_STANDING = 1e-9
"""A motor commanded to 0 stands below this; its lag would go on through ever smaller numbers."""
Quad = tuple[float, float, float, float]


@njit
def _rotor_thrust(p: F64, rotor: int, curve_n: float, sag: float, hub_air: Vec, height_m: float) -> float:
    """Thrust (N) of one rotor: static curve, translational lift, then everything that multiplies."""
    thrust = composed.added_thrust(curve_n, p, curve_n, hub_air)
    thrust *= p[at.D_GAIN + rotor] * sag
    return float(composed.thrust(thrust, p, hub_air, height_m))


@njit
def _rotor(
    p: F64, i: int, height: float, speed: float, sag: float, motion: tuple[Vec, Vec, Vec], out: F64
) -> tuple[Vec, Vec, float]:
    """Force (N), torque (N m), both FRD, and angular momentum (N m s) of one rotor; its thrust goes to `out`."""
    ax, ay, az = p[at.D_ARM + 3 * i], p[at.D_ARM + 3 * i + 1], p[at.D_ARM + 3 * i + 2]
    air, (wx, wy, wz), down = motion
    hub_air = (air[0] + wy * az - wz * ay, air[1] + wz * ax - wx * az, air[2] + wx * ay - wy * ax)
    hub_height = height - (down[0] * ax + down[1] * ay + down[2] * az)
    thrust = _rotor_thrust(p, i, p[at.P_MAX_THRUST] * speed * speed, sag, hub_air, hub_height)
    out[at.E_THRUST + i] = thrust
    speed *= p[at.P_MAX_SPEED]
    fx, fy, fz = composed.hub_force((0.0, 0.0, -thrust), p, speed, hub_air)
    lever = (ay * fz - az * fy, az * fx - ax * fz, ax * fy - ay * fx + p[at.P_TORQUE_RATIO + i] * thrust)
    torque = composed.hub_torque(lever, p, speed, hub_air)
    return (fx, fy, fz), torque, rotor_gyroscopic.momentum(p, i, speed)


@njit
def _rotors(p: F64, y: F64, speeds: Quad, sag: float, air: Vec, down: Vec, out: F64) -> tuple[Vec, Vec]:
    """Force (N) and torque (N m) of the four rotors, FRD; `speeds` are shares of the greatest."""
    height = -y[at.S_POS + 2]
    rate = (y[at.S_RATE], y[at.S_RATE + 1], y[at.S_RATE + 2])
    motion = air, rate, down
    f1, t1, h1 = _rotor(p, 0, height, speeds[at.M1], sag, motion, out)
    f2, t2, h2 = _rotor(p, 1, height, speeds[at.M2], sag, motion, out)
    f3, t3, h3 = _rotor(p, 2, height, speeds[at.M3], sag, motion, out)
    f4, t4, h4 = _rotor(p, 3, height, speeds[at.M4], sag, motion, out)
    turn = rotor_gyroscopic.torque(h1 + h2 + h3 + h4, rate[0], rate[1])
    force = (f1[0] + f2[0] + f3[0] + f4[0], f1[1] + f2[1] + f3[1] + f4[1], f1[2] + f2[2] + f3[2] + f4[2])
    torque = (
        t1[0] + t2[0] + t3[0] + t4[0] + turn[0],
        t1[1] + t2[1] + t3[1] + t4[1] + turn[1],
        t1[2] + t2[2] + t3[2] + t4[2],
    )
    return force, torque


@njit
def rotor_speeds(p: F64, u: Quad) -> Quad:
    """Speeds of the four rotors as shares of the greatest, after the static curve: their squares are the thrusts'."""
    f = p[at.D_FACTOR]
    return (
        math.sqrt(thrust_curve.share(u[at.M1], f)),
        math.sqrt(thrust_curve.share(u[at.M2], f)),
        math.sqrt(thrust_curve.share(u[at.M3], f)),
        math.sqrt(thrust_curve.share(u[at.M4], f)),
    )


@njit
def _to_body(q: F64, v: Vec) -> Vec:
    """R^T v; `q` is the integrated state, its quaternion at S_Q."""
    w, x, y, z = q[at.S_Q], q[at.S_Q + 1], q[at.S_Q + 2], q[at.S_Q + 3]
    return (
        (1.0 - 2.0 * (y * y + z * z)) * v[0] + 2.0 * (x * y + w * z) * v[1] + 2.0 * (x * z - w * y) * v[2],
        2.0 * (x * y - w * z) * v[0] + (1.0 - 2.0 * (x * x + z * z)) * v[1] + 2.0 * (y * z + w * x) * v[2],
        2.0 * (x * z + w * y) * v[0] + 2.0 * (y * z - w * x) * v[1] + (1.0 - 2.0 * (x * x + y * y)) * v[2],
    )


@njit
def _to_world(q: F64, v: Vec) -> Vec:
    """R v."""
    w, x, y, z = q[at.S_Q], q[at.S_Q + 1], q[at.S_Q + 2], q[at.S_Q + 3]
    return (
        (1.0 - 2.0 * (y * y + z * z)) * v[0] + 2.0 * (x * y - w * z) * v[1] + 2.0 * (x * z + w * y) * v[2],
        2.0 * (x * y + w * z) * v[0] + (1.0 - 2.0 * (x * x + z * z)) * v[1] + 2.0 * (y * z - w * x) * v[2],
        2.0 * (x * z - w * y) * v[0] + 2.0 * (y * z + w * x) * v[1] + (1.0 - 2.0 * (x * x + y * y)) * v[2],
    )


@njit
def _down(q: F64) -> Vec:
    """The world's down axis in the body."""
    w, x, y, z = q[at.S_Q], q[at.S_Q + 1], q[at.S_Q + 2], q[at.S_Q + 3]
    return (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))


@njit
def evaluate(p: F64, y: F64, speeds: Quad, wind: Vec, sag: float, dy: F64) -> None:
    """All forces and torques at one state: its derivative, specific force, thrusts and the ground's push into `dy`.

    `y`: (INTEGRATED,) state; `speeds`: `rotor_speeds`; `wind`: NED, m/s; `sag`: the battery's thrust factor;
    `dy`: (EVALUATED,).
    """
    air = _to_body(y, (y[at.S_VEL] - wind[0], y[at.S_VEL + 1] - wind[1], y[at.S_VEL + 2] - wind[2]))
    rate = (y[at.S_RATE], y[at.S_RATE + 1], y[at.S_RATE + 2])
    down = _down(y)
    rotor_force, rotor_torque = _rotors(p, y, speeds, sag, air, down, dy)
    tx, ty, tz = composed.body_torque(rotor_torque, p, rate)
    fn, fe, fd = composed.world_force(_to_world(y, composed.body_force(rotor_force, p, air)), p)
    dy[at.E_NORMAL] = 0.0
    if ground.near(p, y[at.S_POS + 2]):
        normal, about_x, about_y, about_z = ground.push(p, y, down)
        dy[at.E_NORMAL] = normal
        fd -= normal
        tx, ty, tz = tx + about_x, ty + about_y, tz + about_z
    mass = p[at.D_MASS]
    pull = slung_load.pull(p, y, (fn, fe, fd + mass * _G), dy)
    an, ae, ad = (fn + pull[0]) / mass, (fe + pull[1]) / mass, (fd + pull[2]) / mass
    dy[at.E_FORCE], dy[at.E_FORCE + 1], dy[at.E_FORCE + 2] = _to_body(y, (an, ae, ad))
    dy[at.S_POS], dy[at.S_POS + 1], dy[at.S_POS + 2] = y[at.S_VEL], y[at.S_VEL + 1], y[at.S_VEL + 2]
    dy[at.S_VEL], dy[at.S_VEL + 1], dy[at.S_VEL + 2] = an, ae, ad + _G
    _turning(p, y, rate, (tx, ty, tz), dy)


@njit
def _turning(p: F64, y: F64, rate: Vec, torque: Vec, dy: F64) -> None:
    """Kinematics of the quaternion and Euler's equations."""
    wx, wy, wz = rate
    q0, q1, q2, q3 = y[at.S_Q], y[at.S_Q + 1], y[at.S_Q + 2], y[at.S_Q + 3]
    dy[at.S_Q] = 0.5 * (-q1 * wx - q2 * wy - q3 * wz)
    dy[at.S_Q + 1] = 0.5 * (q0 * wx + q2 * wz - q3 * wy)
    dy[at.S_Q + 2] = 0.5 * (q0 * wy + q3 * wx - q1 * wz)
    dy[at.S_Q + 3] = 0.5 * (q0 * wz + q1 * wy - q2 * wx)
    ix, iy, iz = p[at.D_INERTIA], p[at.D_INERTIA + 1], p[at.D_INERTIA + 2]
    dy[at.S_RATE] = (torque[0] + (iy - iz) * wy * wz) / ix
    dy[at.S_RATE + 1] = (torque[1] + (iz - ix) * wz * wx) / iy
    dy[at.S_RATE + 2] = (torque[2] + (ix - iy) * wx * wy) / iz


@njit
def air_velocity(p: F64, row: F64) -> Vec:
    """Velocity of the air (m/s, NED) at the vehicle, kept in the row's outputs."""
    wind: Vec = composed.wind(turbulence.gust(p, row), p)
    row[at.S_WIND], row[at.S_WIND + 1], row[at.S_WIND + 2] = wind
    return wind


@njit
def lagged(target: Quad, now: Quad, left: float) -> Quad:
    """Motors on their way to `target` when this share of the distance is left."""
    return (
        target[at.M1] + (now[at.M1] - target[at.M1]) * left,
        target[at.M2] + (now[at.M2] - target[at.M2]) * left,
        target[at.M3] + (now[at.M3] - target[at.M3]) * left,
        target[at.M4] + (now[at.M4] - target[at.M4]) * left,
    )


@njit
def standing(target: float, now: float) -> float:
    """A motor's speed after a step; one that is commanded to 0 stands at last."""
    return now if target != 0.0 or now > _STANDING else 0.0


@njit
def _integrate(p: F64, row: F64, start: Quad, middle: Quad, end: Quad, work: F64) -> None:
    """One Runge-Kutta step of the row; `start`, `middle`, `end`: the rotors' speeds then; `work`: (3, EVALUATED).

    work[2] ends as the step's mean derivative and outputs, work[1] as those at its last stage.
    """
    h = p[at.P_DT]
    y, dy, mean = work[0], work[1], work[2]
    wind = air_velocity(p, row)
    sag = battery_sag.factor(p, row[at.S_VOLTAGE])
    for j in range(at.INTEGRATED):
        y[j] = row[j]
    evaluate(p, y, start, wind, sag, dy)
    for j in range(at.E_THRUST):
        mean[j] = dy[j] / 6.0
    for stage in range(3):
        reach = 0.5 * h if stage < 2 else h
        weight = 1.0 / 3.0 if stage < 2 else 1.0 / 6.0
        for j in range(at.INTEGRATED):
            y[j] = row[j] + reach * dy[j]
        evaluate(p, y, middle if stage < 2 else end, wind, sag, dy)
        for j in range(at.E_THRUST):
            mean[j] += weight * dy[j]
    for j in range(at.INTEGRATED):
        row[j] += h * mean[j]


@njit
def step_row(p: F64, row: F64, work: F64) -> None:
    """One step of one vehicle, in place; the row's command is held over it, its normals drive the gusts."""
    transport_delay.push(row)
    target = (
        transport_delay.delayed(p, row, 0),
        transport_delay.delayed(p, row, 1),
        transport_delay.delayed(p, row, 2),
        transport_delay.delayed(p, row, 3),
    )
    start = (row[at.S_U], row[at.S_U + 1], row[at.S_U + 2], row[at.S_U + 3])
    if p[at.D_TAU] == 0.0:
        start = target
    end = lagged(target, start, p[at.D_LAG_FULL])
    turbulence.advance(p, row)
    middle = lagged(target, start, p[at.D_LAG_HALF])
    _integrate(p, row, rotor_speeds(p, start), rotor_speeds(p, middle), rotor_speeds(p, end), work)
    dy, mean = work[1], work[2]
    for j in range(3):
        row[at.S_FORCE + j] = mean[at.E_FORCE + j]
        row[at.S_ANGULAR + j] = mean[at.S_RATE + j]
    for i in range(4):
        row[at.S_THRUST + i] = dy[at.E_THRUST + i]
        row[at.S_U + i] = standing(target[i], end[i])
    row[at.S_NORMAL] = mean[at.E_NORMAL]
    if row[at.S_NORMAL] > 0.0:
        ground.stick(p, row, _down(row))
    normalise(row)
    slung_load.constrain(p, row)
    discharge(p, row)


@njit
def normalise(row: F64) -> None:
    """Bring the attitude's quaternion back to unit length."""
    w, x, y, z = row[at.S_Q], row[at.S_Q + 1], row[at.S_Q + 2], row[at.S_Q + 3]
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    row[at.S_Q], row[at.S_Q + 1], row[at.S_Q + 2], row[at.S_Q + 3] = w / norm, x / norm, y / norm, z / norm
