"""The numbers of a vehicle file one by one: key, value, what is known of each, and a vehicle with other numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.types import F64
from flightstack.vehicle import TABLES, Vehicle


@dataclass(frozen=True, slots=True)
class FileNumber:
    """One number of a vehicle file."""

    key: str
    """As in the file: "rotors.position_m"."""
    index: tuple[int, ...]
    """Of the number in its list; () for a plain number."""
    value: float
    low: float
    high: float
    """Ends of its range; both the value where the file has a plain number."""
    minimum: float
    maximum: float
    """What the file may hold."""
    unit: str

    @property
    def name(self) -> str:
        """The key with the place in its list: "body.inertia_kgm2[0]"."""
        return self.key + "".join(f"[{i}]" for i in self.index)

    @property
    def is_ranged(self) -> bool:
        """Whether the file says that the number is known within a range only."""
        return self.high > self.low

    @property
    def is_of_mass(self) -> bool:
        """Whether it has mass in its unit: all such numbers times two leave every acceleration as it was."""
        return "kg" in self.unit or self.unit.startswith("N")


def file_numbers(vehicle: Vehicle) -> tuple[FileNumber, ...]:
    """All numbers of body, rotors, battery and effects, in the file's order; whole numbers of effects left out."""
    found: list[FileNumber] = []
    for table, keys in TABLES.items():
        if table == "battery" and vehicle.battery is None:
            continue
        for key, allowed in keys.items():
            values = np.asarray(_stored(vehicle, f"{table}.{key}"), dtype=np.float64)
            found += _numbers(vehicle, f"{table}.{key}", values, (allowed.minimum, allowed.maximum), allowed.unit)
    for effect, told in vehicle.effects.items():
        for spec in EFFECTS[effect].params:
            if spec.name in told and not spec.integer:
                value = np.asarray(told[spec.name], dtype=np.float64)
                key = f"effects.{effect}.{spec.name}"
                found += _numbers(vehicle, key, value, (spec.minimum, spec.maximum), spec.unit)
    return tuple(found)


def with_numbers(vehicle: Vehicle, values: Mapping[FileNumber, float]) -> Vehicle:
    """The vehicle with these numbers, ranges as they were; nothing is checked but the list's shape."""
    arrays: dict[str, F64] = {}
    for number, value in values.items():
        if number.key not in arrays:
            arrays[number.key] = np.array(_stored(vehicle, number.key), dtype=np.float64)
        arrays[number.key][number.index] = value
    changed = vehicle
    for key, array in arrays.items():
        array.setflags(write=False)
        changed = _with(changed, key, array if array.ndim else float(array))
    return changed


def _numbers(vehicle: Vehicle, key: str, values: F64, allowed: tuple[float, float], unit: str) -> list[FileNumber]:
    pairs = vehicle.ranges.get(key)
    found = []
    for index in np.ndindex(values.shape):
        value = float(values[index])
        low, high = (value, value) if pairs is None else (float(pairs[index][0]), float(pairs[index][1]))
        found.append(FileNumber(key, index, value, low, high, *allowed, unit))
    return found


def _stored(vehicle: Vehicle, key: str) -> F64 | float:
    table, name, *parameter = key.split(".")
    if table == "effects":
        return vehicle.effects[name][parameter[0]]
    holder: object = {"body": vehicle, "rotors": vehicle.rotors, "battery": vehicle.battery}[table]
    value: F64 | float = getattr(holder, name)
    return value


def _with(vehicle: Vehicle, key: str, value: Any) -> Vehicle:
    table, name, *parameter = key.split(".")
    if table == "effects":
        changed = MappingProxyType({**vehicle.effects[name], parameter[0]: value})
        return replace(vehicle, effects=MappingProxyType({**vehicle.effects, name: changed}))
    if table == "body":
        return replace(vehicle, **{name: value})
    if table == "rotors":
        return replace(vehicle, rotors=replace(vehicle.rotors, **{name: value}))
    assert vehicle.battery is not None
    return replace(vehicle, battery=replace(vehicle.battery, **{name: value}))
