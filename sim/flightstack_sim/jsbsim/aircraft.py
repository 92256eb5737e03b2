"""A vehicle file as an aircraft of JSBSim: its functions do lag, curve, forces and moments, ours sends commands only.

Written from the vehicle file and docs/physics.md's equations alone; of the native plant it takes the contacts' spring
and damper (a choice, no physics).  Places are structural points from the file's origin: `com_offset` moves the CoM and
leaves the rotors, and JSBSim finds the lever arms.  What an absent effect would need is not written at all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from flightstack.effects import EFFECTS
from flightstack.effects.expressions import (
    exponential,
    greatest,
    least,
    minus,
    over,
    positive,
    power,
    prop,
    root,
    times,
    total,
)
from flightstack.effects.ground_effect import MOST_LOST
from flightstack.effects.record import NotInJsbsim, Place, Terms
from flightstack.effects.row import D_GROUND_C, D_GROUND_K, RHO_KGPM3
from flightstack.types import InputError
from flightstack.vehicle import Vehicle
from flightstack_sim.battery import FIGURE_OF_MERIT
from flightstack_sim.ground import FRICTION
from flightstack_sim.jsbsim import air, text
from flightstack_sim.jsbsim.text import XYZ
from flightstack_sim.parameters import parameter_row

ROTORS = range(4)
IDLE = ("Input", "MassBalance", "Aerodynamics", "BuoyantForces", "Output", "Atmosphere", "Propulsion")
"""Models of JSBSim that an aircraft of ours doesn't use; its mass doesn't change, no force depends on the pressure."""
REFUSED = {e.name: e.jsbsim.why for e in EFFECTS.values() if isinstance(e.jsbsim, NotInJsbsim)}
"""Effects that JSBSim can't express, and why."""
_AXES: tuple[XYZ, XYZ, XYZ] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_RATES = tuple(prop(f"velocities/{letter}-rad_sec") for letter in "pqr")
_LEAST_INDUCED_MPS = 1e-6
_VOLTAGE, _CHARGE = "battery/voltage", "battery/charge"


@dataclass(frozen=True, slots=True)
class Aircraft:
    """What JSBSim loads, and the names of what the plant writes and reads."""

    name: str
    files: Mapping[str, str]
    """File name -> text; `NAME.xml` is the aircraft."""
    commands: tuple[str, ...]
    """Four properties: normalised motor commands."""
    thrusts: tuple[str, ...]
    thrust_unit_n: float
    speeds: tuple[str, ...]
    """Four properties that make `motor_u`."""
    speed_unit: float
    states: tuple[str, ...]
    """What an aircraft with changed effects takes over from the one before; not the rigid body's state."""
    voltage: str | None
    settle_frames: int
    """Steps in which forces, delays and motors take on what they are given."""
    rest_height_m: float
    """Of the CoM over the ground, at rest; flights begin there, and call it 0."""
    idle: tuple[str, ...]
    """JSBSim's models that have nothing to do in this aircraft."""
    first: Mapping[str, float] = field(default_factory=dict)
    """Properties to set before the first step."""


class Effects:
    """The vehicle's effects: values in SI, null where absent."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._effects = vehicle.effects
        self.read: set[str] = set()
        """Effects whose values were asked for: the aircraft has them."""

    def __call__(self, effect: str, parameter: str, own: float = math.nan) -> float:
        """The parameter's value; `own` where its null is the vehicle's own."""
        self.read.add(effect)
        null = next(p.null for p in EFFECTS[effect].params if p.name == parameter)
        value = self._effects.get(effect, {}).get(parameter, null)
        return own if value is None else float(value)

    def xyz(self, effect: str) -> XYZ:
        """The three parameters of an effect that has one for each axis."""
        x, y, z = self.values(effect)
        return x, y, z

    def values(self, effect: str) -> tuple[float, ...]:
        """All parameters of an effect, in table order."""
        return tuple(self(effect, p.name) for p in EFFECTS[effect].params)

    def acts(self, effect: str) -> bool:
        """Whether the effect is there and not null."""
        return not EFFECTS[effect].is_null(self._effects.get(effect, {}))

    def terms(self, where: Place, *arguments: object) -> list[Terms]:
        """What the acting effects of one place write themselves."""
        return [
            effect.jsbsim(self.values(effect.name), *arguments)
            for effect in EFFECTS.values()
            if effect.place == where and callable(effect.jsbsim) and self.acts(effect.name)
        ]


def refuse(vehicle: Vehicle) -> None:
    """InputError where the vehicle has an effect that JSBSim can't express."""
    for name, why in REFUSED.items():
        if not EFFECTS[name].is_null(vehicle.effects.get(name, {})):
            raise _refusal(vehicle, name, why)


