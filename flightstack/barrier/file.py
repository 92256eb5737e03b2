"""A certificate as a file: JSON text with schema "flightstack.certificate/6", every number exact, sealed.

    schema, mode, version, centre_ned_m, delta, k_sigma
    budget      as `records.Budget`
    axes        each: axis (its name), barrier (kind and parameters), setting, response, authority (one list a column),
                margins, cells (rows of six numbers)
    premises    for what it holds (`premises`); null as published
    governor    what bounds torque while it is in force (`torque`); null as published
    knowledge   what the bounds rest on, as `knowledge` wrote it
    seal        SHA-256 of the rest in canonical form: keys sorted, no blanks, ASCII, shortest exact numbers

The seal finds damage; whether the numbers are right is for `flightstack.certificate_check`, which shares nothing with
this module.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from typing import Any, NoReturn, TypeVar

import numpy as np

from flightstack.barrier import records
from flightstack.barrier.condition import Setting
from flightstack.barrier.confidence import confidence_table
from flightstack.barrier.premises import parse_premises, premises_table
from flightstack.barrier.provenance import parse_provenance
from flightstack.barrier.records import AXES, MARGINS, Authority, AxisCertificate, Certificate, Margin
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping
from flightstack.barrier.torque import parse_governor
from flightstack.checked import number, only, vector, words
from flightstack.types import InputError

SCHEMA = "flightstack.certificate/6"
MODES = ("sound", "as-published")
_LARGEST = 1e12
_DEPTH = 32
_BARRIERS: dict[str, type[Barrier]] = {"quadratic": Quadratic, "stopping": Stopping}
_TOP = (
    "schema",
    "mode",
    "version",
    "centre_ned_m",
    "delta",
    "k_sigma",
    "budget",
    "axes",
    "premises",
    "governor",
    "provenance",
    "confidence",
    "knowledge",
    "seal",
)
_AXIS = ("axis", "barrier", "setting", "response", "authority", "margins", "cells")
_CELL = 6
T = TypeVar("T")


def certificate_to_json(certificate: Certificate) -> str:
    """The file's text; raises InputError where a number is not finite or the knowledge is not plain JSON."""
    data: dict[str, object] = {
        "schema": SCHEMA,
        "mode": certificate.mode,
        "version": certificate.version,
        "centre_ned_m": list(certificate.centre_ned_m),
        "delta": certificate.delta,
        "k_sigma": certificate.k_sigma,
        "budget": asdict(certificate.budget),
        "axes": [_axis_table(axis) for axis in certificate.axes],
        "premises": None if certificate.premises is None else premises_table(certificate.premises),
        "governor": None if certificate.governor is None else asdict(certificate.governor),
        "provenance": None if certificate.provenance is None else certificate.provenance.as_json(),
        "confidence": confidence_table(certificate.delta, certificate.k_sigma),
        "knowledge": certificate.knowledge,
    }
    try:
        data["seal"] = seal(data)
        return _laid_out(data) + "\n"
    except (TypeError, ValueError) as error:
        raise InputError(f"certificate: not to be written: {error}") from None


