"""The blind flights themselves: a plant, the pilot of `gap_pilot` and what no effect of the table explains, at 1 ms.

What is outside the table acts here only, on the plant's rows from outside: a tether, a local jet of air, a magnet that
turns the vehicle, a sloshing liquid, thrust that fades, a force that comes and goes, the wake of another
vehicle.  The simulator and the workflow know none of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.gap_pilot import M_SIZE, OUTER_US, believed_row, inner, outer
from flightstack.effects import turbulence
from flightstack.effects.row import (
    D_GAIN,
    D_INERTIA,
    EVALUATED,
    PLACES,
    S_ANGULAR,
    S_COMMAND,
    S_FORCE,
    S_NORMAL,
    S_NORMALS,
    S_POS,
    S_Q,
    S_RATE,
    S_VEL,
    S_VOLTAGE,
)
from flightstack.frames import quat_multiply
from flightstack.jit import njit
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_sim.plant import NativePlant, Plant
from flightstack_sim.rigid_body import step_row

DT_US = 1000
_NORTH = PLACES["constant_force", "north_n"]

# --- outside the table: one row, zero where absent
X_TETHER = 0  # anchor (3), free length m, stiffness N/m
X_JET = 5  # centre north, east, radius m, force (3) N
X_MAGNET = 11  # torque N m at right angles to the field, direction of the field (rad from north)
X_SLOSH = 13  # mass kg, angular frequency rad/s, damping ratio
X_FADE = 16  # share of thrust lost per second
X_PERIODIC = 17  # force (3) N, angular frequency rad/s
X_WAKE = 21  # centre north, east, radius m, force down N, swirl N m
X_SIZE = 26

# --- the log of a flight, one row a millisecond
L_POS, L_VEL, L_Q, L_RATE, L_FORCE, L_MOTOR, L_VOLTAGE, L_NORMAL, L_ANGULAR = 0, 3, 6, 10, 13, 16, 20, 21, 22
L_SIZE = 25


@dataclass(frozen=True, slots=True)
class Senses:
    """White noise (one standard deviation) of what the pilot flies on."""

    pos_m: float = 0.003
    vel_mps: float = 0.02
    rate_radps: float = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A flight as it really was, every millisecond."""

    rows: F64
    """(n, L_SIZE); position, velocity, attitude and rates at the end of the millisecond, specific force its mean."""
    crashed: bool


@njit
def _tether(x: F64, row: F64, force: F64) -> None:
    stiffness = x[X_TETHER + 4]
    if stiffness == 0.0:
        return
    dn = row[S_POS] - x[X_TETHER]
    de = row[S_POS + 1] - x[X_TETHER + 1]
    dd = row[S_POS + 2] - x[X_TETHER + 2]
    length = math.sqrt(dn * dn + de * de + dd * dd)
    if length > x[X_TETHER + 3]:
        pull = -stiffness * (length - x[X_TETHER + 3]) / length
        force[0] += pull * dn
        force[1] += pull * de
        force[2] += pull * dd


@njit
def _jet(x: F64, row: F64, force: F64) -> None:
    if x[X_JET + 2] == 0.0:
        return
    dn, de = row[S_POS] - x[X_JET], row[S_POS + 1] - x[X_JET + 1]
    share = math.exp(-0.5 * (dn * dn + de * de) / (x[X_JET + 2] * x[X_JET + 2]))
    for j in range(3):
        force[j] += share * x[X_JET + 3 + j]


@njit
def _periodic(x: F64, t_s: float, force: F64) -> None:
    for j in range(3):
        force[j] += x[X_PERIODIC + j] * math.sin(x[X_PERIODIC + 3] * t_s)


@njit
def _wake(p: F64, x: F64, row: F64, dt: float, force: F64) -> None:
    """Down and round below another vehicle's rotors: pushes down, and turns about body z."""
    if x[X_WAKE + 2] == 0.0:
        return
    dn, de = row[S_POS] - x[X_WAKE], row[S_POS + 1] - x[X_WAKE + 1]
    share = math.exp(-0.5 * (dn * dn + de * de) / (x[X_WAKE + 2] * x[X_WAKE + 2]))
    force[2] += share * x[X_WAKE + 3]
    turn = share * x[X_WAKE + 4] / p[D_INERTIA + 2]
    row[S_RATE + 2] += dt * turn
    row[S_ANGULAR + 2] += turn


