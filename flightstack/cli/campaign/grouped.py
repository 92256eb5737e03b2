"""The table [table] of a campaign file: flights grouped by factors, their figures summed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flightstack.cli.campaign import keys
from flightstack.cli.campaign.outcomes import OUTCOMES
from flightstack.cli.campaign.statistics import Entry, clopper_pearson
from flightstack.errors import InputError

_FIGURES = {
    "flights": 0,
    "sum": 1,
    "min": 1,
    "max": 1,
    "median": 1,
    "ratio": 2,
    "limit": 2,
    **dict.fromkeys(OUTCOMES, 0),
}
"""What a column may be, and how many fields of the result it takes."""


@dataclass(frozen=True, slots=True)
class Grouping:
    """How a campaign's flights are told."""

    by: tuple[str, ...]
    """Factors."""
    columns: Mapping[str, tuple[str, ...]]
    """Head -> figure and its fields of the result, dotted."""


def parse_table(table: object, where: str) -> Grouping:
    """The checked table."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where} must be a table, not {table!r}")
    for key in table:
        if key not in ("by", "columns"):
            raise keys.unknown(key, ["by", "columns"], where)
    by = table.get("by", [])
    by = [by] if isinstance(by, str) else by
    if not isinstance(by, list) or not all(isinstance(each, str) for each in by):
        raise InputError(f"{where}.by = {by!r} is not allowed; name a factor, or list several")
    columns = table.get("columns")
    if not isinstance(columns, Mapping) or not columns:
        raise InputError(f"{where}.columns must be a table: head = figure")
    return Grouping(tuple(by), {head: _column(text, f"{where}.columns: {head}") for head, text in columns.items()})


def _column(text: object, where: str) -> tuple[str, ...]:
    parts = tuple(text.split()) if isinstance(text, str) else ()
    if not parts or parts[0] not in _FIGURES:
        raise InputError(f"{where} = {text!r} is not known; known are {', '.join(_FIGURES)}")
    if len(parts) != 1 + _FIGURES[parts[0]]:
        raise InputError(f"{where} = {text!r}: {parts[0]} takes {_FIGURES[parts[0]]} fields of the result")
    return parts


def grouped(table: Grouping, entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """A row for each combination of values that was flown, in the order of their first flight."""
    groups: dict[tuple[str, ...], list[Entry]] = {}
    for entry in entries:
        groups.setdefault(tuple(str(entry["values"].get(name, "")) for name in table.by), []).append(entry)
    return [
        dict(zip(table.by, values, strict=True)) | {head: figure(parts, of) for head, parts in table.columns.items()}
        for values, of in groups.items()
    ]


def figure(parts: Sequence[str], entries: Sequence[Entry]) -> float | int | None:
    """One figure over these flights; None where none of them has it.

    `limit`: Clopper and Pearson's upper limit (95 %, one-sided) of the first field's share of the second.
    """
    name, fields = parts[0], parts[1:]
    if name == "flights":
        return len(entries)
    if name in OUTCOMES:
        return len([entry for entry in entries if entry["outcome"] == name])
    values = [[v for entry in entries if (v := _value(entry, field)) is not None] for field in fields]
    if name == "sum":
        total: float | int = sum(values[0])
        return total
    if name in ("min", "max", "median"):
        return float(getattr(np, name)(values[0])) if values[0] else None
    part, whole = sum(values[0]), sum(values[1])
    if name == "ratio":
        return part / whole if whole else None
    return clopper_pearson(round(part), round(whole), 0.9)[1] if whole else None


def _value(entry: Entry, field: str) -> float | int | None:
    value: Any = entry["result"]
    for key in field.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    known = isinstance(value, int | float) and math.isfinite(value)
    return float(value) if known and isinstance(value, float) else int(value) if known else None


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a table."""
    if not rows:
        return ""
    heads = list(rows[0])
    lines = [f"| {' | '.join(heads)} |", "|" + " --- |" * len(heads)]
    lines += [f"| {' | '.join(shown(row[head]) for head in heads)} |" for row in rows]
    return "\n".join(lines) + "\n"


def shown(value: Any) -> str:
    """A cell."""
    if value is None:
        return "–"
    return f"{value:.4g}".replace("-", "−") if isinstance(value, float) else str(value)
