"""What the columns of a foreign table mean: a TOML file (`flightstack.columns/1`) and its use on a table.

Each section names columns and says their unit and frame; the result is in SI, NED and FRD under this project's names
(`pos_ned_m`, `q_ned_frd`, ...).  A section may be given several times (`[[attitude]]`): the first whose columns are
all there is used.  The format is documented in docs/gap-logs.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flightstack.checked import read_toml
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError
from flightstack_logs.turn import body_to_frd, euler_to_quaternion, multiply, world_to_ned

SCHEMA = "flightstack.columns/1"
_DEG = np.pi / 180.0
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048}
_SPEED = {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1.0 / 3.6, "ft/s": 0.3048}
_ACCELERATION = {"m/s^2": 1.0, "cm/s^2": 1e-2, "g": STANDARD_GRAVITY_MPS2, "mg": 1e-3 * STANDARD_GRAVITY_MPS2}
_RATE = {"rad/s": 1.0, "deg/s": _DEG, "mrad/s": 1e-3}
_ANGLE = {"rad": 1.0, "deg": _DEG}
_VOLTAGE = {"V": 1.0, "mV": 1e-3}
_WORLDS, _BODIES = ("ned", "enu", "nwu"), ("frd", "flu")
_VECTORS = (*_WORLDS, "neu")
_MOST = 1e9
"""What is greater is no measurement, whatever its unit."""
PLACES = ("front right", "rear left", "front left", "rear right")
"""Where rotors can sit, in PX4's order."""


@dataclass(frozen=True, slots=True)
class _Section:
    """What a section of the file may say; `units`' first is the default."""

    signal: str
    count: int
    units: Mapping[str, float]
    keys: tuple[str, ...] = ()


_SECTIONS: dict[str, _Section] = {
    "position": _Section("pos_ned_m", 3, _LENGTH, ("frame",)),
    "velocity": _Section("vel_ned_mps", 3, _SPEED, ("frame",)),
    "kinematic_acceleration": _Section("acc_ned_mps2", 3, _ACCELERATION, ("frame",)),
    "attitude": _Section("q_ned_frd", 4, _ANGLE, ("order", "world", "body", "inverse")),
    "rates": _Section("rate_frd_radps", 3, _RATE, ("frame",)),
    "specific_force": _Section("accel_frd_mps2", 3, _ACCELERATION, ("frame",)),
    "motors": _Section("motor", 4, {"": 1.0}, ("zero", "full", "places")),
    "rotor_speeds": _Section("rotor_speed_radps", 4, {"rpm": np.pi / 30.0, "rad/s": 1.0}, ("places",)),
    "battery": _Section("battery_v", 1, _VOLTAGE),
    "height": _Section("height_m", 1, _LENGTH),
    "landed": _Section("landed", 1, {"": 1.0}),
}
_FRAMES = {"position": _VECTORS, "velocity": _VECTORS, "kinematic_acceleration": _VECTORS, "rates": _BODIES,
           "specific_force": _BODIES}  # fmt: skip
_ORDERS = ("wxyz", "xyzw", "rpy")


@dataclass(frozen=True, slots=True)
class ColumnEntry:
    """One section: which columns, and how they become a signal."""

    section: str
    columns: tuple[str, ...]
    scale: float
    signs: tuple[float, ...]
    said: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ColumnMap:
    """A whole file."""

    source: str
    time: tuple[str, float] | None
    """Column and its unit in seconds; None where the log has stamps of its own."""
    entries: tuple[ColumnEntry, ...]
    lenient: bool
    """Sections whose columns a log lacks are left out; else they are an error."""


def parse_columns(text: str, source: str) -> ColumnMap:
    """The map that `text` describes; InputError in one line names `source`, the key and what is allowed."""
    data = read_toml(text, source)
    if data.pop("schema", None) != SCHEMA:
        raise InputError(f'{source}: schema must be "{SCHEMA}" (see docs/gap-logs.md)')
    lenient = data.pop("lenient", False)
    time = _time(data.pop("time", None), source)
    entries = []
    for name, said in data.items():
        if name not in _SECTIONS:
            raise InputError(f"{source}: unknown section [{name}]; known are time, {', '.join(_SECTIONS)}")
        for part in said if isinstance(said, list) else [said]:
            if not isinstance(part, dict):
                raise InputError(f"{source}: {name} must be a section with columns, not {part!r}")
            entries.append(_entry(name, part, source))
    if not entries:
        raise InputError(f"{source}: names no column; give at least [velocity] or [specific_force]")
    return ColumnMap(source, time, tuple(entries), bool(lenient))


def _time(said: Any, source: str) -> tuple[str, float] | None:
    if said is None:
        return None
    if not isinstance(said, dict) or set(said) - {"column", "unit"} or not isinstance(said.get("column"), str):
        raise InputError(f'{source}: [time] needs column = "NAME" and unit = "s", "ms", "us" or "ns"')
    return said["column"], _choice(said, "unit", _TIME, "s", f"{source}: time")


def _choice(said: Mapping[str, Any], key: str, known: Mapping[str, float], default: str, where: str) -> float:
    value = said.get(key, default)
    if not isinstance(value, str) or value not in known:
        raise InputError(f"{where}.{key} = {value!r} is not known; use one of {', '.join(map(repr, known))}")
    return known[value]


