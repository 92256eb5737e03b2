"""ArduPilot's DataFlash logs (`.BIN`): one table for each message, under its name, `NAME_1`, ... for further instances.

A file is messages of A3 95 and a type; FMT messages (type 128) say name, length, format and columns of each type.  The
meaning of the format's letters, and what they are scaled by, is pymavlink's (`DFReader.FORMAT_TO_STRUCT`).  Damage is
left out and counted, and the walk goes on at the next message that is followed by another.

Times are since boot.  In logs of 2014 GPS messages have the week's time in TimeMS and the board's in T, and PARM, MODE,
EV and some others have none: these get that of the message before them, as in pymavlink.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.types import I64, InputError
from flightstack_logs import ardupilot
from flightstack_logs.tables import About, Log, Table, plain

_ABOUT = About("table", "dataflash", "", "ArduPilot", 0.0)
MAGIC = b"\xa3\x95\x80\x80"
"""A3 95 and the FMT message that describes FMT itself."""
_HEAD, _FMT, _FMT_BYTES = b"\xa3\x95", 128, 89
_LATEST_US = 1 << 52


@dataclass(slots=True)
class _Kind:
    """One type of message."""

    name: str
    row: np.dtype[np.void]
    scales: dict[str, float]
    at: list[int] = field(default_factory=list)


def read_dataflash(path: Path, data: bytes) -> Log:
    """The log in `data`, a damaged or cut-off one as far as it goes; InputError where there is no row in it."""
    kinds, lost = _walk(data)
    clock = _clock(kinds.values(), data)
    tables: dict[str, Table] = {}
    for kind in kinds.values():
        tables |= _tables(kind, data, clock)
    if not tables:
        raise InputError(f"log {path}: is a DataFlash log without data; set LOG_DISARMED or record a flight")
    notes = [f"damaged or cut off: {lost} bytes are no whole message"] if lost else []
    metadata: dict[str, dict[str, str]] = {}
    said = ardupilot.parameters(tables)
    if said:
        metadata["parameters"] = {name: repr(value) for name, value in said.items()}
    return Log.of_tables(path, "dataflash", _ABOUT, tables, notes, len(data), complete=not lost, metadata=metadata)


def _walk(data: bytes) -> tuple[dict[int, _Kind], int]:
    """Places of every whole message by its type, and how many bytes belong to none."""
    kinds: dict[int, _Kind] = {}
    sizes: dict[int, int] = {_FMT: _FMT_BYTES}
    at = lost = 0
    end = len(data)
    while at + 3 <= end:
        size = sizes.get(data[at + 2]) if data[at : at + 2] == _HEAD else None
        if size is None or at + size > end:
            after = _next(data, at + 1, sizes)
            lost += after - at
            at = after
            continue
        number = data[at + 2]
        if number == _FMT:
            _learn(data[at : at + size], kinds, sizes)
        elif number in kinds:
            kinds[number].at.append(at)
        at += size
    return kinds, lost + end - at


def _next(data: bytes, at: int, sizes: dict[int, int]) -> int:
    """The next message that is whole and followed by another or by the end."""
    while (at := data.find(_HEAD, at)) >= 0 and at + 3 <= len(data):
        after = at + sizes.get(data[at + 2], len(data))
        if after == len(data) or data[after : after + 2] == _HEAD:
            return at
        at += 1
    return len(data)


def _learn(message: bytes, kinds: dict[int, _Kind], sizes: dict[int, int]) -> None:
    """Take an FMT message: type, length, name, format, names of the columns; nonsense is passed over."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    number, length, name, letters, names = struct.unpack("<BB4s16s64s", message[3:])
    said = [part.rstrip(b"\0").decode("ascii", "replace") for part in (name, letters, names)]
    columns = said[2].split(",") if said[2] else []
    if (
        length < 3
        or not said[0].isalnum()
        or len(columns) != len(said[1])
        or len({"_head", *columns}) != len(columns) + 1
    ):
        return
    fields: list[Any] = [("_head", "S3")]
    scales: dict[str, float] = {}
    for column, letter in zip(columns, said[1], strict=True):
        if letter not in FORMAT_TO_STRUCT:
            return
        if not column:
            return
        code, scale, _ = FORMAT_TO_STRUCT[letter]
        kind = "<i2" if letter == "a" else f"S{code[:-1]}" if code.endswith("s") else f"<{np.dtype(code).str[1:]}"
        fields.append((column, kind, (32,)) if letter == "a" else (column, kind))
        if scale is not None:
            scales[column] = float(scale)
    row = np.dtype(fields)
    if row.itemsize != length or number == _FMT:
        return
    sizes[number] = length
    if number not in kinds:
        kinds[number] = _Kind(said[0], row, scales)


