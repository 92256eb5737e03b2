"""A log's tables as files that anything reads: CSV, or Parquet (with pyarrow)."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from flightstack.types import InputError
from flightstack_logs.tables import Log, Table

FORMATS = ("csv", "parquet")
_BLOCK = 4096


def export(
    log: Log, folder: Path, form: str = "csv", topics: Sequence[str] = (), columns: Sequence[str] = ()
) -> list[Path]:
    """Write one file for each topic into `folder`, which is made; the files.

    `topics` and `columns` choose by name or pattern (`/vehicle/*`, `pos_*`); none means all.  The first column is
    `t_s`, seconds of log time; the parts of a vector become `NAME_0`, `NAME_1`, ... in CSV and stay a list in Parquet.
    InputError, one line, where nothing is chosen, pyarrow is missing or the folder can't be written.
    """
    if form not in FORMATS:
        raise InputError(f"format {form!r} is not known; known are {', '.join(FORMATS)}")
    chosen = [table for table in log.tables.values() if _wanted(table.name, topics)]
    parts = [(table, [name for name in table.columns if _wanted(name, columns)]) for table in chosen]
    parts = [(table, names) for table, names in parts if names]
    if not parts:
        raise InputError(f"log {log.path}: has no such topic and column; it has {', '.join(sorted(log.tables))}")
    write = _csv if form == "csv" else _parquet_writer()
    made = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for table, names in parts:
            path = folder / f"{table.name.strip('/').replace('/', '_')}.{form}"
            part = path.with_name(f".{path.name}.part")
            try:
                write(table, names, part)
                part.replace(path)
            finally:
                part.unlink(missing_ok=True)
            made.append(path)
    except OSError as error:
        raise InputError(
            f"{folder}: can't be written ({error.strerror or error}); choose another place with --out"
        ) from None
    return made


def _wanted(name: str, patterns: Sequence[str]) -> bool:
    return not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)


def _csv(table: Table, names: list[str], path: Path) -> None:
    header, columns = ["t_s"], [table.t_us / 1e6]
    for name in names:
        values = table.columns[name]
        if values.ndim == 1:
            header.append(name)
            columns.append(values)
        else:
            header += [f"{name}_{part}" for part in range(values.shape[1])]
            columns += list(values.T)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for begin in range(0, len(table), _BLOCK):
            writer.writerows(zip(*(column[begin : begin + _BLOCK].tolist() for column in columns), strict=True))


def _parquet_writer() -> Any:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputError("Parquet needs pyarrow: pip install 'flightstack[parquet]'") from None

    def write(table: Table, names: list[str], path: Path) -> None:
        fields, arrays = [pa.field("t_s", pa.float64(), metadata={"unit": "s"})], [pa.array(table.t_us / 1e6)]
        for name in names:
            values = table.columns[name]
            if values.ndim == 1:
                array = pa.array(values)
            else:
                array = pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[1])
            fields.append(pa.field(name, array.type, metadata={"unit": table.units.get(name, "")}))
            arrays.append(array)
        pq.write_table(pa.table(arrays, schema=pa.schema(fields)), path)

    return write
