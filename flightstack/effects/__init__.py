"""The effects, one file and one line here for each: what a vehicle may have beyond mass, inertia and rotors.

An effect's file holds all that the project knows of it (`record.Effect`): parameters and ranges, the physics with its
source, JSBSim's terms, and what the gap workflow needs.  docs/howto/effect.md adds one.
"""

from __future__ import annotations

from collections.abc import Mapping

from flightstack.effects import (
    accelerometer_bias,
    angular_damping,
    attitude_misalignment,
    battery_sag,
    blade_flapping,
    com_offset,
    constant_force,
    ground_effect,
    gyro_bias,
    induced_inflow,
    inertia,
    linear_drag,
    motor_lag,
    parasitic_drag,
    payload,
    rotor_drag,
    rotor_fault,
    rotor_gyroscopic,
    slung_load,
    steady_wind,
    thrust_curve,
    thrust_scale,
    translational_lift,
    transport_delay,
    turbulence,
    vortex_ring,
)
from flightstack.effects.record import Effect as Effect
from flightstack.effects.record import ParamSpec as ParamSpec
from flightstack.effects.row import P_EFFECTS, PLACES
from flightstack.types import InputError

EFFECTS: dict[str, Effect] = {
    each.EFFECT.name: each.EFFECT
    for each in (
        payload,
        thrust_scale,
        thrust_curve,
        rotor_fault,
        com_offset,
        inertia,
        motor_lag,
        transport_delay,
        battery_sag,
        linear_drag,
        angular_damping,
        rotor_drag,
        induced_inflow,
        parasitic_drag,
        translational_lift,
        blade_flapping,
        rotor_gyroscopic,
        ground_effect,
        vortex_ring,
        steady_wind,
        constant_force,
        turbulence,
        slung_load,
        accelerometer_bias,
        gyro_bias,
        attitude_misalignment,
    )
}
"""Name -> effect, in the order of the vehicle file's documentation, in which they also act."""

PARAMS = P_EFFECTS + len(PLACES)
"""Length of the plant's parameter row."""


def check_effect(name: str, values: object, source: str) -> dict[str, float]:
    """The values of one effect as floats, in table order; InputError names source and key where something is wrong."""
    spec = EFFECTS.get(name)
    if spec is None:
        raise InputError(f"{source}: unknown effect effects.{name}; known are {', '.join(EFFECTS)}")
    if not isinstance(values, Mapping):
        raise InputError(f"{source}: effects.{name} must be a table of its parameters, not {values!r}")
    names = [param.name for param in spec.params]
    for key in values:
        if key not in names:
            raise InputError(f"{source}: unknown key effects.{name}.{key}; its parameters are {', '.join(names)}")
    checked = {
        p.name: _check_param(p, values[p.name], f"{source}: effects.{name}") for p in spec.params if p.name in values
    }
    if not spec.is_null(checked):
        for param in spec.params:
            if param.required and param.name not in checked:
                raise InputError(f"{source}: effects.{name}.{param.name} is missing; give it in {_range(param)}")
    return checked


def _range(param: ParamSpec) -> str:
    unit = f" {param.unit}" if param.unit else ""
    return f"{param.minimum:g} to {param.maximum:g}{unit}" + (", a whole number" if param.integer else "")


def _check_param(param: ParamSpec, value: object, where: str) -> float:
    number_like = isinstance(value, int | float) and not isinstance(value, bool)
    if not number_like or not param.minimum <= float(value) <= param.maximum:  # type: ignore[arg-type]
        raise InputError(f"{where}.{param.name} = {value!r} is not allowed; it must be in {_range(param)}")
    number = float(value)  # type: ignore[arg-type]
    if param.integer and number != int(number):
        raise InputError(f"{where}.{param.name} = {value!r} is not allowed; it must be in {_range(param)}")
    return number
