"""PX4's parameters: one table, and a vehicle's own copy of its values.

Names, types, defaults and units are PX4's (its public parameter reference); the defaults are those that a PX4 with its
internal simulator reported.  Only parameters that the simulated autopilot acts on, or that offboard clients commonly
read, are here.  A few defaults follow the vehicle file instead (`vehicle_defaults`): the hover thrust and the
rotors' places, and the rate loops' K, which PX4 tunes for each airframe.
"""

from __future__ import annotations

import math
import tomllib
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from importlib import resources
from typing import Any

from flightstack.autopilot import float32
from flightstack.types import InputError


class ParamType(IntEnum):
    """MAV_PARAM_TYPE of the two types that PX4 uses."""

    INT32 = 6
    REAL32 = 9


class ParamResult(IntEnum):
    """Outcome of setting a parameter; the numbers are MAVLink's MAV_PARAM_ERROR."""

    OK = 0
    DOES_NOT_EXIST = 1
    VALUE_OUT_OF_RANGE = 2
    READ_ONLY = 5
    TYPE_MISMATCH = 7


@dataclass(frozen=True, slots=True)
class Px4ParamSpec:
    """One parameter: its PX4 name, type, default, allowed range (inclusive), unit and meaning."""

    name: str
    type: ParamType
    default: float
    minimum: float
    maximum: float
    unit: str
    text: str


def _spec(name: str, row: Sequence[Any]) -> Px4ParamSpec:
    """A row of the table: default, least, most, unit, meaning; a whole default is an INT32's."""
    default, minimum, maximum, unit, text = row
    if isinstance(default, int):
        return Px4ParamSpec(name, ParamType.INT32, default, minimum, maximum, unit, text)
    return Px4ParamSpec(name, ParamType.REAL32, float32(default), minimum, maximum, unit, text)


_TABLE = tomllib.loads(resources.files(__package__).joinpath("px4_params.toml").read_text(encoding="utf-8"))
PARAMS: tuple[Px4ParamSpec, ...] = tuple(_spec(name, row) for name, row in sorted(_TABLE.items()))
"""The table, in index order (by name, as PX4 lists them)."""
_NAMES = tuple(spec.name for spec in PARAMS)


def find(name: str) -> int | None:
    """Index of the parameter with this name, None where there is none."""
    index = bisect_left(_NAMES, name)
    return index if index < len(_NAMES) and _NAMES[index] == name else None


class Params:
    """One vehicle's parameter values.

    `set` never raises (values come over the wire); the constructor raises InputError.  `version` counts changes, so
    that loops can tell that they must read their gains again.
    """

    __slots__ = ("_values", "version")

    def __init__(self, values: Mapping[str, float] | None = None) -> None:
        self._values = [spec.default for spec in PARAMS]
        self.version = 0
        for name, value in (values or {}).items():
            result = self.set(name, value)
            if result is ParamResult.DOES_NOT_EXIST:
                raise InputError(f"parameter {name} does not exist; use one of the table in sim/autopilot/params.py")
            if result is not ParamResult.OK:
                spec = PARAMS[_index(name)]
                allowed = f"{spec.type.name} from {spec.minimum:g} to {spec.maximum:g}"
                raise InputError(f"parameter {name} = {value}: must be {allowed}")

    def __len__(self) -> int:
        return len(PARAMS)

    def get(self, name: str) -> float:
        """Value by name (an INT32's is whole); KeyError for a name outside the table."""
        return self._values[_index(name)]

    def at(self, index: int) -> float:
        """Value by index, 0 to len - 1."""
        return self._values[index]

    def set(self, name: str, value: float, type_: ParamType | None = None) -> ParamResult:
        """Set by name; `type_` is the type that the sender claims, None to take the table's."""
        index = find(name)
        if index is None:
            return ParamResult.DOES_NOT_EXIST
        spec = PARAMS[index]
        if type_ is not None and type_ != spec.type:
            return ParamResult.TYPE_MISMATCH
        if not math.isfinite(value) or (spec.type is ParamType.INT32 and value != int(value)):
            return ParamResult.VALUE_OUT_OF_RANGE
        low, high = spec.minimum, spec.maximum
        if spec.type is ParamType.REAL32:  # the limits too are what 32 bits can hold
            if abs(value) > 3.0e38:
                return ParamResult.VALUE_OUT_OF_RANGE
            value, low, high = float32(value), float32(low), float32(high)
        if not low <= value <= high:
            return ParamResult.VALUE_OUT_OF_RANGE
        if value != self._values[index]:
            self._values[index] = value
            self.version += 1
        return ParamResult.OK


def _index(name: str) -> int:
    index = find(name)
    if index is None:
        raise KeyError(name)
    return index
