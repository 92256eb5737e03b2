"""Reading a certificate's text strictly: the seal, exact keys, finite numbers."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np

from .intervals import F64


class Refused(Exception):
    """The first thing that is not so."""


MARGINS = (
    "gp_error", "thrust_gain", "discretisation", "zero_order_hold", "delay", "rotor_lag", "attitude_lag",
    "estimate_error",
)  # fmt: skip
_KINDS = {
    "quadratic": ("centre_m", "centre_mps", "p11", "p12", "p22"),
    "stopping": ("low_m", "high_m", "reaction_s", "brake_high_mps2", "brake_low_mps2"),
}
_AUTHORITY = ("v_mps", "offset_mps2", "gain", "u_low_mps2", "u_high_mps2", "error_low_mps2", "error_high_mps2")
_LARGEST = 1e9


def number(value: Any, where: str) -> float:
    """A finite number of no wild size."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) <= _LARGEST:
        raise Refused(f"{where} must be a number of at most {_LARGEST:g}")
    return float(value)


def column(value: Any, x: F64, where: str) -> int:
    """A column of x (n, d)."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < x.shape[1]:
        raise Refused(f"{where}: a column is not one of the {x.shape[1]} columns of the points")
    return value


def table_of(value: Any, keys: tuple[str, ...], where: str) -> dict[str, Any]:
    """A table of exactly these keys."""
    if not isinstance(value, dict):
        raise Refused(f"{where} must be a table")
    for key in (*keys, *value):
        if (key in keys) != (key in value):
            raise Refused(f"{where}.{key[:40]} is {'missing' if key in keys else 'not known'}")
    return value


def numbers(value: Any, keys: tuple[str, ...], where: str) -> list[float]:
    """The numbers of a table of numbers, in the order of its keys."""
    table = table_of(value, keys, where)
    return [number(table[key], f"{where}.{key}") for key in keys]


def rows(value: Any, width: int, where: str) -> F64:
    """(n, width) a list of rows of numbers, n at least 1."""
    if not isinstance(value, list) or not value:
        raise Refused(f"{where} must be a list of rows")
    for i, row in enumerate(value):
        if not isinstance(row, list) or len(row) != width:
            raise Refused(f"{where}[{i}] must be a row of {width} numbers")
    return np.array([[number(x, f"{where}[{i}]") for x in row] for i, row in enumerate(value)])


def unsealed(text: str) -> dict[str, Any]:
    """The file's table once its seal has been found right."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(dict(pairs)) != len(pairs):
            raise Refused("the file has a key twice in one table")
        return dict(pairs)

    def constant(name: str) -> float:
        raise Refused(f"the file has {name}, which is no number")

    try:
        data = json.loads(text, object_pairs_hook=once, parse_constant=constant)
    except json.JSONDecodeError as error:
        raise Refused(f"not JSON: {error}") from None
    if not isinstance(data, dict) or data.get("schema") != "flightstack.certificate/2":
        raise Refused('not a certificate: schema is not "flightstack.certificate/2"')
    seal = data.pop("seal", None)
    canonical = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    if seal != hashlib.sha256(canonical.encode()).hexdigest():
        raise Refused("seal does not fit: the file was changed after it was made")
    return data