def _refusal(vehicle: Vehicle, name: str, why: str) -> InputError:
    return InputError(
        f"{vehicle.name}: effects.{name} cannot be flown on --plant jsbsim: {why}; take it out or fly --plant native"
    )


def write(vehicle: Vehicle, *, dt_us: int, gravity_mps2: float, seed: int, ground: bool = True) -> Aircraft:
    """The aircraft of a vehicle; InputError where JSBSim can't express it or this step can't follow it."""
    refuse(vehicle)
    writer = _Writer(vehicle, dt_us, gravity_mps2, seed, ground)
    aircraft = writer.aircraft()
    for name, values in vehicle.effects.items():
        effect = EFFECTS[name]
        if effect.place != "sensor" and not effect.is_null(values) and name not in writer.effects.read:
            raise _refusal(vehicle, name, "its physics is not written for JSBSim")
    return aircraft


def contacts(vehicle: Vehicle, com: XYZ, dt_us: int, gravity_mps2: float) -> str:
    """Contact points under the rotors, in the CoM's plane, lowered by what the weight compresses them."""
    row = parameter_row(vehicle, dt_us=dt_us)
    stiffness, damping = float(row[D_GROUND_K]), float(row[D_GROUND_C])
    level = vehicle.total_mass_kg * gravity_mps2 / (4.0 * stiffness)
    return "".join(
        text.contact(f"foot-{i + 1}", (float(x), float(y), com[2] + level), stiffness, damping, FRICTION)
        for i, (x, y, _) in enumerate(vehicle.rotors.position_m)
    )