def parse_certificate(text: str, source: str) -> Certificate:
    """The certificate of a file's text; raises InputError, one line that names the key."""
    data = _loaded(text, source)
    only(data, _TOP, source)
    if data.get("schema") != SCHEMA:
        raise InputError(f'{source}: schema = {_short(data.get("schema"))} is not known; this version reads "{SCHEMA}"')
    missing = [key for key in _TOP if key not in data]
    if missing:
        raise InputError(f"{source}: {missing[0]} is missing")
    if data["seal"] != seal(data):
        raise InputError(f"{source}: seal does not fit: the file was changed after it was made; certify anew")
    if data["mode"] not in MODES:
        raise InputError(f"{source}: mode = {_short(data['mode'])} is not known; known are {', '.join(MODES)}")
    axes = tuple(_axis(entry, f"{source}: axes[{i}]") for i, entry in enumerate(_list(data["axes"], f"{source}: axes")))
    if not axes or len({axis.axis for axis in axes}) != len(axes):
        raise InputError(f"{source}: axes must name each axis once, at least one")
    return Certificate(
        mode=str(data["mode"]),
        centre_ned_m=vector(data["centre_ned_m"], f"{source}: centre_ned_m", -1e6, 1e6),
        axes=axes,
        budget=_record(records.Budget, data["budget"], f"{source}: budget"),
        delta=number(data["delta"], f"{source}: delta", 0.0, 1.0),
        k_sigma=number(data["k_sigma"], f"{source}: k_sigma", 0.0, 1e6),
        knowledge=dict(_table(data["knowledge"], f"{source}: knowledge")),
        version=_whole(data["version"], f"{source}: version"),
        premises=None if data["premises"] is None else parse_premises(data["premises"], f"{source}: premises"),
        governor=None if data["governor"] is None else parse_governor(data["governor"], f"{source}: governor"),
        provenance=None
        if data["provenance"] is None
        else parse_provenance(data["provenance"], f"{source}: provenance"),
    )


def seal(data: Mapping[str, object]) -> str:
    """SHA-256 (hex) of the canonical text of all but the seal."""
    rest = {key: value for key, value in data.items() if key != "seal"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def _axis_table(axis: AxisCertificate) -> dict[str, object]:
    kind = next(name for name, shape in _BARRIERS.items() if isinstance(axis.barrier, shape))
    return {
        "axis": AXES[axis.axis],
        "barrier": {"kind": kind, **asdict(axis.barrier)},
        "setting": axis.setting._asdict(),
        "response": asdict(axis.response),
        "authority": {part.name: getattr(axis.authority, part.name).tolist() for part in fields(Authority)},
        "margins": [asdict(margin) for margin in axis.margins],
        "cells": axis.cells.tolist(),
    }


def _axis(value: object, where: str) -> AxisCertificate:
    table = _table(value, where, _AXIS)
    if table["axis"] not in AXES:
        raise InputError(f"{where}.axis = {_short(table['axis'])} is not known; known are {', '.join(AXES)}")
    rows = _list(table["cells"], f"{where}.cells")
    cells = [_numbers(row, f"{where}.cells[{i}]") for i, row in enumerate(rows)]
    wrong = [i for i, row in enumerate(cells) if len(row) != _CELL]
    if wrong:
        raise InputError(f"{where}.cells[{wrong[0]}] must have {_CELL} numbers: e_low, e_high, v_low, v_high, u, q")
    margins = _list(table["margins"], f"{where}.margins")
    return AxisCertificate(
        axis=AXES.index(str(table["axis"])),
        barrier=_barrier(table["barrier"], f"{where}.barrier"),
        setting=_record(Setting, table["setting"], f"{where}.setting"),
        response=_record(records.Response, table["response"], f"{where}.response"),
        authority=_authority(table["authority"], f"{where}.authority"),
        margins=tuple(_margin(entry, f"{where}.margins[{i}]") for i, entry in enumerate(margins)),
        cells=np.array(cells, np.float64).reshape(-1, _CELL),
    )


def _barrier(value: object, where: str) -> Barrier:
    kind = _table(value, where).get("kind")
    if not isinstance(kind, str) or kind not in _BARRIERS:
        raise InputError(f"{where}.kind = {_short(kind)} is not known; known are {', '.join(_BARRIERS)}")
    rest = {key: part for key, part in _table(value, where).items() if key != "kind"}
    try:
        return _record(Quadratic, rest, where) if kind == "quadratic" else _record(Stopping, rest, where)
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(where) else f"{where}: {text}") from None


def _authority(value: object, where: str) -> Authority:
    names = [part.name for part in fields(Authority)]
    table = _table(value, where, names)
    columns = {name: np.array(_numbers(table[name], f"{where}.{name}"), np.float64) for name in names}
    for name, column in columns.items():
        if len(column) < 2 or len(column) != len(columns["v_mps"]):
            raise InputError(f"{where}.{name} has {len(column)} numbers; all columns need as many, at least 2")
    if not np.all(np.diff(columns["v_mps"]) > 0.0):
        raise InputError(f"{where}.v_mps must increase")
    return Authority(**columns)


