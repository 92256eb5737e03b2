"""Slung load: a point mass on a massless rod hung at the CoM, fully coupled.

With the unit vector n from vehicle to load, its rate w = n', rod length L, load m_l, vehicle m and the sum F of all
other forces on the vehicle (gravity included):
    m a = F + T n + c L w            m_l (a + L n'') = m_l g - T n - c L w            n . n'' = -|w|^2
Dotted with n the rod's tension follows, T = m m_l / (m + m_l) ((g - F/m) . n + L |w|^2).  The damper c acts between
load and vehicle (no net force on the pair); c = 2 * 0.02 * m_l sqrt(g/L) is a damping ratio of 0.02 under a fixed
suspension point.  Air and ground don't touch the load.
"""

from __future__ import annotations

import math

from flightstack.effects.record import Effect, NotInJsbsim, ParamSpec
from flightstack.effects.row import D_MASS, P_DT, S_LOAD_DIR, S_LOAD_RATE, Vec, place
from flightstack.jit import njit
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

MASS = place("slung_load", "mass_kg")
LENGTH = place("slung_load", "length_m")
DAMPING_RATIO = 0.02
_G = STANDARD_GRAVITY_MPS2


@njit
def pull(p: F64, y: F64, force: Vec, dy: F64) -> Vec:
    """Force (N, NED) of rod and damper on the vehicle, given all others (`force`, NED); writes the load's derivative.

    `y`, `dy`: the integrated part of the state row and its derivative.
    """
    mass = p[MASS]
    if mass == 0.0:
        for j in range(3):
            dy[S_LOAD_DIR + j] = 0.0
            dy[S_LOAD_RATE + j] = 0.0
        return (0.0, 0.0, 0.0)
    vehicle, length = p[D_MASS], p[LENGTH]
    nx, ny, nz = y[S_LOAD_DIR], y[S_LOAD_DIR + 1], y[S_LOAD_DIR + 2]
    wx, wy, wz = y[S_LOAD_RATE], y[S_LOAD_RATE + 1], y[S_LOAD_RATE + 2]
    swing = wx * wx + wy * wy + wz * wz
    along = (force[0] * nx + force[1] * ny + force[2] * nz) / vehicle
    tension = vehicle * mass / (vehicle + mass) * (_G * nz - along + length * swing)
    damper = 2.0 * DAMPING_RATIO * mass * math.sqrt(_G / length) * length
    px, py, pz = tension * nx + damper * wx, tension * ny + damper * wy, tension * nz + damper * wz
    # the load's acceleration relative to the vehicle's, over the length; n'' = that, its part along n being -|w|^2 n
    rx = (-px / mass - (force[0] + px) / vehicle) / length
    ry = (-py / mass - (force[1] + py) / vehicle) / length
    rz = (_G - pz / mass - (force[2] + pz) / vehicle) / length
    dy[S_LOAD_DIR], dy[S_LOAD_DIR + 1], dy[S_LOAD_DIR + 2] = wx, wy, wz
    dy[S_LOAD_RATE], dy[S_LOAD_RATE + 1], dy[S_LOAD_RATE + 2] = rx, ry, rz
    return (px, py, pz)


@njit
def hang(row: F64) -> None:
    """The load hangs straight down, at rest."""
    for j in range(3):
        row[S_LOAD_DIR + j] = 0.0
        row[S_LOAD_RATE + j] = 0.0
    row[S_LOAD_DIR + 2] = 1.0


@njit
def follow(p: F64, row: F64, change_n: float, change_e: float) -> None:
    """The vehicle's velocity was changed (m/s, NED, evenly over the last step) by what doesn't touch the load."""
    if p[MASS] == 0.0:
        return
    for j, change in enumerate((change_n, change_e)):
        row[S_LOAD_RATE + j] -= change / p[LENGTH]
        row[S_LOAD_DIR + j] -= 0.5 * p[P_DT] * change / p[LENGTH]


@njit
def constrain(p: F64, row: F64) -> None:
    """Take the integration's drift out of the rod: unit direction, rate across it."""
    if p[MASS] == 0.0:
        return
    nx, ny, nz = row[S_LOAD_DIR], row[S_LOAD_DIR + 1], row[S_LOAD_DIR + 2]
    norm = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / norm, ny / norm, nz / norm
    along = row[S_LOAD_RATE] * nx + row[S_LOAD_RATE + 1] * ny + row[S_LOAD_RATE + 2] * nz
    row[S_LOAD_DIR], row[S_LOAD_DIR + 1], row[S_LOAD_DIR + 2] = nx, ny, nz
    row[S_LOAD_RATE] -= along * nx
    row[S_LOAD_RATE + 1] -= along * ny
    row[S_LOAD_RATE + 2] -= along * nz


EFFECT = Effect(
    name="slung_load",
    params=(
        ParamSpec("mass_kg", "kg", 0.0, 0.0, 50.0),
        ParamSpec("length_m", "m", None, 0.05, 100.0, required=True),
    ),
    kind="load",
    place="own",
    physics=pull,
    equation="a pendulum hung at the CoM, at rest at the start, damping ratio 0.02",
    source="Sreenath, Lee, Kumar, CDC 2013: quadrotor with a point mass on a rod",
    words="a slung load",
    scale=lambda size: {"mass_kg": 0.05 * size.mass_kg, "length_m": 0.1},
    needs=("q_ned_frd", "motor"),
    manoeuvre="quick starts and stops, then hover for three swings",
    jsbsim=NotInJsbsim("the load is a second body, and JSBSim's aircraft is one"),
    example={"mass_kg": 0.25, "length_m": 0.8},
    has_states=True,
    told_by_force=True,
)
