"""What an effect's file says of it: one record, which the plants, the gap workflow, the files and the tests read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from flightstack.effects.row import place
from flightstack.types import F64

Kind = Literal["parameter", "command", "thrust", "force", "torque", "air", "load", "sensor"]
"""Where an effect acts: on the vehicle's parameters, on the command's way to the motors, on the rotors' thrust, as a
force (at the CoM or at the hubs), as a torque, on the air, as a hung load, or on a sensor only."""

Place = Literal[
    "parameters",  # change(p) -> None, once, before the flight
    "added thrust",  # (p, thrust_n, hub_air) -> N, each rotor
    "thrust factor",  # (p, thrust_n, hub_air, height_m) -> factor, each rotor
    "hub force",  # (p, speed_radps, hub_air) -> N FRD, each rotor
    "hub torque",  # (p, speed_radps, hub_air) -> N m FRD, each rotor
    "body force",  # (p, air) -> N FRD, at the CoM
    "body torque",  # (p, rate) -> N m FRD
    "world force",  # (p) -> N NED, at the CoM
    "wind",  # (p) -> m/s NED
    "sensor",  # read by the sensors
    "own",  # has a state or a call of its own in flightstack_sim.rigid_body
]
"""Where the plant calls the physics, with which arguments: those of one place, but the last two, add (or multiply) up
in the table's order.  p: the parameter row; velocities relative to the air in m/s FRD."""

Values = tuple[float, ...]
"""An effect's parameters, in table order."""
Axes = tuple[str, str, str]
"""A vector in JSBSim: the terms of its components along body x, y, z."""
Terms = tuple[str | None, ...]
"""Terms of JSBSim's functions for body x, y, z; None: none."""
SPEED_MPS = 5.0
RATE_RADPS = 2.0


class NotInJsbsim(NamedTuple):
    """JSBSim can't express the effect: it is refused there."""

    why: str


WRITTEN_IN_AIRCRAFT = "flightstack_sim.jsbsim.aircraft"
"""The effect is part of how the aircraft is built: its mass, its lags, its rotors' thrust."""
NO_PHYSICS = "sensors"
"""The effect moves nothing: the sensors that both plants share show it."""


class Size(NamedTuple):
    """What a vehicle's plausible effects are measured by."""

    mass_kg: float
    weight_n: float
    inertia_kgm2: float
    """Mean of the three moments."""
    arm_m: float
    turning_radps: float
    """Sum of the rotors' speeds in hover."""


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


def xyz(stem: str, unit: str, null: float, minimum: float, maximum: float) -> tuple[ParamSpec, ...]:
    """Three parameters, one for each body axis; `*` in the stem stands for the axis."""
    return tuple(ParamSpec(stem.replace("*", axis), unit, null, minimum, maximum) for axis in "xyz")


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """One effect, whole."""

    name: str
    params: tuple[ParamSpec, ...]
    """In file order."""
    kind: Kind
    place: Place
    physics: Callable[..., Any]
    equation: str
    source: str
    """The literature (or reasoning) behind it."""
    words: str
    """As one says it: "a payload"."""
    scale: Callable[[Size], float | Mapping[str, float]]
    """A change of each parameter that moves the motion by some percent."""
    needs: tuple[str, ...]
    """Signals without which a log can't show it, whatever is flown."""
    manoeuvre: str
    """What shows it best."""
    jsbsim: Callable[..., Terms] | NotInJsbsim | str
    """Its terms in JSBSim, or why there are none.  Forces and torques: (values, air or rates (3), speed) -> terms;
    speed: of the air at the CoM, of the rotor at a hub."""
    example: Mapping[str, float]
    """Values that a 1 kg vehicle may have."""
    decay_rate: Callable[[F64], float] | None = None
    """Of what damps: how fast it takes speed away (1/s) for this parameter row; a step must follow it."""
    has_states: bool = False
    """Changes states that have a past: lags, delays, a load's swing."""
    turns_only: bool = False
    """Shows only in how soon and how fast a vehicle turns."""
    told_by_force: bool = False
    """The force is what tells it, so that gusts may stand in for it: of a weak rotor, say, torques tell."""

    def __post_init__(self) -> None:
        for param in self.params:
            place(self.name, param.name)

    def is_null(self, values: Mapping[str, float]) -> bool:
        """Whether these values (absent ones at null) leave the flight as it is; "the vehicle's own" is not resolved."""
        return all(values.get(p.name, p.null) == p.null for p in self.params if not p.required)
