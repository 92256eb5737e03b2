"""A vehicle and its effects as the flat row of numbers that the compiled plant reads."""

from __future__ import annotations

import math

import numpy as np

from flightstack.effects import EFFECTS, PARAMS
from flightstack.effects import row as at
from flightstack.effects.slung_load import MASS as LOAD_MASS
from flightstack.jit import njit
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError
from flightstack.vehicle import Vehicle
from flightstack_sim import composed

GROUND_RADPS = 2.0 * math.pi * 13.0
"""Vertical eigenfrequency of the vehicle on its contacts."""
GROUND_DAMPING_RATIO = 0.6
_GROUND_LARGEST_DECAY = 0.5
"""Of the contacts' damping, in one step: softer contacts for a vehicle light in turning, else the step diverges."""


def parameter_row(vehicle: Vehicle, *, dt_us: int, ground: bool = True) -> F64:
    """The parameter row (PARAMS,) of a vehicle, derived part included; InputError where the step can't follow it."""
    p = np.full(PARAMS, np.nan)
    rotors, battery = vehicle.rotors, vehicle.battery
    p[at.P_MASS] = vehicle.mass_kg
    p[at.P_INERTIA : at.P_INERTIA + 3] = vehicle.inertia_kgm2
    p[at.P_ARM : at.P_ARM + 12] = rotors.position_m.ravel()
    p[at.P_TORQUE_RATIO : at.P_TORQUE_RATIO + 4] = rotors.torque_ratio_m
    p[at.P_MAX_THRUST] = rotors.max_thrust_n
    p[at.P_MAX_SPEED] = rotors.max_speed_radps
    p[at.P_FACTOR] = rotors.thrust_model_factor
    p[at.P_TAU] = rotors.time_constant_s
    p[at.P_RADIUS] = rotors.radius_m
    p[at.P_HAS_BATTERY] = 0.0 if battery is None else 1.0
    if battery is not None:
        p[at.P_REFERENCE_V], p[at.P_FULL_V], p[at.P_EMPTY_V] = battery.reference_v, battery.full_v, battery.empty_v
        p[at.P_CAPACITY], p[at.P_RESISTANCE] = battery.capacity_as, battery.resistance_ohm
    p[at.P_DT] = 1e-6 * dt_us
    p[at.P_GROUND] = float(ground)
    for name, spec in EFFECTS.items():
        values = vehicle.effects.get(name, {})
        for param in spec.params:
            value = values.get(param.name, param.null)
            p[at.PLACES[name, param.name]] = np.nan if value is None else value
    derive(p)
    _check_stiffness(p, vehicle.name)
    return p


@njit
def derive(p: F64) -> None:
    """Fill the derived part of a parameter row from the vehicle's and the effects' parameters."""
    p[at.D_MASS] = p[at.P_MASS]
    for axis in range(3):
        p[at.D_INERTIA + axis] = p[at.P_INERTIA + axis]
    for j in range(12):
        p[at.D_ARM + j] = p[at.P_ARM + j]
    for i in range(4):
        p[at.D_GAIN + i] = 1.0
    p[at.D_FACTOR] = p[at.P_FACTOR]
    p[at.D_TAU] = p[at.P_TAU]
    p[at.D_DISK] = 2.0 * at.RHO_KGPM3 * math.pi * p[at.P_RADIUS] * p[at.P_RADIUS]
    composed.change(p)
    _derive_ground(p)


@njit
def _derive_ground(p: F64) -> None:
    """Contacts at the rotors' places in the CoM's plane: stiffness and damping for the mass that rests on them."""
    mass = p[at.D_MASS] + p[LOAD_MASS]
    damping = 2.0 * GROUND_DAMPING_RATIO * GROUND_RADPS * mass / 4.0
    about_x = about_y = reach = arm = 0.0
    for i in range(4):
        x, y = p[at.D_ARM + 3 * i], p[at.D_ARM + 3 * i + 1]
        about_x += damping * y * y
        about_y += damping * x * x
        distance = math.sqrt(x * x + y * y)
        reach = max(reach, distance)
        arm += 0.25 * distance
    fastest = max(about_x / p[at.D_INERTIA], about_y / p[at.D_INERTIA + 1], 4.0 * damping / p[at.D_MASS])
    softer = min(1.0, _GROUND_LARGEST_DECAY / (p[at.P_DT] * fastest))
    p[at.D_GROUND_C] = softer * damping
    p[at.D_GROUND_K] = mass * (softer * GROUND_RADPS) ** 2 / 4.0
    p[at.D_GROUND_LEVEL] = STANDARD_GRAVITY_MPS2 / (softer * GROUND_RADPS) ** 2
    p[at.D_GROUND_REACH] = reach
    p[at.D_GROUND_ARM] = arm


def _check_stiffness(p: F64, name: str) -> None:
    """Refuse damping that an explicit step of this length can't follow: its decay in one step must stay below 1."""
    for effect in EFFECTS.values():
        decay = p[at.P_DT] * effect.decay_rate(p) if effect.decay_rate else 0.0
        if decay > 1.0:
            raise InputError(
                f"{name}: effects.{effect.name} is {decay:.2g} times what a {p[at.P_DT] * 1e3:g} ms step "
                f"can follow for this mass and inertia; lower it by that factor"
            )
