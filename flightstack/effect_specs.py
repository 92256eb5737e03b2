"""The effects: one table of names, parameters, units, null values and ranges.

The simulator's physics (`sim.effects.EFFECTS`) and the candidates of the gap workflow are both joined to this table
by name.  `slot` numbers every parameter by its place in the table: the flat vector that the compiled plant reads.
(Compiled code freezes these numbers, so the cache of flightstack.jit watches this file: it names that module here.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from flightstack.types import InputError

Kind = Literal["parameter", "command", "thrust", "force", "torque", "air", "load", "sensor"]
"""Where an effect acts: on the vehicle's parameters, on the command's way to the motors, on the rotors' thrust, as a
force (at the CoM or at the hubs), as a torque, on the air, as a hung load, or on a sensor only."""


@dataclass(frozen=True, slots=True)
class ParamSpec:
    """One parameter: its unit, allowed range and the value at which the effect is not there."""

    name: str
    unit: str
    null: float | None
    """The value without effect; None: the vehicle's own value, or (where `required`) none, it must be given."""
    minimum: float
    maximum: float
    required: bool = False
    """Must be given as soon as the effect's other parameters leave their null values."""
    integer: bool = False


@dataclass(frozen=True, slots=True)
class EffectSpec:
    """One effect: its parameters in file order, where it acts and its physics in one sentence."""

    name: str
    params: tuple[ParamSpec, ...]
    kind: Kind
    physics: str

    def is_null(self, values: Mapping[str, float]) -> bool:
        """Whether these values (absent ones at null) leave the flight as it is; "the vehicle's own" is not resolved."""
        return all(values.get(p.name, p.null) == p.null for p in self.params if not p.required)


def _xyz(stem: str, unit: str, null: float, minimum: float, maximum: float) -> tuple[ParamSpec, ...]:
    """Three parameters, one for each body axis; `*` in the stem stands for the axis."""
    return tuple(ParamSpec(stem.replace("*", axis), unit, null, minimum, maximum) for axis in "xyz")