@njit
def _slosh(x: F64, row: F64, state: F64, dt: float, force: F64) -> None:
    """A mass on springs along body x and y; `state` (4,) its place and speed; the file's mass holds it already."""
    if x[X_SLOSH] == 0.0:
        return
    w = x[X_SLOSH + 1]
    push = np.empty(2)
    for j in range(2):
        acceleration = -w * w * state[j] - 2.0 * x[X_SLOSH + 2] * w * state[2 + j] - row[S_FORCE + j]
        state[2 + j] += acceleration * dt
        state[j] += state[2 + j] * dt
        push[j] = -x[X_SLOSH] * acceleration
    q0, q1, q2, q3 = row[S_Q], row[S_Q + 1], row[S_Q + 2], row[S_Q + 3]
    force[0] += (1.0 - 2.0 * (q2 * q2 + q3 * q3)) * push[0] + 2.0 * (q1 * q2 - q0 * q3) * push[1]
    force[1] += 2.0 * (q1 * q2 + q0 * q3) * push[0] + (1.0 - 2.0 * (q1 * q1 + q3 * q3)) * push[1]
    force[2] += 2.0 * (q1 * q3 - q0 * q2) * push[0] + 2.0 * (q2 * q3 + q0 * q1) * push[1]


@njit
def _magnet(p: F64, x: F64, row: F64, dt: float) -> None:
    """A dipole along body x in a level field turns the vehicle towards the field."""
    strength = x[X_MAGNET]
    if strength == 0.0:
        return
    cn, ce = math.cos(x[X_MAGNET + 1]), math.sin(x[X_MAGNET + 1])
    q0, q1, q2, q3 = row[S_Q], row[S_Q + 1], row[S_Q + 2], row[S_Q + 3]
    by = 2.0 * (q1 * q2 - q0 * q3) * cn + (1.0 - 2.0 * (q1 * q1 + q3 * q3)) * ce
    bz = 2.0 * (q1 * q3 + q0 * q2) * cn + 2.0 * (q2 * q3 - q0 * q1) * ce
    turn_y, turn_z = -strength * bz / p[D_INERTIA + 1], strength * by / p[D_INERTIA + 2]
    row[S_RATE + 1] += dt * turn_y
    row[S_RATE + 2] += dt * turn_z
    row[S_ANGULAR + 1] += turn_y
    row[S_ANGULAR + 2] += turn_z


@njit
def _fly(
    p: F64,
    row: F64,
    b: F64,
    hold: int,
    reference: F64,
    x: F64,
    misalignment: F64,
    gyro_bias: F64,
    noise: F64,
    normals: F64,
    log: F64,
) -> bool:
    """The whole flight; `noise` (n_outer, 9) position, velocity, rate; `hold`: steps a command; True: crashed."""
    dt = 1e-6 * DT_US
    work = np.empty((3, EVALUATED))
    memory, force, slosh, base = np.zeros(M_SIZE), np.zeros(3), np.zeros(4), np.zeros(3)
    pos, vel, q, rate, motor = np.zeros(3), np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4)
    gain = p[D_GAIN : D_GAIN + 4].copy()
    for j in range(3):
        base[j] = p[_NORTH + j]
    every = OUTER_US // DT_US
    for k in range(log.shape[0]):
        at = k // every
        if k % every == 0:
            for j in range(3):
                pos[j] = row[S_POS + j] + noise[at, j]
                vel[j] = row[S_VEL + j] + noise[at, 3 + j]
            w, i1, i2, i3 = row[S_Q], row[S_Q + 1], row[S_Q + 2], row[S_Q + 3]
            m0, m1, m2, m3 = misalignment[0], misalignment[1], misalignment[2], misalignment[3]
            q[0] = w * m0 - i1 * m1 - i2 * m2 - i3 * m3
            q[1] = w * m1 + i1 * m0 + i2 * m3 - i3 * m2
            q[2] = w * m2 - i1 * m3 + i2 * m0 + i3 * m1
            q[3] = w * m3 + i1 * m2 - i2 * m1 + i3 * m0
            outer(b, memory, reference[at], pos, vel, q)
        if k % hold == 0:
            for j in range(3):
                rate[j] = row[S_RATE + j] + gyro_bias[j] + noise[at, 6 + j]
            inner(b, memory, rate, hold * dt, motor)
        for i in range(4):
            row[S_COMMAND + i] = motor[i]
            p[D_GAIN + i] = gain[i] * max(0.0, 1.0 - x[X_FADE] * k * dt)
        for j in range(3):
            force[j] = base[j]
        _tether(x, row, force)
        _jet(x, row, force)
        _slosh(x, row, slosh, dt, force)
        _periodic(x, k * dt, force)
        _wake(p, x, row, dt, force)
        for j in range(3):
            p[_NORTH + j] = force[j]
        if normals.shape[0] > 0:
            for j in range(turbulence.NORMALS):
                row[S_NORMALS + j] = normals[k, j]
        step_row(p, row, work)
        _magnet(p, x, row, dt)
        for j in range(3):
            log[k, L_POS + j] = row[S_POS + j]
            log[k, L_VEL + j] = row[S_VEL + j]
            log[k, L_RATE + j] = row[S_RATE + j]
            log[k, L_FORCE + j] = row[S_FORCE + j]
            log[k, L_ANGULAR + j] = row[S_ANGULAR + j]
        for j in range(4):
            log[k, L_Q + j] = row[S_Q + j]
            log[k, L_MOTOR + j] = motor[j]
        log[k, L_VOLTAGE] = row[S_VOLTAGE]
        log[k, L_NORMAL] = row[S_NORMAL]
        upright = 1.0 - 2.0 * (row[S_Q + 1] * row[S_Q + 1] + row[S_Q + 2] * row[S_Q + 2])
        if not upright > -0.2 or not abs(row[S_POS]) < 300.0 or not abs(row[S_POS + 2]) < 300.0:
            return True
    return False


