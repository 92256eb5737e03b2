"""The vehicle file's text (TOML, `flightstack.vehicle/1`) and the one frozen object that it becomes.

Pure text in and out: whoever calls opens the files.  Every number is checked against a range wide enough for a 27 g
nano quadrotor and a 50 kg carrier alike; what lies outside is a typing error more often than a vehicle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from flightstack import ranges as rng
from flightstack.autopilot_params import AUTOPILOT_PARAMS
from flightstack.checked import load_toml
from flightstack.effects import EFFECTS, check_effect
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError

SCHEMA = "flightstack.vehicle/1"
LEAST_MASS_SHARE = 0.05
"""A negative payload must leave this share of the file's mass."""
_TRIANGLE_TOLERANCE = 0.05  # identified inertias break the triangle inequality by a few percent


@dataclass(frozen=True, slots=True, eq=False)
class Rotors:
    """Four rotors in PX4's order; positions from the CoM in body FRD; arrays are read-only."""

    position_m: F64
    """(4, 3) m."""
    torque_ratio_m: F64
    """(4,) reaction torque about body +z per newton of thrust, m."""
    max_thrust_n: float
    """Thrust of one rotor at full command."""
    max_speed_radps: float
    thrust_model_factor: float
    """f of thrust = max_thrust_n * (f u^2 + (1 - f) u)."""
    time_constant_s: float
    radius_m: float


@dataclass(frozen=True, slots=True)
class Battery:
    """Open-circuit voltage falls linearly with charge from full to empty; `reference_v`: where max_thrust_n holds."""

    reference_v: float
    full_v: float
    empty_v: float
    capacity_as: float
    resistance_ohm: float


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """A vehicle: body, rotors, battery (or None), effects that act on it (name -> parameter -> value), autopilot."""

    name: str
    mass_kg: float
    inertia_kgm2: F64
    """(3,) moments of inertia about the body axes FRD, read-only."""
    rotors: Rotors
    battery: Battery | None = None
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    autopilot: Mapping[str, float] = field(default_factory=dict)
    """What the file states of the autopilot (`autopilot_params`); `autopilot.autopilot_of` has all of it."""
    ranges: Mapping[str, F64] = field(default_factory=dict)
    """What is known of numbers that are given as ranges: "body.mass_kg" -> (..., 2) low and high, read-only."""

    @property
    def total_mass_kg(self) -> float:
        """The file's mass plus the payload effect (a slung load hangs and is not counted)."""
        return self.mass_kg + self.effects.get("payload", {}).get("mass_kg", 0.0)

    @property
    def weight_n(self) -> float:
        """`total_mass_kg` in standard gravity."""
        return self.total_mass_kg * STANDARD_GRAVITY_MPS2

    @property
    def max_total_thrust_n(self) -> float:
        """All four rotors at full command, effects not counted."""
        return 4.0 * self.rotors.max_thrust_n

    def __eq__(self, other: object) -> bool:
        """Same numbers and names; an effect at its null values differs from an absent one."""
        return isinstance(other, Vehicle) and vehicle_to_toml(self) == vehicle_to_toml(other)

    def __hash__(self) -> int:
        return hash(vehicle_to_toml(self))


@dataclass(frozen=True, slots=True)
class _Key:
    """One key of the file: shape () number, (n,) or (n, 3) list; allowed range of each number, both ends included."""

    minimum: float
    maximum: float
    unit: str = ""
    shape: tuple[int, ...] = ()


TABLES: dict[str, dict[str, _Key]] = {
    "body": {
        "mass_kg": _Key(0.005, 100.0, "kg"),
        "inertia_kgm2": _Key(1e-7, 100.0, "kg m^2", (3,)),
    },
    "rotors": {
        "position_m": _Key(-3.0, 3.0, "m", (4, 3)),
        "torque_ratio_m": _Key(-1.0, 1.0, "m", (4,)),
        "max_thrust_n": _Key(0.01, 1000.0, "N"),
        "max_speed_radps": _Key(10.0, 20000.0, "rad/s"),
        "thrust_model_factor": _Key(0.0, 1.0),
        "time_constant_s": _Key(0.0, 1.0, "s"),
        "radius_m": _Key(0.005, 2.0, "m"),
    },
    "battery": {
        "reference_v": _Key(1.0, 1000.0, "V"),
        "full_v": _Key(1.0, 1000.0, "V"),
        "empty_v": _Key(0.5, 1000.0, "V"),
        "capacity_as": _Key(10.0, 1e7, "A s"),
        "resistance_ohm": _Key(0.0, 10.0, "ohm"),
    },
}
_TOP_KEYS = ("name", "body", "rotors", "battery", "effects", "autopilot")


