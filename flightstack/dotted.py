"""Changes to nested tables by dotted keys, `{"body.mass_kg": 1.3, "rotors.position_m.0.1": 0.1}`, vehicles too."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

from flightstack.autopilot_params import AUTOPILOT_PARAMS
from flightstack.effects import EFFECTS
from flightstack.errors import InputError
from flightstack.toml_text import toml_text
from flightstack.vehicle import TABLES, Vehicle, parse_vehicle, vehicle_to_toml

Changes = Mapping[str, object]


def changed(data: Mapping[str, object], changes: Changes, where: str) -> dict[str, object]:
    """A copy of the tables with each dotted key set; a whole number in a key is a place in a list, from 0."""
    result: dict[str, Any] = {**data}
    for key, value in changes.items():
        parts = key.split(".")
        result[parts[0]] = _set(result.get(parts[0]), parts[1:], value, f"{where}: {key}")
    return result


def _set(old: Any, parts: list[str], value: object, where: str) -> Any:
    if not parts:
        return value
    head, rest = parts[0], parts[1:]
    if head.isdecimal():
        if isinstance(old, Mapping) and "value" in old:  # a number that is known as a range: what flies is the value
            old = old["value"]
        if not isinstance(old, list) or int(head) >= len(old):
            raise InputError(f"{where}: there is no place {head} in a list there")
        return [_set(each, rest, value, where) if i == int(head) else each for i, each in enumerate(old)]
    table = dict(old) if isinstance(old, Mapping) else {}
    return table | {head: _set(table.get(head), rest, value, where)}


def flattened(data: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Nested tables as one with dotted keys."""
    flat: dict[str, object] = {}
    for key, value in data.items():
        flat |= flattened(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat


def vehicle_keys() -> list[str]:
    """Every dotted key of a vehicle file that can be changed."""
    keys = [f"{table}.{key}" for table, rows in TABLES.items() for key in rows]
    keys += [f"effects.{effect.name}.{param.name}" for effect in EFFECTS.values() for param in effect.params]
    return keys + [f"autopilot.{key}" for key in AUTOPILOT_PARAMS]


def changed_vehicle(vehicle: Vehicle, changes: Changes, source: str) -> Vehicle:
    """The vehicle with these keys of its file changed; InputError, one line, where that makes no vehicle."""
    if not changes:
        return vehicle
    text = toml_text(changed(tomllib.loads(vehicle_to_toml(vehicle)), changes, source))
    return parse_vehicle(text, source)
