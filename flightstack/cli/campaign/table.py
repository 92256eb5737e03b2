"""From journal entries to the tables: flights.parquet, the same bytes whoever flew, and timings.parquet."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flightstack.cli.result import is_measured
from flightstack.dotted import flattened
from flightstack.errors import InputError

_OWN = ("schema", "scenario", "seed", "log", "report", "reason")
"""Fields that the table has from the campaign itself."""
_OWN_TEXTS = ("scenario", "outcome", "reason", "log", "report")
Row = dict[str, Any]


def flight_row(entry: Mapping[str, Any]) -> Row:
    """The row of a flight in flights.parquet."""
    row: Row = {"flight": entry["flight"], "seed": entry["seed"], "scenario": entry["scenario"]}
    row |= {name: _cell(value) for name, value in entry["values"].items() if name != "scenario"}
    row |= {"outcome": entry["outcome"], "reason": entry["reason"], "log": entry["log"], "report": entry["report"]}
    for name, value in flattened(entry["result"] or {}).items():
        if name not in _OWN and not is_measured(name):
            row.setdefault(name, _cell(value))
    return row


def timing_row(entry: Mapping[str, Any]) -> Row:
    """The row of a flight in timings.parquet."""
    measured = flattened(entry["result"] or {})
    row: Row = {"flight": entry["flight"], **entry["timing"]}
    return row | {name: _cell(value) for name, value in measured.items() if is_measured(name)}


def _cell(value: Any) -> Any:
    """Lists and what is left of tables as JSON."""
    return json.dumps(value) if isinstance(value, list | dict) else value


def write_tables(entries: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Both tables, sorted by flight."""
    ordered = sorted(entries, key=lambda entry: int(entry["flight"]))
    write_parquet([flight_row(entry) for entry in ordered], folder / "flights.parquet")
    write_parquet([timing_row(entry) for entry in ordered], folder / "timings.parquet")


def write_parquet(rows: Sequence[Row], path: Path) -> None:
    """Columns in the order in which they first appear; one type each, whatever is missing."""
    pyarrow, parquet = require_parquet()
    names = list(dict.fromkeys(name for row in rows for name in row))
    parents = {name.rpartition(".")[0] for name in names}
    names = [name for name in names if name not in parents or any(row.get(name) is not None for row in rows)]
    columns = {name: _column(pyarrow, name, [row.get(name) for row in rows]) for name in names}
    part = path.with_name(f".{path.name}.part")
    try:
        parquet.write_table(pyarrow.table(columns), part, compression="zstd")
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path}: {error.strerror or error}; make room and go on with --resume") from None


def _column(pyarrow: Any, name: str, values: list[Any]) -> Any:
    """Numbers where all are; texts where anything else than numbers or truth values is among them."""
    kinds = {type(value) for value in values if value is not None}
    if name in _OWN_TEXTS:
        return pyarrow.array(values, pyarrow.string())
    if not kinds or kinds == {float} or kinds == {int, float}:
        return pyarrow.array([None if v is None else float(v) for v in values], pyarrow.float64())
    if kinds == {bool}:
        return pyarrow.array(values, pyarrow.bool_())
    if kinds == {int}:
        return pyarrow.array(values, pyarrow.int64())
    return pyarrow.array([v if v is None or isinstance(v, str) else json.dumps(v) for v in values], pyarrow.string())


def require_parquet() -> tuple[Any, Any]:
    """pyarrow and its Parquet module; InputError where the extra is not installed."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise InputError("campaign writes Parquet: pip install 'flightstack[campaign]'") from None
    return pyarrow, parquet