def parse_vehicle(text: str, source: str) -> Vehicle:
    """The vehicle that `text` describes; InputError in one line names `source`, the key and what is allowed."""
    data, ranges = _without_ranges(load_toml(text, source, SCHEMA, _TOP_KEYS), source)
    name = data.get("name")
    if not isinstance(name, str) or not name or not name.isprintable():
        raise InputError(f"{source}: name = {name!r} is not allowed; give the vehicle a name of printable characters")
    body = _table(data, "body", source)
    rotors = _table(data, "rotors", source)
    battery = _table(data, "battery", source) if "battery" in data else None
    effects = data.get("effects", {})
    if not isinstance(effects, Mapping):
        raise InputError(f"{source}: effects must be a table of effects, not {effects!r}")
    vehicle = Vehicle(
        name=name,
        mass_kg=float(body["mass_kg"]),
        inertia_kgm2=body["inertia_kgm2"],
        rotors=Rotors(
            position_m=rotors["position_m"],
            torque_ratio_m=rotors["torque_ratio_m"],
            max_thrust_n=float(rotors["max_thrust_n"]),
            max_speed_radps=float(rotors["max_speed_radps"]),
            thrust_model_factor=float(rotors["thrust_model_factor"]),
            time_constant_s=float(rotors["time_constant_s"]),
            radius_m=float(rotors["radius_m"]),
        ),
        battery=None if battery is None else Battery(**{key: float(value) for key, value in battery.items()}),
        autopilot=_autopilot(data.get("autopilot", {}), source),
        ranges=MappingProxyType(ranges),
    )
    _check_inertia(vehicle, source)
    if vehicle.battery is not None and not vehicle.battery.empty_v < vehicle.battery.full_v:
        raise InputError(f"{source}: battery.empty_v = {vehicle.battery.empty_v:g} must lie below battery.full_v")
    return with_effects(vehicle, effects, source=source)


def _without_ranges(data: Mapping[str, object], source: str) -> tuple[dict[str, object], dict[str, F64]]:
    """The file's tables with plain values, and what was given as a range; both ends are checked as a value is."""
    plain: dict[str, object] = dict(data)
    found: dict[str, F64] = {}
    for name, keys in TABLES.items():
        if isinstance(table := data.get(name), Mapping):
            plain[name] = {key: _split(entry, f"{name}.{key}", source, found) for key, entry in table.items()}
            for key in table:
                if key in keys and (pairs := found.get(f"{name}.{key}")) is not None:
                    for end in (pairs[..., 0], pairs[..., 1]):
                        _numbers(end.tolist(), keys[key], f"{source}: {name}.{key}.range")
    if isinstance(effects := data.get("effects"), Mapping):
        plain["effects"] = {
            name: {key: _split(entry, f"effects.{name}.{key}", source, found) for key, entry in table.items()}
            if isinstance(table, Mapping)
            else table
            for name, table in effects.items()
        }
    return plain, found


def _split(entry: object, key: str, source: str, found: dict[str, F64]) -> object:
    value, pairs = rng.split(entry, f"{source}: {key}")
    if pairs is not None:
        pairs.setflags(write=False)
        found[key] = pairs
    return value


def with_effects(vehicle: Vehicle, effects: Mapping[str, Mapping[str, float]], *, source: str = "effects") -> Vehicle:
    """The vehicle with each named effect set to these values (replacing what it had of that effect)."""
    merged = {name: dict(values) for name, values in vehicle.effects.items()}
    for name, values in effects.items():
        merged[name] = check_effect(name, values, source)
    ordered = {name: MappingProxyType(merged[name]) for name in EFFECTS if name in merged}
    changed = replace(vehicle, effects=MappingProxyType(ordered))
    _check_together(changed, source)
    return changed


def scaled(vehicle: Vehicle, *, mass_ratio: float) -> Vehicle:
    """The vehicle with its mass (inertia unchanged: the mass is added at the CoM) times `mass_ratio`."""
    key = TABLES["body"]["mass_kg"]
    mass = _numbers(vehicle.mass_kg * mass_ratio, key, "scaled vehicle: mass_kg")
    return replace(vehicle, mass_kg=float(mass))