def _entry(name: str, said: dict[str, Any], source: str) -> ColumnEntry:
    section, where = _SECTIONS[name], f"{source}: {name}"
    columns = said.get("columns", [said["column"]] if "column" in said else None)
    if not isinstance(columns, list) or not all(isinstance(column, str) for column in columns):
        raise InputError(f"{where}.columns must be a list of column names")
    count = 3 if name == "attitude" and said.get("order") == "rpy" else section.count
    if len(columns) != count:
        raise InputError(f"{where}.columns names {len(columns)} columns; it takes {count}")
    for key in said:
        if key not in ("columns", "column", "unit", "signs", *section.keys):
            raise InputError(f"{where}: unknown key {key}")
    _check_words(name, said, where)
    signs = said.get("signs", [1] * count)
    if not isinstance(signs, list) or len(signs) != count or any(sign not in (1, -1) for sign in signs):
        raise InputError(f"{where}.signs must be {count} times 1 or -1")
    scale = _choice(said, "unit", section.units, next(iter(section.units)), where)
    return ColumnEntry(name, tuple(columns), scale, tuple(float(sign) for sign in signs), said)


def _check_words(name: str, said: Mapping[str, Any], where: str) -> None:
    """Frames, orders, ranges."""
    words = {"frame": (*_FRAMES.get(name, ()), *(_BODIES if name == "velocity" else ())), "order": _ORDERS,
             "world": _WORLDS, "body": _BODIES, "inverse": (True, False)}  # fmt: skip
    for key, allowed in words.items():
        if key in said and said[key] not in allowed:
            raise InputError(f"{where}.{key} = {said[key]!r} is not known; use one of {', '.join(map(str, allowed))}")
    for key in ("zero", "full"):
        if key in said and (isinstance(said[key], bool) or not isinstance(said[key], int | float)):
            raise InputError(f"{where}.{key} = {said[key]!r} must be a number")
    if said.get("zero", 0.0) == said.get("full", 1.0):
        raise InputError(f"{where}: zero and full are the same; they are the values at command 0 and at command 1")
    places = said.get("places")
    if places is not None and (not isinstance(places, list) or sorted(map(str, places)) != sorted(PLACES)):
        raise InputError(f"{where}.places must name each of {', '.join(PLACES)} once, in the order of columns")


def apply(
    columns: ColumnMap, table: Mapping[str, np.ndarray], where: str
) -> tuple[dict[str, F64], dict[str, str], dict[str, tuple[str, ...]]]:
    """(signal -> values, signal -> columns it came from, places of the motors) of a table; InputError where one lacks.

    Motors come in the order of the columns; where the map names the rotors' places these are the third result.
    """
    signals: dict[str, F64] = {}
    sources: dict[str, str] = {}
    places: dict[str, tuple[str, ...]] = {}
    for entry in columns.entries:
        signal = _SECTIONS[entry.section].signal
        missing = [name for name in entry.columns if name not in table]
        if missing or signal in signals:
            if missing and not columns.lenient:
                raise InputError(f"{where}: has no column {missing[0]}, which {columns.source} names; it has "
                                 f"{', '.join(list(table)[:40])}")  # fmt: skip
            continue
        raw = np.stack([np.asarray(table[name], np.float64) for name in entry.columns], axis=-1)
        raw = np.where(np.abs(raw) < _MOST, raw, np.nan)
        signals[signal] = _signal(entry, raw * entry.scale * np.array(entry.signs))
        sources[signal] = ", ".join(entry.columns)
        if "places" in entry.said:
            places[signal] = tuple(entry.said["places"])
    velocity = next((entry for entry in columns.entries if entry.section == "velocity"), None)
    if velocity is not None and velocity.said.get("frame") in _BODIES and "vel_ned_mps" in signals:
        _turn_velocity(signals, where)
    return signals, sources, places


def _signal(entry: ColumnEntry, raw: F64) -> F64:
    said = entry.said
    if entry.section == "attitude":
        return _attitude(said, raw / entry.scale if said.get("order") != "rpy" else raw)
    if entry.section == "motors":
        zero, full = float(said.get("zero", 0.0)), float(said.get("full", 1.0))
        return (raw - zero) / (full - zero)
    if entry.section in _FRAMES:
        frame = said.get("frame", "frd" if _FRAMES[entry.section] is _BODIES else "ned")
        return body_to_frd(raw, frame) if frame in _BODIES else world_to_ned(raw, frame)
    return raw if entry.section == "rotor_speeds" else raw[:, 0]


def _attitude(said: Mapping[str, Any], raw: F64) -> F64:
    """Quaternion body FRD to NED, scalar first, of any of the forms that a section may say."""
    order = said.get("order", "wxyz")
    q = euler_to_quaternion(raw) if order == "rpy" else raw[:, [3, 0, 1, 2]] if order == "xyzw" else raw.copy()
    if said.get("inverse", False):
        q[:, 1:] *= -1.0
    world, body = said.get("world", "ned"), said.get("body", "frd")
    if body == "flu":
        q = multiply(q, np.array([[0.0, 1.0, 0.0, 0.0]]))
    turn = {"ned": (1.0, 0.0, 0.0, 0.0), "nwu": (0.0, 1.0, 0.0, 0.0), "enu": (0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0)}
    return multiply(np.array([turn[world]]), q)


def _turn_velocity(signals: dict[str, F64], where: str) -> None:
    from flightstack_logs.turn import rotate

    if "q_ned_frd" not in signals:
        raise InputError(f"{where}: its velocity is in the body frame, which takes an attitude too; name its columns")
    q = signals["q_ned_frd"]
    size = np.linalg.norm(q, axis=1, keepdims=True)
    signals["vel_ned_mps"] = rotate(q / np.where(size > 0.0, size, 1.0), signals["vel_ned_mps"])
