"""A vehicle and its effects as the flat row of numbers that the compiled plant reads."""

from __future__ import annotations

import math

import numpy as np

from flightstack.effects import EFFECTS, PARAMS
from flightstack.effects.row import (
    D_ARM,
    D_DISK,
    D_FACTOR,
    D_GAIN,
    D_GROUND_ARM,
    D_GROUND_C,
    D_GROUND_K,
    D_GROUND_LEVEL,
    D_GROUND_REACH,
    D_INERTIA,
    D_MASS,
    D_TAU,
    P_ARM,
    P_CAPACITY,
    P_DT,
    P_EMPTY_V,
    P_FACTOR,
    P_FULL_V,
    P_GROUND,
    P_HAS_BATTERY,
    P_INERTIA,
    P_MASS,
    P_MAX_SPEED,
    P_MAX_THRUST,
    P_RADIUS,
    P_REFERENCE_V,
    P_RESISTANCE,
    P_TAU,
    P_TORQUE_RATIO,
    PLACES,
    RHO_KGPM3,
)
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
    p[P_MASS] = vehicle.mass_kg
    p[P_INERTIA : P_INERTIA + 3] = vehicle.inertia_kgm2
    p[P_ARM : P_ARM + 12] = rotors.position_m.ravel()
    p[P_TORQUE_RATIO : P_TORQUE_RATIO + 4] = rotors.torque_ratio_m
    p[P_MAX_THRUST] = rotors.max_thrust_n
    p[P_MAX_SPEED] = rotors.max_speed_radps
    p[P_FACTOR] = rotors.thrust_model_factor
    p[P_TAU] = rotors.time_constant_s
    p[P_RADIUS] = rotors.radius_m
    p[P_HAS_BATTERY] = 0.0 if battery is None else 1.0
    if battery is not None:
        p[P_REFERENCE_V], p[P_FULL_V], p[P_EMPTY_V] = battery.reference_v, battery.full_v, battery.empty_v
        p[P_CAPACITY], p[P_RESISTANCE] = battery.capacity_as, battery.resistance_ohm
    p[P_DT] = 1e-6 * dt_us
    p[P_GROUND] = float(ground)
    for name, spec in EFFECTS.items():
        values = vehicle.effects.get(name, {})
        for param in spec.params:
            value = values.get(param.name, param.null)
            p[PLACES[name, param.name]] = np.nan if value is None else value
    derive(p)
    _check_stiffness(p, vehicle.name)
    return p


@njit
def derive(p: F64) -> None:
    """Fill the derived part of a parameter row from the vehicle's and the effects' parameters."""
    p[D_MASS] = p[P_MASS]
    for axis in range(3):
        p[D_INERTIA + axis] = p[P_INERTIA + axis]
    for j in range(12):
        p[D_ARM + j] = p[P_ARM + j]
    for i in range(4):
        p[D_GAIN + i] = 1.0
    p[D_FACTOR] = p[P_FACTOR]
    p[D_TAU] = p[P_TAU]
    p[D_DISK] = 2.0 * RHO_KGPM3 * math.pi * p[P_RADIUS] * p[P_RADIUS]
    composed.change(p)
    _derive_ground(p)


@njit
def _derive_ground(p: F64) -> None:
    """Contacts at the rotors' places in the CoM's plane: stiffness and damping for the mass that rests on them."""
    mass = p[D_MASS] + p[LOAD_MASS]
    damping = 2.0 * GROUND_DAMPING_RATIO * GROUND_RADPS * mass / 4.0
    about_x = about_y = reach = arm = 0.0
    for i in range(4):
        x, y = p[D_ARM + 3 * i], p[D_ARM + 3 * i + 1]
        about_x += damping * y * y
        about_y += damping * x * x
        distance = math.sqrt(x * x + y * y)
        reach = max(reach, distance)
        arm += 0.25 * distance
    fastest = max(about_x / p[D_INERTIA], about_y / p[D_INERTIA + 1], 4.0 * damping / p[D_MASS])
    softer = min(1.0, _GROUND_LARGEST_DECAY / (p[P_DT] * fastest))
    p[D_GROUND_C] = softer * damping
    p[D_GROUND_K] = mass * (softer * GROUND_RADPS) ** 2 / 4.0
    p[D_GROUND_LEVEL] = STANDARD_GRAVITY_MPS2 / (softer * GROUND_RADPS) ** 2
    p[D_GROUND_REACH] = reach
    p[D_GROUND_ARM] = arm


def _check_stiffness(p: F64, name: str) -> None:
    """Refuse damping that an explicit step of this length can't follow: its decay in one step must stay below 1."""
    for effect in EFFECTS.values():
        decay = p[P_DT] * effect.decay_rate(p) if effect.decay_rate else 0.0
        if decay > 1.0:
            raise InputError(
                f"{name}: effects.{effect.name} is {decay:.2g} times what a {p[P_DT] * 1e3:g} ms step "
                f"can follow for this mass and inertia; lower it by that factor"
            )