def vehicle_to_toml(vehicle: Vehicle) -> str:
    """The file's text of a vehicle; `parse_vehicle` gives the same vehicle back, bit for bit."""
    rotors = vehicle.rotors
    lines = [f'schema = "{SCHEMA}"', f"name = {_quoted(vehicle.name)}", "", "[body]"]
    known = vehicle.ranges.get
    lines.append(f"mass_kg = {rng.to_toml(vehicle.mass_kg, known('body.mass_kg'))}")
    lines.append(f"inertia_kgm2 = {rng.to_toml(vehicle.inertia_kgm2, known('body.inertia_kgm2'))}")
    lines += ["", "[rotors]"]
    lines += [f"{key} = {rng.to_toml(getattr(rotors, key), known(f'rotors.{key}'))}" for key in TABLES["rotors"]]
    if vehicle.battery is not None:
        lines += ["", "[battery]"]
        cell = vehicle.battery
        lines += [f"{key} = {rng.to_toml(getattr(cell, key), known(f'battery.{key}'))}" for key in TABLES["battery"]]
    if vehicle.autopilot:
        lines += [
            "",
            "[autopilot]",
            *(f"{key} = {rng.to_toml(value, None)}" for key, value in vehicle.autopilot.items()),
        ]
    for name, values in vehicle.effects.items():
        lines += ["", f"[effects.{name}]"]
        lines += [f"{key} = {rng.to_toml(value, known(f'effects.{name}.{key}'))}" for key, value in values.items()]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _table(data: Mapping[str, object], name: str, source: str) -> dict[str, F64]:
    """One table of the file with all its keys, each checked."""
    table = data.get(name)
    if not isinstance(table, Mapping):
        raise InputError(f"{source}: the table [{name}] is missing")
    keys = TABLES[name]
    for key in table:
        if key not in keys:
            raise InputError(f"{source}: unknown key {name}.{key}; known are {', '.join(keys)}")
    for key in keys:
        if key not in table:
            raise InputError(f"{source}: {name}.{key} is missing; give it in {_allowed(keys[key])}")
    return {key: _numbers(table[key], keys[key], f"{source}: {name}.{key}") for key in keys}


def _autopilot(table: object, source: str) -> Mapping[str, float]:
    """What `[autopilot]` states, in the table's order; any key may be left out."""
    if not isinstance(table, Mapping):
        raise InputError(f"{source}: autopilot must be a table, not {table!r}")
    for key in table:
        if key not in AUTOPILOT_PARAMS:
            raise InputError(f"{source}: unknown key autopilot.{key}; known are {', '.join(AUTOPILOT_PARAMS)}")
    stated = {}
    for key, param in AUTOPILOT_PARAMS.items():
        if key in table:
            value = _numbers(table[key], _Key(param.minimum, param.maximum), f"{source}: autopilot.{key}")
            stated[key] = float(value)
    if stated.get("airmode", 0.0) % 1.0:
        raise InputError(f"{source}: autopilot.airmode = {stated['airmode']:g} is not allowed; it must be 0, 1 or 2")
    return MappingProxyType(stated)


def _allowed(key: _Key) -> str:
    each = f"{key.minimum:g} to {key.maximum:g}" + (f" {key.unit}" if key.unit else "")
    if not key.shape:
        return each
    rows = f"{key.shape[0]} lists of {key.shape[1]}" if len(key.shape) == 2 else f"a list of {key.shape[0]}"
    return f"{rows} numbers, each {each}"


def _numbers(value: object, key: _Key, where: str) -> F64:
    """`value` as a read-only float64 array of the key's shape, every number within the key's range."""

    def is_right(item: object, shape: tuple[int, ...]) -> bool:
        if shape:
            return isinstance(item, list) and len(item) == shape[0] and all(is_right(part, shape[1:]) for part in item)
        is_number = isinstance(item, int | float) and not isinstance(item, bool)
        return is_number and key.minimum <= item <= key.maximum  # type: ignore[operator]

    if not is_right(value, key.shape):
        raise InputError(f"{where} = {value!r} is not allowed; it must be {_allowed(key)}")
    array = np.array(value, dtype=np.float64)
    array.setflags(write=False)
    return array


def _check_inertia(vehicle: Vehicle, source: str) -> None:
    """No body has a moment of inertia greater than the sum of the other two."""
    for axis in range(3):
        largest = vehicle.inertia_kgm2[axis]
        others = float(vehicle.inertia_kgm2.sum() - largest)
        if largest > others * (1.0 + _TRIANGLE_TOLERANCE):
            raise InputError(
                f"{source}: body.inertia_kgm2 = {vehicle.inertia_kgm2.tolist()} is impossible (triangle inequality): "
                f"I{'xyz'[axis] * 2} = {largest:g} must not exceed the sum of the other two, {others:g} kg m^2"
            )


def _check_together(vehicle: Vehicle, source: str) -> None:
    """What only shows in effects and vehicle together."""
    if vehicle.total_mass_kg < LEAST_MASS_SHARE * vehicle.mass_kg:
        payload = vehicle.effects["payload"]["mass_kg"]
        least = (LEAST_MASS_SHARE - 1.0) * vehicle.mass_kg
        raise InputError(
            f"{source}: effects.payload.mass_kg = {payload:g} leaves {vehicle.total_mass_kg:g} kg; "
            f"it must be at least {least:g} kg for this vehicle"
        )
    if vehicle.battery is None and vehicle.effects.get("battery_sag", {}).get("thrust_loss_per_v", 0.0) != 0.0:
        raise InputError(f"{source}: effects.battery_sag needs a [battery]; add that table or leave the effect out")
