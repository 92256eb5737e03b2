"""The candidates: every effect of the table as a group of columns, and how much of it is nothing.

A candidate is an effect with those of its parameters that a straight line can find; what a line can't find (which
rotor, how long a rope) is a `variant` that the search tries one by one.  Beside each parameter stands `negligible`:
how far a good model of a good vehicle is off anyway.  The evidence takes every candidate to be there at that size
(`gap.naming.evidence`), so nothing is named that only explains what such trifles explain as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flightstack.effects import EFFECTS, ParamSpec
from flightstack.gap.decisions import NEGLIGIBLE, NEGLIGIBLE_OF_REQUIRED
from flightstack.gap.simulate import natural_scale, spec_of, value
from flightstack.vehicle import Vehicle

HEIGHT = ("com_offset", "z_m")
STOCHASTIC = ("turbulence",)
"""Effects without a column: they show in the remainder's spectrum only."""
SLUNG_LENGTHS_M = (0.3, 0.6, 1.0, 1.7, 3.0)
"""Rope lengths to start from."""


_SHARES = {
    "motor_lag": 0.2,  # a millisecond: stamps are no better
    "transport_delay": 0.2,
    "inertia": 0.4,  # two percent: so much of a doublet's edge is lost between two logged commands
    "accelerometer_bias": 0.15,  # what an estimator leaves of a turn-on bias
    "gyro_bias": 0.1,
    "attitude_misalignment": 0.2,  # 2 mrad: what an estimator's slow tilt error averages to
}


def negligible(vehicle: Vehicle, effect: str, parameter: str) -> float:
    """How large this parameter's change is allowed to be without a name, in its unit."""
    return _SHARES.get(effect, NEGLIGIBLE) * natural_scale(vehicle, effect, parameter)


def trifle(effect: str, share: float) -> float:
    """Share of its negligible size at which an effect is taken to be there: `share`, where no log's errors set it."""
    return 1.0 if effect in _SHARES else share


_INERTIA = (1.0 / 3.0, 3.0)
"""Of an inertia's scale: a rod, a disc and a ball of the same mass and reach differ by less."""


def plausible(vehicle: Vehicle, effect: str, parameter: str) -> tuple[float, float]:
    """Range in which a parameter is still what its name says, inside the table's.

    A mass less than half of the file's, an inertia that no shape of that size has or a centre of mass beyond the
    rotors stand for something else: torques that do not come, mostly.
    """
    spec = spec_of(effect, parameter)
    arm = float(np.max(np.linalg.norm(vehicle.rotors.position_m[:, :2], axis=1)))
    own = {
        "inertia": _INERTIA,
        "com_offset": (-arm, arm),
        "payload": (-0.5 * vehicle.mass_kg, spec.maximum),
        "blade_flapping": (0.0, spec.maximum),  # a disk tilts away from the wind
        "rotor_fault": (spec.minimum, spec.maximum if spec.integer else 1.0),  # a rotor beyond a whole one is not weak
    }
    low, high = own.get(effect, (spec.minimum, spec.maximum))
    return max(low, spec.minimum), min(high, spec.maximum)


PHYSICAL_ENDS = {
    ("thrust_curve", "thrust_model_factor"): (0.0, 1.0),  # thrust linear in the command, or its square
    ("motor_lag", "time_constant_s"): (0.0,),  # speed control faster than the log shows
}
"""Ends of ranges at which the true value may well lie: no sign of a stand-in unless the flights want to go beyond."""


def at_physical_end(vehicle: Vehicle, effect: str, parameter: str, estimate: float) -> int:
    """-1 or 1 where an estimate stands at the least or greatest value that may well be true, else 0."""
    ends = PHYSICAL_ENDS.get((effect, parameter), ())
    low, high = plausible(vehicle, effect, parameter)
    for end, side in ((low, -1), (high, 1)):
        if end in ends and abs(estimate - end) <= 1e-6:
            return side
    return 0


