"""Crazyflie uSD-card logs (`.cfusdlog`), format versions 1 and 2, one table for each kind of event.

A file is: 0xBC, version (u16), number of event kinds (u16); for each its id (u16), name, number of variables (u16) and
their names as `group.name(t)` with t of Python's struct, each text ended by a zero; then records of id (u16), time
(version 1: u32 in ms, version 2: u64 in us) and the variables; at the end the CRC-32 of all before it.  Little-endian.
Values stay as they were logged: g, degrees, 16-bit motor commands, the Crazyflie's frames.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from flightstack.types import InputError
from flightstack_logs.tables import About, Log, Table, plain

_ABOUT = About("table", "cfusdlog", "", "Crazyflie uSD log", 0.0)
MAGIC = b"\xbc"
_TIMES = {1: ("<u4", 1000), 2: ("<u8", 1)}
"""Version -> (type of the time, its unit in us)."""
_CODES = {"b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8", "f": "<f4",
          "d": "<f8", "?": "?"}  # fmt: skip
_LATEST_US = 1 << 52


@dataclass(slots=True)
class _Event:
    name: str
    columns: list[str]
    row: np.dtype[np.void]
    at: list[int] = field(default_factory=list)


def read_cfusdlog(path: Path, data: bytes) -> Log:
    """The log in `data`, up to the last whole record; InputError where there is none."""
    try:
        unit_us, events, at = _header(data)
    except (ValueError, struct.error, IndexError) as error:
        raise InputError(f"log {path}: is no Crazyflie log that can be read ({error}); name a flight log") from None
    whole = len(data) > at + 4 and zlib.crc32(data[:-4]) == int.from_bytes(data[-4:], "little")
    notes = [] if whole else ["cut off or damaged: the checksum at the end is missing or wrong"]
    end = len(data) - 4 if whole else len(data)
    while at + 2 <= end:
        event = events.get(data[at] | data[at + 1] << 8)
        if event is None:
            if end - at > 4:
                notes.append(f"damaged: unknown event at byte {at}; the {end - at} bytes from there are not read")
            break
        if at + event.row.itemsize > end:
            break
        event.at.append(at)
        at += event.row.itemsize
    tables = {event.name: _table(event, data, unit_us) for event in events.values() if event.at}
    if not tables:
        raise InputError(f"log {path}: is a Crazyflie log without a single record; nothing was recorded")
    complete = whole and not notes
    return Log.of_tables(path, "cfusdlog", _ABOUT, tables, notes, len(data), complete=complete)


def _header(data: bytes) -> tuple[int, dict[int, _Event], int]:
    """Unit of time in us, id -> event, where the records begin."""
    version, kinds = struct.unpack_from("<HH", data, 1)
    if version not in _TIMES:
        raise ValueError(f"version {version} is not known, 1 and 2 are")
    time_code, unit_us = _TIMES[version]
    at = 5
    events: dict[int, _Event] = {}
    for _ in range(kinds):
        (number,) = struct.unpack_from("<H", data, at)
        name, at = _text(data, at + 2)
        (count,) = struct.unpack_from("<H", data, at)
        at += 2
        fields: list[tuple[str, str]] = [("_id", "<u2"), ("_t", time_code)]
        for _ in range(count):
            said, at = _text(data, at)
            variable, code = said[:-3], said[-2:-1]
            if code not in _CODES or not variable or variable in dict(fields):
                raise ValueError(f"variable {said!r} is not understood")
            fields.append((variable, _CODES[code]))
        events[number] = _Event(name, [variable for variable, _ in fields[2:]], np.dtype(fields))
    return unit_us, events, at


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.find(b"\0", at, at + 256)
    if end < 0:
        raise ValueError("its header is cut off")
    return data[at:end].decode("ascii", "replace"), end + 1


def _table(event: _Event, data: bytes, unit_us: int) -> Table:
    size = event.row.itemsize
    raw = np.frombuffer(data, np.uint8)
    rows = raw[np.array(event.at)[:, None] + np.arange(size)].copy().view(event.row)[:, 0]
    t_us = np.minimum(rows["_t"].astype(np.float64) * unit_us, float(_LATEST_US)).astype(np.int64)
    order = np.argsort(t_us, kind="stable")
    columns = {name: plain(rows[name][order]) for name in event.columns}
    return Table(event.name, t_us[order], columns, {})