_SPECS = (
    EffectSpec(
        "payload",
        (ParamSpec("mass_kg", "kg", 0.0, -50.0, 50.0),),
        "parameter",
        "mass at the CoM; may be negative as long as a twentieth of the vehicle's own mass is left",
    ),
    EffectSpec("thrust_scale", (ParamSpec("scale", "", 1.0, 0.0, 3.0),), "thrust", "every T_i times scale"),
    EffectSpec(
        "thrust_curve",
        (ParamSpec("thrust_model_factor", "", None, 0.0, 1.0),),
        "parameter",
        "the command-to-thrust curve: T = max_thrust (f u^2 + (1 - f) u)",
    ),
    EffectSpec(
        "rotor_fault",
        (
            ParamSpec("rotor", "", None, 1.0, 4.0, required=True, integer=True),
            ParamSpec("effectiveness", "", 1.0, 0.0, 1.5),
        ),
        "thrust",
        "one T_i (and with it its torque) times effectiveness",
    ),
    EffectSpec(
        "com_offset",
        _xyz("*_m", "m", 0.0, -1.0, 1.0),
        "parameter",
        "the CoM lies at (x, y, z) FRD of where the file says: lever arms become position - offset",
    ),
    EffectSpec("inertia", _xyz("scale_*", "", 1.0, 0.1, 10.0), "parameter", "moments of inertia times these scales"),
    EffectSpec(
        "motor_lag",
        (ParamSpec("time_constant_s", "s", None, 0.0, 1.0),),
        "parameter",
        "first-order lag of the rotors: u' = (u_cmd - u) / tau",
    ),
    EffectSpec("transport_delay", (ParamSpec("delay_s", "s", 0.0, 0.0, 0.25),), "command", "commands act late"),
    EffectSpec(
        "battery_sag",
        (ParamSpec("thrust_loss_per_v", "1/V", 0.0, 0.0, 2.0),),
        "thrust",
        "thrust scales as 1 - c (reference_v - V), never below 0",
    ),
    EffectSpec("linear_drag", _xyz("d_*_kgps", "kg/s", 0.0, 0.0, 100.0), "force", "-D v_a at the CoM"),
    EffectSpec("angular_damping", _xyz("k_*_nms", "N m s", 0.0, 0.0, 10.0), "torque", "-K omega"),
    EffectSpec(
        "rotor_drag",
        (ParamSpec("k_d_kg_per_rad", "kg/rad", 0.0, 0.0, 0.1),),
        "force",
        "-k_d W_i (v_ax,i, v_ay,i, 0) at each hub",
    ),
    EffectSpec(
        "induced_inflow",
        (ParamSpec("k_z_kg_per_rad", "kg/rad", 0.0, 0.0, 0.1),),
        "force",
        "-k_z W_i v_az,i along body z at each hub",
    ),
    EffectSpec("parasitic_drag", _xyz("c_*_kg_per_m", "kg/m", 0.0, 0.0, 10.0), "force", "-|v_a| C v_a at the CoM"),
    EffectSpec(
        "translational_lift",
        (ParamSpec("k_h_kg_per_m", "kg/m", 0.0, 0.0, 1.0),),
        "thrust",
        "T_i grows by k_h (v_ax,i^2 + v_ay,i^2); a standing rotor has none",
    ),
    EffectSpec(
        "blade_flapping",
        (ParamSpec("k_flap_nms2_per_rad_m", "N m s^2/(rad m)", 0.0, -0.01, 0.01),),
        "torque",
        "k sum_i W_i (e_z x v_a,i): k > 0 pitches up in forward flight",
    ),
    EffectSpec(
        "rotor_gyroscopic",
        (ParamSpec("rotor_inertia_kgm2", "kg m^2", 0.0, 0.0, 0.1),),
        "torque",
        "-omega x sum_i J W_i s_i e_z, s_i the sense of rotation about body z",
    ),
    EffectSpec(
        "ground_effect",
        (ParamSpec("strength", "", 0.0, 0.0, 20.0),),
        "thrust",
        "thrust / (1 - s (R / 4 z)^2), s (R / 4 z)^2 at most 0.75, z the hub's height, at least R/2; Cheeseman-Bennett",
    ),
    EffectSpec(
        "vortex_ring",
        (ParamSpec("strength", "", 0.0, 0.0, 1.0),),
        "thrust",
        "thrust times 1 - s exp(-((w/v_h - 1)/0.5)^2), w the descent rate through the air, v_h = sqrt(T / 2 rho A)",
    ),
    EffectSpec(
        "steady_wind",
        (
            ParamSpec("north_mps", "m/s", 0.0, -60.0, 60.0),
            ParamSpec("east_mps", "m/s", 0.0, -60.0, 60.0),
            ParamSpec("down_mps", "m/s", 0.0, -60.0, 60.0),
        ),
        "air",
        "velocity of the air over ground (3 north: a wind from the south); acts through the drag effects",
    ),
    EffectSpec(
        "constant_force",
        (
            ParamSpec("north_n", "N", 0.0, -500.0, 500.0),
            ParamSpec("east_n", "N", 0.0, -500.0, 500.0),
            ParamSpec("down_n", "N", 0.0, -500.0, 500.0),
        ),
        "force",
        "a force at the CoM, fixed in the world",
    ),
    EffectSpec(
        "turbulence",
        (
            ParamSpec("sigma_mps", "m/s", 0.0, 0.0, 20.0),
            ParamSpec("length_m", "m", None, 0.1, 10000.0, required=True),
        ),
        "air",
        "Dryden gusts on top of the steady wind",
    ),
    EffectSpec(
        "slung_load",
        (
            ParamSpec("mass_kg", "kg", 0.0, 0.0, 50.0),
            ParamSpec("length_m", "m", None, 0.05, 100.0, required=True),
        ),
        "load",
        "a pendulum hung at the CoM, at rest at the start, damping ratio 0.02",
    ),
    EffectSpec("accelerometer_bias", _xyz("*_mps2", "m/s^2", 0.0, -10.0, 10.0), "sensor", "measured = true + bias"),
    EffectSpec("gyro_bias", _xyz("*_radps", "rad/s", 0.0, -2.0, 2.0), "sensor", "measured = true + bias"),
    EffectSpec(
        "attitude_misalignment",
        (
            ParamSpec("roll_rad", "rad", 0.0, -1.0, 1.0),
            ParamSpec("pitch_rad", "rad", 0.0, -1.0, 1.0),
            ParamSpec("yaw_rad", "rad", 0.0, -3.1416, 3.1416),
        ),
        "sensor",
        "the measured attitude is the true one followed by this body rotation",
    ),
)

EFFECT_SPECS: dict[str, EffectSpec] = {spec.name: spec for spec in _SPECS}
"""Name -> spec, in the order of the vehicle file's documentation."""

_SLOTS: dict[tuple[str, str], int] = {
    key: i for i, key in enumerate((spec.name, param.name) for spec in _SPECS for param in spec.params)
}

SLOT_COUNT = len(_SLOTS)


def slot(effect: str, param: str) -> int:
    """Place of one effect's parameter in the flat vector of all of them (0 .. SLOT_COUNT - 1)."""
    return _SLOTS[effect, param]


def check_effect(name: str, values: object, source: str) -> dict[str, float]:
    """The values of one effect as floats, in table order; InputError names source and key where something is wrong."""
    spec = EFFECT_SPECS.get(name)
    if spec is None:
        raise InputError(f"{source}: unknown effect effects.{name}; known are {', '.join(EFFECT_SPECS)}")
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