def _rows(kind: _Kind, data: bytes) -> np.ndarray:
    """The messages of a type, in the order of the file."""
    raw = np.frombuffer(data, np.uint8)
    rows: np.ndarray = raw[np.array(kind.at, np.int64)[:, None] + np.arange(kind.row.itemsize)].copy().view(kind.row)
    return rows[:, 0]


def _stamp(kind: _Kind) -> tuple[str, float] | None:
    """The column that holds the board's time, and what turns it into microseconds."""
    names = kind.row.names or ()
    of_gps = (("T", 1e3),) if "Week" in names else ()
    for name, times in (("TimeUS", 1.0), *of_gps, ("TimeMS", 1e3)):
        if name in names and kind.row[name].kind in "iuf":
            return name, times
    return None


def _times(rows: np.ndarray, stamp: tuple[str, float]) -> I64:
    """Microseconds since boot; -1 where that is no time."""
    t_us = stamp[1] * _double(rows[stamp[0]])
    good = (t_us >= 0.0) & (t_us < _LATEST_US)
    return np.where(good, t_us, -1.0).astype(np.int64)


def _clock(kinds: Iterable[_Kind], data: bytes) -> tuple[I64, I64]:
    """Places in the file where a time stands, in order, and these times."""
    places, times = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for kind in kinds:
        stamp = _stamp(kind)
        if stamp is not None and kind.at:
            places.append(np.array(kind.at, np.int64))
            times.append(_times(_rows(kind, data), stamp))
    at, t_us = np.concatenate(places), np.concatenate(times)
    order = np.argsort(at)
    order = order[t_us[order] >= 0]
    return at[order], t_us[order]


def _tables(kind: _Kind, data: bytes, clock: tuple[I64, I64]) -> dict[str, Table]:
    """The messages of a type as tables, one for each instance; one that says no time has the time of the one before."""
    if not kind.at or not len(clock[0]):
        return {}
    rows, stamp = _rows(kind, data), _stamp(kind)
    names = [name for name in kind.row.names or () if name != "_head"]
    if stamp is not None:
        t_us = _times(rows, stamp)
    else:
        t_us = clock[1][np.maximum(np.searchsorted(clock[0], kind.at) - 1, 0)]
    good = np.flatnonzero(t_us >= 0)
    rows, stamps = rows[good], t_us[good]
    instance = next((name for name in ("I", "C", "Instance") if name in names and rows[name].dtype.kind in "iu"), None)
    if instance is None or kind.name == "PARM":
        return {kind.name: _table(kind.name, kind, rows, stamps)} if len(rows) else {}
    found = {}
    for number in np.unique(rows[instance]).tolist():
        name = kind.name if number == 0 else f"{kind.name}_{number}"
        mine = rows[instance] == number
        found[name] = _table(name, kind, rows[mine], stamps[mine])
    return found


def _table(name: str, kind: _Kind, rows: np.ndarray, stamps: I64) -> Table:
    order = np.argsort(stamps, kind="stable")
    stamp = _stamp(kind)
    wanted = [column for column in kind.row.names or () if column not in ("_head", stamp and stamp[0])]
    columns = {column: _typed(rows[column][order], kind.scales.get(column)) for column in wanted}
    return Table(name, stamps[order], columns, {})


def _typed(values: np.ndarray, scale: float | None) -> np.ndarray:
    if scale is not None:
        return _double(values) * scale
    return _double(values) if values.dtype.kind == "f" else plain(values)


def _double(values: np.ndarray) -> np.ndarray:
    """As float64; NaN that signal, as damaged bytes may spell, are plain ones then: numpy warns of each use."""
    with np.errstate(invalid="ignore"):
        wide = values.astype(np.float64)
    return np.where(np.isnan(wide), np.nan, wide)
