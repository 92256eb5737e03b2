"""Where each number lies in the compiled plant's rows: one float64 row of parameters and one of state per vehicle.

The parameter row begins with what the vehicle file says (`P_*`), goes on with what `sim.parameters.derive` makes of it
(`D_*`), which is all that the dynamics read besides the acting effects' own parameters, and ends with those
(`PLACES`; NaN: the vehicle's own).
The state row begins with what is integrated (`S_*` up to INTEGRATED), goes on with other states, inputs and outputs,
and ends with the ring of past commands.
(Compiled code freezes these numbers: the cache of flightstack.jit watches this file.)
"""

from __future__ import annotations

import numpy as np

from flightstack.types import F64

Vec = tuple[float, float, float]
"""Three floats in compiled code: they stay in registers, where an array would be allocated."""

M1, M2, M3, M4 = range(4)
"""The motors, in PX4's order."""

# --- parameters: the vehicle as its file has it
P_MASS = 0  # kg
P_INERTIA = 1  # 3, kg m^2
P_ARM = 4  # 4 x 3, m
P_TORQUE_RATIO = 16  # 4, m
P_MAX_THRUST = 20  # N
P_MAX_SPEED = 21  # rad/s
P_FACTOR = 22  # thrust model factor
P_TAU = 23  # s
P_RADIUS = 24  # m
P_HAS_BATTERY = 25  # 1 or 0
P_REFERENCE_V = 26
P_FULL_V = 27
P_EMPTY_V = 28
P_CAPACITY = 29  # A s
P_RESISTANCE = 30  # ohm
P_DT = 31  # s
P_GROUND = 32  # 1: there is ground at pos_d = 0; 0: there is none

# --- parameters: derived
D_MASS = P_GROUND + 1
D_INERTIA = D_MASS + 1
D_ARM = D_INERTIA + 3
D_GAIN = D_ARM + 12  # 4, each rotor's constant thrust gain
D_FACTOR = D_GAIN + 4
D_TAU = D_FACTOR + 1
D_LAG_HALF = D_TAU + 1  # what is left of a motor's error after half a step
D_LAG_FULL = D_LAG_HALF + 1
D_DELAY_STEPS = D_LAG_FULL + 1
D_DISK = D_DELAY_STEPS + 1  # 2 rho A of one rotor, kg/m
D_GROUND_K = D_DISK + 1  # N/m, each contact point
D_GROUND_C = D_GROUND_K + 1  # N s/m
D_GROUND_LEVEL = D_GROUND_C + 1  # m, compression of the contacts at rest
D_GROUND_REACH = D_GROUND_LEVEL + 1  # m, farthest contact point from the CoM
D_GROUND_ARM = D_GROUND_REACH + 1  # m, mean distance of the contact points: lever of the yaw friction
P_EFFECTS = D_GROUND_ARM + 1
PLACES: dict[tuple[str, str], int] = {}
"""(effect, parameter) -> place in the parameter row, filled by the effects' files in the order of their import."""


def place(effect: str, parameter: str) -> int:
    """The place of an effect's parameter: its own, or the next that is free."""
    return PLACES.setdefault((effect, parameter), P_EFFECTS + len(PLACES))


# --- state: integrated
S_POS = 0  # NED, m
S_VEL = 3  # NED, m/s
S_Q = 6  # NED <- FRD
S_RATE = 10  # FRD, rad/s
S_LOAD_DIR = 13  # NED, from the vehicle to the slung load
S_LOAD_RATE = 16  # its time derivative, 1/s
INTEGRATED = 19

# --- state: solved exactly or held within a step
S_U = 19  # 4, motors' normalised speed command after the lag
S_GUST = 23  # 5, the turbulence filters' states, unit variance
S_CHARGE = 28  # 0 .. 1
S_VOLTAGE = 29  # V at the terminals, held within a step; 0 without battery

# --- inputs of a step
S_COMMAND = 30  # 4, normalised motor commands
S_NORMALS = 34  # 5, standard normals that drive the gusts

# --- outputs of a step
S_FORCE = 39  # 3, specific force FRD, mean over the step, m/s^2
S_ANGULAR = 42  # 3, angular acceleration FRD, mean over the step, rad/s^2
S_THRUST = 45  # 4, N, at the end of the step
S_WIND = 49  # 3, NED, m/s
S_NORMAL = 52  # N, the ground's push, mean over the step
S_CURSOR = 53  # where the ring of past commands was last written
S_RING = 54  # 4 x entries

# --- what one evaluation gives: the derivative of the integrated states, then
E_FORCE = INTEGRATED  # 3, specific force FRD
E_NORMAL = E_FORCE + 3
E_THRUST = E_NORMAL + 1  # 4
EVALUATED = E_THRUST + 4

RHO_KGPM3 = 1.225
"""Air density, standard atmosphere at sea level."""


def hub_decay(p: F64) -> float:
    """Decay rate (1/s) by a drag of 1 kg/rad at the hubs, of speed or body rate, with the rotors at full speed."""
    arms = p[D_ARM : D_ARM + 12].reshape(4, 3)
    turning = float(np.sum(arms**2, axis=0).max() * p[P_MAX_SPEED] / p[D_INERTIA : D_INERTIA + 3].min())
    return max(float(4.0 * p[P_MAX_SPEED] / p[D_MASS]), turning)