class _Writer:
    def __init__(self, vehicle: Vehicle, dt_us: int, gravity_mps2: float, seed: int, ground: bool) -> None:
        self.vehicle = vehicle
        self.effects = Effects(vehicle)
        self.dt_us = dt_us
        self.dt_s = 1e-6 * dt_us
        self.gravity_mps2 = gravity_mps2
        self.seed = seed
        self.ground = ground
        self.com: XYZ = self.effects.xyz("com_offset")
        self.acts = self.effects.acts
        written = repr(self._at_hub("hub force", 1) + self._at_hub("hub torque", 1))
        of = {"x": "translational_lift", "y": "translational_lift", "z": "vortex_ring"}
        self.hub_axes = "".join(a for a in of if f"rotor/air-{a}-1" in written or self.acts(of[a]))
        self.still = not (self.acts("steady_wind") or self.acts("turbulence"))
        self.needs_speeds = "rotor/speed-1" in written or self.acts("rotor_gyroscopic")

    def _at_hub(self, where: Place, n: int) -> list[Terms]:
        return self.effects.terms(where, [prop(f"rotor/air-{a}-{n}") for a in "xyz"], prop(f"rotor/speed-{n}"))

    def aircraft(self) -> Aircraft:
        vehicle, effects = self.vehicle, self.effects
        body = text.mass_balance(vehicle.mass_kg, self._inertia(), self.com, effects("payload", "mass_kg"))
        gusts = air.gusts(effects, self.dt_s, self.seed) if self.acts("turbulence") else air.STILL
        components = self._commands() + self._lags() + self._battery() + "".join(gusts.components)
        first = {**self._declared(), **gusts.first}
        declared = "".join(text.declare(name, value) for name, value in first.items())
        feet = contacts(vehicle, self.com, self.dt_us, self.gravity_mps2) if self.ground else ""
        xml = air.fdm_config(
            "vehicle",
            mass_balance=body,
            ground_reactions=feet,
            flight_control=f'{declared}<channel name="vehicle">{components}</channel>',
            external_reactions=self._functions() + self._forces() + self._moments(),
            reference=self.com,
        )
        meets_wind = not self.still and bool(self.hub_axes or self._drags())
        battery = (_CHARGE, _VOLTAGE) if vehicle.battery is not None else ()
        return Aircraft(
            name="vehicle",
            files={"vehicle.xml": xml},
            commands=tuple(f"motor/command-{i + 1}" for i in ROTORS),
            thrusts=tuple(f"rotor/thrust-{i + 1}" for i in ROTORS),
            thrust_unit_n=1.0,
            speeds=tuple(f"motor/u-{i + 1}" for i in ROTORS),
            speed_unit=1.0,
            states=(*(f"motor/u-{i + 1}" for i in ROTORS), *battery, *gusts.first),
            voltage=_VOLTAGE if vehicle.battery is not None else None,
            settle_frames=2 + math.ceil(effects("transport_delay", "delay_s") / self.dt_s),
            rest_height_m=0.0,
            idle=IDLE if meets_wind else (*IDLE, "Auxiliary"),
            first={**first, **air.wind(effects)},
        )

    def _inertia(self) -> XYZ:
        x, y, z = (
            float(own * scale)
            for own, scale in zip(self.vehicle.inertia_kgm2, self.effects.xyz("inertia"), strict=True)
        )
        return x, y, z

    def _declared(self) -> dict[str, float]:
        """Our own properties with the values that they have on the ground, motors off."""
        values = {}
        for i in ROTORS:
            for name in ("command", "late", "later", "target", "u"):
                values[f"motor/{name}-{i + 1}"] = 0.0
        if (battery := self.vehicle.battery) is not None:
            values |= {_CHARGE: 1.0, _VOLTAGE: battery.full_v}
        return values

    # --- commands and states, stepped before the forces ---

    def _commands(self) -> str:
        """transport_delay: two of JSBSim's delays round it, and their mixture."""
        delay = self.effects("transport_delay", "delay_s") / self.dt_s
        if delay == 0.0:
            return ""
        whole = int(delay)
        share = delay - whole
        parts = []
        for i in range(1, 5):
            parts.append(text.delayed(f"motor/command-{i}", f"motor/late-{i}", whole))
            parts.append(text.delayed(f"motor/command-{i}", f"motor/later-{i}", whole + 1))
            mixed = total(times(1.0 - share, prop(f"motor/late-{i}")), times(share, prop(f"motor/later-{i}")))
            parts.append(text.state(f"motor/target-{i}", mixed))
        return "".join(parts)

    def _lags(self) -> str:
        """u' = (target - u) / tau for a target held over the step."""
        source = "target" if self.effects("transport_delay", "delay_s") else "command"
        tau = self.effects("motor_lag", "time_constant_s", self.vehicle.rotors.time_constant_s)
        parts = []
        for i in range(1, 5):
            target, u = prop(f"motor/{source}-{i}"), prop(f"motor/u-{i}")
            lagged = total(u, times(-math.expm1(-self.dt_s / tau), minus(target, u))) if tau > 0.0 else target
            parts.append(text.state(f"motor/u-{i}", lagged))
        return "".join(parts)

    def _battery(self) -> str:
        """Charge, and the terminal voltage that solves V = OCV - R P / V for the rotors' power of the last step."""
        battery = self.vehicle.battery
        if battery is None:
            return ""
        disk = 2.0 * RHO_KGPM3 * math.pi * self.vehicle.rotors.radius_m**2
        induced = [power(greatest(prop(f"rotor/thrust-{i + 1}"), 0.0), 1.5) for i in ROTORS]
        watts = times(1.0 / (FIGURE_OF_MERIT * math.sqrt(disk)), total(*induced))
        drawn = over(prop("battery/power"), prop(_VOLTAGE))
        charge = minus(prop(_CHARGE), times(self.dt_s / battery.capacity_as, drawn))
        half_open = total(0.5 * battery.empty_v, times(0.5 * (battery.full_v - battery.empty_v), prop(_CHARGE)))
        half = prop("battery/half-open-circuit")
        inside = minus(times(half, half), times(battery.resistance_ohm, prop("battery/power")))
        return (
            text.state("battery/power", watts)
            + text.state(_CHARGE, greatest(charge, 0.0))
            + text.state("battery/half-open-circuit", half_open)
            + text.state(_VOLTAGE, total(half, root(greatest(inside, 0.0))))
        )

    # --- functions, once a step ---

    def _functions(self) -> str:
        drags = repr(self._drags())
        speed = "air/speed" in drags
        axes = "xyz" if speed else {*self.hub_axes, *(a for a in "xyz" if f"air/{a}<" in drags)}
        parts = [air.body_air(axes, still=self.still, speed=speed)]
        if self.acts("ground_effect"):
            parts.append(air.down_axis())
        for i in ROTORS:
            parts.append(self._rotor(i))
        return "".join(parts)

    def _rotor(self, i: int) -> str:
        """Speed share squared, speed, air at the hub and thrust of one rotor."""
        rotors, n = self.vehicle.rotors, i + 1
        f = self.effects("thrust_curve", "thrust_model_factor", rotors.thrust_model_factor)
        u = prop(f"motor/u-{n}")
        parts = [text.function(f"rotor/share-{n}", times(u, total(1.0 - f, times(f, u))))]
        if self.needs_speeds:
            speed = times(rotors.max_speed_radps, root(prop(f"rotor/share-{n}")))
            parts.append(text.function(f"rotor/speed-{n}", speed))
        parts.append(air.hub_air(n, self._arm(i), self.hub_axes))
        if self.acts("vortex_ring"):
            parts.append(text.function(f"rotor/early-{n}", self._thrust(i)))
        parts.append(
            text.function(f"rotor/thrust-{n}", self._vortex(n) if self.acts("vortex_ring") else self._thrust(i))
        )
        return "".join(parts)

    def _arm(self, i: int) -> XYZ:
        x, y, z = (float(a - b) for a, b in zip(self.vehicle.rotors.position_m[i], self.com, strict=True))
        return x, y, z

    def _thrust(self, i: int) -> str:
        """Curve, translational lift, then what multiplies; vortex ring comes after."""
        n, effects = i + 1, self.effects
        curve = times(self.vehicle.rotors.max_thrust_n, prop(f"rotor/share-{n}"))
        if self.acts("translational_lift"):
            x, y = prop(f"rotor/air-x-{n}"), prop(f"rotor/air-y-{n}")
            turning = positive(prop(f"rotor/share-{n}"))
            lift = effects("translational_lift", "k_h_kg_per_m")
            curve = total(curve, times(lift, turning, total(times(x, x), times(y, y))))
        gain = effects("thrust_scale", "scale")
        if effects("rotor_fault", "rotor", 0.0) == n:
            gain *= effects("rotor_fault", "effectiveness")
        thrust = times(gain, curve) if gain != 1.0 else curve
        if self.acts("battery_sag") and self.vehicle.battery is not None:
            below = minus(self.vehicle.battery.reference_v, prop(_VOLTAGE))
            lost = times(effects("battery_sag", "thrust_loss_per_v"), below)
            thrust = times(thrust, greatest(minus(1.0, lost), 0.0))
        if self.acts("ground_effect"):
            radius = self.vehicle.rotors.radius_m
            height = greatest(air.hub_height(self._arm(i)), 0.5 * radius)
            ratio = over(0.25 * radius, height)
            lost = least(times(effects("ground_effect", "strength"), ratio, ratio), MOST_LOST)
            thrust = over(thrust, minus(1.0, lost))
        return thrust

    def _vortex(self, n: int) -> str:
        early = prop(f"rotor/early-{n}")
        disk = 2.0 * RHO_KGPM3 * math.pi * self.vehicle.rotors.radius_m**2
        induced = greatest(root(times(1.0 / disk, greatest(early, 0.0))), _LEAST_INDUCED_MPS)
        off = minus(times(2.0, over(prop(f"rotor/air-z-{n}"), induced)), 2.0)
        lost = times(self.effects("vortex_ring", "strength"), exponential(times(-1.0, off, off)))
        return times(early, minus(1.0, lost))

    # --- forces and moments ---

    def _forces(self) -> str:
        parts = []
        for i in ROTORS:
            n = i + 1
            x, y, z = (float(value) for value in self.vehicle.rotors.position_m[i])
            up = [prop(f"rotor/thrust-{n}")]
            for k, terms in enumerate(self._at_hub("hub force", n)):
                up += [times(-1.0, down) for down in terms[2:] if down]
                for axis, along, value in zip("xy", _AXES, terms, strict=False):
                    if value:
                        parts.append(text.force(f"rotor-{k}-{axis}-{n}", (x, y, z), along, value))
            parts.append(text.force(f"rotor-{n}", (x, y, z), (0.0, 0.0, -1.0), total(*up)))
        for axis, along, value in self._drags():
            parts.append(text.force(f"drag-{axis}", self.com, along, value))
        return "".join(parts) + air.constant_force(self.effects, self.com)

    def _drags(self) -> list[tuple[str, XYZ, str]]:
        """(axis, its direction, force) of all that drags at the CoM."""
        effects = self.effects.terms("body force", [prop(f"air/{axis}") for axis in "xyz"], prop("air/speed"))
        found = []
        for axis, along, *parts in zip("xyz", _AXES, *effects, strict=True):
            if any(parts):
                found.append((axis, along, total(*filter(None, parts))))
        return found

    def _moments(self) -> str:
        about: tuple[list[str], list[str], list[str]] = ([], [], [])
        for i, ratio in enumerate(self.vehicle.rotors.torque_ratio_m):
            about[2].append(times(float(ratio), prop(f"rotor/thrust-{i + 1}")))
        turning = [terms for n in range(1, 5) for terms in self._at_hub("hub torque", n)]
        if inertia := self.effects("rotor_gyroscopic", "rotor_inertia_kgm2"):
            senses = [-math.copysign(1.0, ratio) if ratio else 0.0 for ratio in self.vehicle.rotors.torque_ratio_m]
            spin = total(*(times(inertia * s, prop(f"rotor/speed-{i + 1}")) for i, s in enumerate(senses)))
            about[0].append(times(-1.0, _RATES[1], spin))
            about[1].append(times(_RATES[0], spin))
        for terms in turning + self.effects.terms("body torque", _RATES):
            for each, value in zip(about, terms, strict=True):
                each += [value] if value else []
        return "".join(
            text.moment(f"about-{axis}", along, total(*terms))
            for axis, along, terms in zip("xyz", _AXES, about, strict=True)
            if terms
        )
