"""The corrected vehicle in use: the file that flies, what the companion's model takes from it, and what is left.

The simulator flies every effect of the file.  The companion's model is a point mass with a thrust axis
(`flightstack.model`): it takes mass, thrust, curve, lag, delay and drag (that of rotors as it is in
hover); the rest is its learner's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flightstack.model import Model
from flightstack.types import InputError
from flightstack.vehicle import Vehicle, parse_vehicle, vehicle_to_toml

_FIELDS = {
    "mass_kg": "kg",
    "max_thrust_n": "N",
    "thrust_model_factor": "",
    "motor_lag_s": "s",
    "transport_delay_s": "s",
    "rate_lag_s": "s",
}
_AXES = "xyz"


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """One number of the companion's model that the correction changes."""

    name: str
    unit: str
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class ControllerModelUpdate:
    """What the companion makes of a corrected vehicle."""

    takes: tuple[ParameterChange, ...]
    left_to_learner: tuple[str, ...]
    """Effects of the corrected file that its model can't express."""


def companion(believed: Vehicle, corrected: Vehicle) -> ControllerModelUpdate:
    """Numbers of the companion's model that change from one vehicle to the other, and what it leaves to its learner.

    InputError where the corrected vehicle can't carry itself: the companion would refuse it.
    """
    before, after = Model.from_vehicle(believed), Model.from_vehicle(corrected)
    takes = [ParameterChange(name, unit, getattr(before, name), getattr(after, name)) for name, unit in _FIELDS.items()]
    takes += [
        ParameterChange(f"drag_{axis}_kgps", "kg/s", old, new)
        for axis, old, new in zip(_AXES, before.drag_kgps, after.drag_kgps, strict=True)
    ]
    return ControllerModelUpdate(tuple(each for each in takes if each.before != each.after), after.left_to_learner)


def vehicle_file(corrected: Vehicle, found: Mapping[str, Mapping[str, float]]) -> str:
    """The corrected vehicle's file; InputError where a named parameter would not come back from it as it is."""
    text = vehicle_to_toml(corrected)
    back = parse_vehicle(text, "corrected vehicle")
    for effect, parameters in found.items():
        for name, value in parameters.items():
            if back.effects.get(effect, {}).get(name) != value:
                raise InputError(f"corrected vehicle: effects.{effect}.{name} is not {value:g}; report this")
    return text