def at_end(vehicle: Vehicle, effect: str, parameter: str, estimate: float) -> bool:
    """Whether an estimate has run against the far end of its range: what it stands for is something else.

    A centre of mass is not judged by its height, which hardly any flight shows.
    """
    spec = spec_of(effect, parameter)
    if spec.integer or (effect, parameter) == HEIGHT:
        return False
    low, high = plausible(vehicle, effect, parameter)
    near = 1e-6 * (high - low)
    return (estimate <= low + near and spec.null != low) or (estimate >= high - near and spec.null != high)


@dataclass(frozen=True, slots=True)
class Candidate:
    """One effect (in one variant) as a group of columns."""

    effect: str
    parameters: tuple[str, ...]
    """Those that have columns, in table order."""
    negligible: tuple[float, ...]
    """One for each of them, same units."""
    variant: Mapping[str, float] = field(default_factory=dict)
    """Parameters that are held while all candidates are looked at: which rotor, how long a rope."""
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Least and greatest value of each of them that is plausible."""

    @property
    def key(self) -> str:
        """Effect and variant, unique among the candidates."""
        return self.effect + "".join(f":{name}={value:g}" for name, value in self.variant.items())

    def spec(self, parameter: str) -> ParamSpec:
        """The table's row of one parameter, in its plausible range."""
        spec = spec_of(self.effect, parameter)
        low, high = self.ranges.get(parameter, (spec.minimum, spec.maximum))
        return replace(spec, minimum=low, maximum=high)

    def values(self, vehicle: Vehicle) -> dict[str, float]:
        """The effect's parameters as this candidate starts from: the vehicle's where it has them, else null."""
        return {p: value(vehicle, self.effect, p) for p in self.parameters} | dict(self.variant)


def has(vehicle: Vehicle, effect: str) -> bool:
    """Whether the effect acts in this vehicle."""
    values = vehicle.effects.get(effect, {})
    return bool(values) and not EFFECTS[effect].is_null(values)


def members(group: Sequence[Candidate], effects: Mapping[str, Mapping[str, float]]) -> tuple[int, ...]:
    """The candidate of each of these effects, of several (faults of other rotors) the one that is most like it."""
    off = {
        m: sum(abs(x - effects[c.effect][name]) for name, x in c.variant.items())
        for m, c in enumerate(group)
        if c.effect in effects
    }
    nearest = {effect: min((m for m in off if group[m].effect == effect), key=lambda m: off[m]) for effect in effects}
    return tuple(sorted(nearest.values()))


def candidates(vehicle: Vehicle) -> tuple[Candidate, ...]:
    """All candidates for this vehicle, in table order; an effect that it has is looked at as it is."""
    found = []
    for effect, spec in EFFECTS.items():
        if effect in STOCHASTIC or (effect == "battery_sag" and vehicle.battery is None):
            continue
        if has(vehicle, effect):
            found.append(fitted(vehicle, effect, vehicle.effects[effect]))
            continue
        linear = tuple(p.name for p in spec.params if not p.required)
        sizes = tuple(negligible(vehicle, effect, name) for name in linear)
        ranges = {name: plausible(vehicle, effect, name) for name in linear}
        found += [Candidate(effect, linear, sizes, variant, ranges) for variant in _VARIANTS.get(effect, ({},))]
    return tuple(found)


_VARIANTS: dict[str, tuple[dict[str, float], ...]] = {
    "rotor_fault": tuple({"rotor": float(rotor)} for rotor in range(1, 5)),
    "slung_load": tuple({"length_m": length} for length in SLUNG_LENGTHS_M),
}


def fitted(vehicle: Vehicle, effect: str, values: Mapping[str, float]) -> Candidate:
    """The candidate once it acts: all its parameters have columns but the whole numbers, which are held."""
    free = tuple(p for p in EFFECTS[effect].params if not p.integer)
    sizes = tuple(
        NEGLIGIBLE_OF_REQUIRED * float(values[p.name]) if p.required else negligible(vehicle, effect, p.name)
        for p in free
    )
    held = {p.name: float(values[p.name]) for p in EFFECTS[effect].params if p.integer}
    ranges = {p.name: plausible(vehicle, effect, p.name) for p in free}
    return Candidate(effect, tuple(p.name for p in free), sizes, held, ranges)
