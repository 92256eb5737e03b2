"""Numbers of a vehicle file that are known only within a range: `{value = 1.2, range = [1.1, 1.3]}`.

Lists have one pair a number, in the list's own shape: `{value = [1.0, 2.0], range = [[0.9, 1.1], [1.5, 2.5]]}`.  The
value is what flies; the range is what is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from flightstack.types import F64, InputError

_KEYS = {"value", "range"}


def split(entry: object, where: str) -> tuple[object, F64 | None]:
    """(plain value, range) of an entry: the range (..., 2) is None where a plain value stands.

    InputError, one line that begins with `where`, unless the pairs fit the value and each holds its number.
    """
    if not isinstance(entry, Mapping):
        return entry, None
    if set(entry) != _KEYS:
        raise InputError(f"{where} = {entry!r} is not allowed; a table must be {{value = ..., range = [low, high]}}")
    value, pairs = _numbers(entry["value"]), _numbers(entry["range"])
    if value is None or pairs is None or pairs.shape != (*value.shape, 2):
        raise InputError(f"{where}.range = {entry['range']!r} is not allowed; give one [low, high] for each number")
    if not np.all((pairs[..., 0] <= value) & (value <= pairs[..., 1])):
        raise InputError(f"{where}.range = {entry['range']!r} must hold the value {entry['value']!r}")
    return entry["value"], pairs


def to_toml(value: F64 | float, pairs: F64 | None) -> str:
    """The entry's text; a range that does not hold the value (any more) is left out."""
    plain = _listed(np.asarray(value, dtype=np.float64))
    inside = pairs is not None and bool(np.all((pairs[..., 0] <= value) & (value <= pairs[..., 1])))
    return f"{{value = {plain}, range = {_listed(pairs)}}}" if pairs is not None and inside else plain


def _numbers(value: object) -> F64 | None:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array if np.all(np.isfinite(array)) else None


def _listed(values: F64) -> str:
    def words(part: Any) -> str:
        return "[" + ", ".join(words(each) for each in part) + "]" if isinstance(part, list) else repr(float(part))

    return words(values.tolist())