def fly_plant(
    plant: Plant, believed: Vehicle, truth: Vehicle, reference: F64, *, seed: int, senses: Senses, hold_ms: int
) -> Flown:
    """The same flight on any plant of `truth` that steps by DT_US, nothing outside the table; a call a step."""
    rng = np.random.default_rng(seed + 1)
    deviation = np.repeat([senses.pos_m, senses.vel_mps, senses.rate_radps], 3)
    noise = rng.standard_normal((len(reference), 9)) * deviation
    every = OUTER_US // DT_US
    log = np.zeros((len(reference) * every, L_SIZE))
    pilot = believed_row(believed, latency_s(truth) + 5e-4 * hold_ms)
    memory, motor = np.zeros(M_SIZE), np.zeros(4)
    for k, row in enumerate(log):
        at = k // every
        if k % every == 0:
            q = quat_multiply(plant.q_ned_frd, plant.misalignment_q)
            outer(pilot, memory, reference[at], plant.pos_ned_m + noise[at, :3], plant.vel_ned_mps + noise[at, 3:6], q)
        if k % hold_ms == 0:
            gyro = plant.rate_frd_radps + plant.gyro_bias_frd_radps + noise[at, 6:]
            inner(pilot, memory, gyro, 1e-6 * DT_US * hold_ms, motor)
        plant.step(motor)
        row[L_POS : L_POS + 3], row[L_VEL : L_VEL + 3] = plant.pos_ned_m, plant.vel_ned_mps
        row[L_Q : L_Q + 4], row[L_RATE : L_RATE + 3] = plant.q_ned_frd, plant.rate_frd_radps
        row[L_FORCE : L_FORCE + 3], row[L_MOTOR : L_MOTOR + 4] = plant.specific_force_frd_mps2, motor
        row[L_VOLTAGE] = plant.battery_v
        upright = 1.0 - 2.0 * (plant.q_ned_frd[1] ** 2 + plant.q_ned_frd[2] ** 2)
        if not upright > -0.2 or not np.all(np.abs(plant.pos_ned_m) < 300.0):
            return Flown(log, True)
    return Flown(log, False)


def latency_s(truth: Vehicle) -> float:
    """Motors' lag and delay of the vehicle that flies: what its pilot's gains were tuned for."""
    effects = truth.effects
    lag = effects.get("motor_lag", {}).get("time_constant_s", truth.rotors.time_constant_s)
    return float(lag + effects.get("transport_delay", {}).get("delay_s", 0.0))


def fly(
    believed: Vehicle,
    truth: Vehicle,
    reference: F64,
    outside: F64,
    *,
    seed: int,
    senses: Senses = Senses(),
    hold_ms: int = 1,
) -> Flown:
    """Fly `reference` (n, R_SIZE) on the native plant; `outside` (X_SIZE,) is what no effect of the table explains.

    The rate loop makes a motor command every `hold_ms`.
    """
    plant = NativePlant(truth, seed=seed, dt_us=DT_US)
    rng = np.random.default_rng(seed + 1)
    steps = len(reference) * (OUTER_US // DT_US)
    deviation = np.repeat([senses.pos_m, senses.vel_mps, senses.rate_radps], 3)
    noise = rng.standard_normal((len(reference), 9)) * deviation
    gusty = bool(plant.params_row[turbulence.SIGMA] != 0.0)
    normals = rng.standard_normal((steps if gusty else 0, turbulence.NORMALS))
    log = np.zeros((steps, L_SIZE))
    pilot = believed_row(believed, latency_s(truth) + 5e-4 * hold_ms)
    crashed = _fly(
        plant.params_row, plant.state_row, pilot, hold_ms, reference, outside, plant.misalignment_q,
        plant.gyro_bias_frd_radps, noise, normals, log,
    )  # fmt: skip
    return Flown(log, bool(crashed))