def _margin(value: object, where: str) -> Margin:
    table = _table(value, where, ("name", "mps2", "because"))
    if table["name"] not in MARGINS:
        raise InputError(f"{where}.name = {_short(table['name'])} is not known; known are {', '.join(MARGINS)}")
    mps2 = number(table["mps2"], f"{where}.mps2", 0.0, _LARGEST)
    return Margin(str(table["name"]), mps2, words(table["because"], f"{where}.because"))


def _record(kind: Callable[..., T], value: object, where: str) -> T:
    """A record (data class or named tuple) whose fields are all numbers."""
    names = getattr(kind, "_fields", None) or [part.name for part in fields(kind)]  # type: ignore[arg-type]
    table = _table(value, where, names)
    return kind(**{name: number(table[name], f"{where}.{name}", -_LARGEST, _LARGEST) for name in names})


def _loaded(text: str, source: str) -> dict[str, Any]:
    """The top table: strict JSON, no key twice, no number that is not finite, not deep."""

    def once(pairs: list[tuple[str, object]]) -> dict[str, object]:
        found = dict(pairs)
        if len(found) != len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"{source}: key {_short(twice)} is there twice")
        return found

    def finite(digits: str) -> float:
        value = float(digits)
        if not np.isfinite(value):
            raise InputError(f"{source}: {digits[:40]} is not a finite number")
        return value

    def constant(name: str) -> NoReturn:
        raise InputError(f"{source}: {name} is not a finite number")

    try:
        data = json.loads(text, object_pairs_hook=once, parse_float=finite, parse_constant=constant)
    except json.JSONDecodeError as error:
        raise InputError(f"{source}: not valid JSON: {error}") from None
    except RecursionError:
        raise InputError(f"{source}: nested too deep") from None
    except InputError:
        raise
    except ValueError:
        raise InputError(f"{source}: a number has too many digits") from None
    if not isinstance(data, dict):
        raise InputError(f"{source}: must be a JSON object")
    if _depth(data, 0) > _DEPTH:
        raise InputError(f"{source}: nested too deep")
    return data


def _depth(value: object, level: int) -> int:
    parts = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else []
    if level > _DEPTH or not parts:
        return level
    return max(_depth(part, level + 1) for part in parts)


def _table(value: object, where: str, names: Any = None) -> Mapping[str, object]:
    """A table; with `names`, of exactly these keys."""
    if not isinstance(value, Mapping):
        raise InputError(f"{where} = {_short(value)} must be a table")
    if names is not None:
        only(value, names, where)
        missing = [name for name in names if name not in value]
        if missing:
            raise InputError(f"{where}.{missing[0]} is missing")
    return value


def _list(value: object, where: str) -> list[object]:
    if not isinstance(value, list):
        raise InputError(f"{where} = {_short(value)} must be a list")
    return value


def _numbers(value: object, where: str) -> list[float]:
    return [number(part, f"{where}[{i}]", -_LARGEST, _LARGEST) for i, part in enumerate(_list(value, where))]


def _whole(value: object, where: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**53:
        raise InputError(f"{where} = {_short(value)} must be a whole number from 0")
    return value


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:60] + "..."


def _laid_out(value: object, indent: str = "") -> str:
    """JSON with one line for each key and each row of numbers."""
    deeper = indent + "  "
    if isinstance(value, dict) and value:
        parts = [f"{deeper}{json.dumps(key)}: {_laid_out(part, deeper)}" for key, part in value.items()]
        return "{\n" + ",\n".join(parts) + f"\n{indent}}}"
    if isinstance(value, list | tuple) and any(isinstance(part, list | tuple | dict) for part in value):
        return "[\n" + ",\n".join(deeper + _laid_out(part, deeper) for part in value) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False)


__all__ = ["SCHEMA", "certificate_to_json", "parse_certificate", "seal"]
