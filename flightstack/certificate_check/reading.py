"""Reading a certificate's text strictly: the seal, exact keys, finite numbers."""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any

import numpy as np

from . import bounds
from .intervals import F64, I64

SCHEMA = "flightstack.certificate/6"


class Refused(Exception):
    """The first thing that is not so."""


class Unreadable(Refused):
    """What is no certificate file at all, or larger than any that this checker looks at."""


_LARGEST = 1e9


def number(value: Any, where: str) -> float:
    """A finite number of no wild size."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise Unreadable(f"{where} must be a number")
    if not abs(value) <= _LARGEST:
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
        raise Unreadable(f"{where} must be a table")
    for key in (*keys, *value):
        if (key in keys) != (key in value):
            raise Unreadable(f"{where}.{key[:40]} is {'missing' if key in keys else 'not known'}")
    return value


def numbers(value: Any, keys: tuple[str, ...], where: str) -> list[float]:
    """The numbers of a table of numbers, in the order of its keys."""
    table = table_of(value, keys, where)
    return [number(table[key], f"{where}.{key}") for key in keys]


def rows(value: Any, width: int, where: str) -> F64:
    """(n, width) a list of rows of numbers, n at least 1."""
    if not isinstance(value, list) or not value:
        raise Unreadable(f"{where} must be a list of rows")
    for i, row in enumerate(value):
        if not isinstance(row, list) or len(row) != width:
            raise Unreadable(f"{where}[{i}] must be a row of {width} numbers")
    return np.array([[number(x, f"{where}[{i}]") for x in row] for i, row in enumerate(value)])


def parsed(text: str) -> dict[str, Any]:
    """The file's table: strict JSON, no key twice, finite numbers only, of this checker's schema and size."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            raise Unreadable("the file has a key twice in one table")
        return found

    def finite(digits: str) -> float:
        value = float(digits)
        if not math.isfinite(value):
            raise Unreadable(f"the file has {digits[:40]}, which is no finite number")
        return value

    def constant(name: str) -> float:
        raise Unreadable(f"the file has {name}, which is no number")

    if len(text) > bounds.FILE_BYTES:
        raise Unreadable(f"the file has more than {bounds.FILE_BYTES // 10**6} MB")
    try:
        data = json.loads(text, object_pairs_hook=once, parse_float=finite, parse_constant=constant)
    except json.JSONDecodeError as error:
        raise Unreadable(f"not JSON: {error}") from None
    except RecursionError:
        raise Unreadable("nested too deep") from None
    except ValueError:
        raise Unreadable("a number has too many digits") from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise Unreadable(f'not a certificate: schema is not "{SCHEMA}"')
    if found := bounds.beyond(data):
        raise Unreadable(found)
    return data


def seal_of(text: str) -> Any:
    """What the file is sealed with."""
    return json.loads(text)["seal"]


def unsealed(text: str) -> dict[str, Any]:
    """The file's table once its seal has been found right."""
    data = parsed(text)
    seal = data.pop("seal", None)
    canonical = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    if seal != hashlib.sha256(canonical.encode()).hexdigest():
        raise Refused("seal does not fit: the file was changed after it was made")
    return data


def stamps(value: Any, count: int, where: str) -> I64:
    """(n, 2) stamps; none where none are named."""
    if value == []:
        return np.zeros((0, 2), np.int64)
    named = isinstance(value, list) and len(value) == count
    if not named or not all(isinstance(row, list) and len(row) == 2 for row in value):
        raise Unreadable(f"{where}.windows_us must be as many pairs of stamps as points, or none")
    if not all(type(stamp) is int and 0 <= stamp < 2**53 for row in value for stamp in row):
        raise Refused(f"{where}.windows_us: a stamp is no whole number from 0")
    return np.array(value, np.int64)
