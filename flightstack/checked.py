"""Checked values out of parsed text: every error is one line that says where, what was found and what is allowed."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from flightstack.types import InputError, Tuple3

_MOST_SHOWN = 200
_MOST_LEVELS = 32
"""Of tables and lists in one another; no file of ours has more than five."""


def read_toml(text: str, source: str) -> dict[str, Any]:
    """The top table of a TOML text."""
    try:
        data = tomllib.loads(text)
    except ValueError as error:  # tomllib's own, and Python's for a number of thousands of digits
        raise InputError(f"{source}: not valid TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{source}: nested too deeply") from None
    inside: list[Any] = [data]
    for _ in range(_MOST_LEVELS):
        values = (each.values() if isinstance(each, dict) else each for each in inside)
        inside = [value for level in values for value in level if isinstance(value, dict | list)]
    if inside:  # can be read, but not written again by what calls itself
        raise InputError(f"{source}: nested too deeply")
    return data


def load_toml(text: str, source: str, schema: str, known: Iterable[str]) -> dict[str, Any]:
    """The top table of a TOML text, its schema and its keys checked."""
    data = read_toml(text, source)
    only(data, ("schema", *known), source)
    if data.get("schema") != schema:
        raise InputError(f'{source}: schema = {shown(data.get("schema"))} is not known; this version reads "{schema}"')
    return data


def only(table: Mapping[str, object], known: Iterable[str], where: str) -> None:
    """Every key of `table` is one of `known`."""
    names = tuple(known)
    for key in table:
        if key not in names:
            raise InputError(f"{where}: unknown key {key}; known are {', '.join(names)}")


def table(data: Mapping[str, object], key: str, source: str) -> Mapping[str, object]:
    """A table under `key`; empty where it is absent."""
    value = data.get(key, {})
    if not isinstance(value, Mapping):
        raise InputError(f"{source}: {key} = {shown(value)} must be a table")
    return value


def number(value: object, where: str, minimum: float, maximum: float) -> float:
    """A finite number within its range, both ends included."""
    number_like = isinstance(value, int | float) and not isinstance(value, bool)
    if not number_like or not minimum <= value <= maximum:  # type: ignore[operator]
        raise InputError(f"{where} = {shown(value)} is not allowed; it must be a number in {minimum:g} to {maximum:g}")
    return float(value)  # type: ignore[arg-type]


def vector(value: object, where: str, minimum: float, maximum: float) -> Tuple3:
    """Three numbers (north, east, down), each within the range."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise InputError(f"{where} = {shown(value)} must be a list of 3 numbers, each {minimum:g} to {maximum:g}")
    n, e, d = (number(part, where, minimum, maximum) for part in value)
    return n, e, d


def words(value: object, where: str) -> str:
    """A line of printable text."""
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise InputError(f"{where} = {shown(value)} must be a line of text")
    return value


def shown(value: object) -> str:
    """A value as an error line has it: its beginning."""
    try:
        text = "missing" if value is None else repr(value)
    except ValueError:
        text = "a number of thousands of digits"
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."
