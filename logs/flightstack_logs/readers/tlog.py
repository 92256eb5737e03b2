"""Telemetry logs (`.tlog`) of ground stations: 8 bytes of big-endian microseconds (UTC) before every MAVLink frame.

One table for each message, under its name; where several systems or components send it, those of the vehicle (the
system with an autopilot's heartbeat) keep the name and the others' become `NAME@system.component`.  Frames whose
checksum is wrong are left out and counted, and after damage the walk goes on at the next good frame.  Fields are those
of pymavlink's `all` dialect; a message that it does not know, whose checksum can't be told, is left out too.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from fastcrc.crc16 import mcrf4xx

from flightstack.types import InputError
from flightstack_logs.tables import About, Log, Table, plain

_ABOUT = About("table", "mavlink", "", "MAVLink", 0.0)
_STAMP = 8
_V1, _V2 = 0xFE, 0xFD
_EARLIEST_US, _LATEST_US = 946_684_800_000_000, 4_102_444_800_000_000
"""The years 2000 to 2100."""
_SIGNED = 1
_NO_AUTOPILOT = 8
_AUTOPILOT = 5  # byte of a HEARTBEAT's payload
_FLOAT, _DENORMAL = 9, 1e-30
"""MAV_PARAM_TYPE_REAL32; integers sent as their bits look like floats smaller than any parameter."""
_TYPES = {"uint8_t": "u1", "int8_t": "i1", "uint16_t": "<u2", "int16_t": "<i2", "uint32_t": "<u4", "int32_t": "<i4",
          "uint64_t": "<u8", "int64_t": "<i8", "float": "<f4", "double": "<f8", "char": "S1",
          "uint8_t_mavlink_version": "u1"}  # fmt: skip

Sender = tuple[int, int, int]
"""Message number, system, component."""


@dataclass(slots=True)
class _Heard:
    """The payloads of one message of one sender."""

    stamps_us: list[int] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)


def begins_like_a_tlog(data: bytes) -> bool:
    """Whether a plausible stamp and the beginning of a frame come first."""
    if len(data) < _STAMP + 8 or data[_STAMP] not in (_V1, _V2):
        return False
    return _EARLIEST_US <= int.from_bytes(data[:_STAMP], "big") <= _LATEST_US


def read_tlog(path: Path, data: bytes) -> Log:
    """The log in `data`, a damaged or cut-off one as far as it goes; InputError where no message is whole."""
    heard, lost, foreign = _walk(data)
    if not heard:
        raise InputError(f"log {path}: is a telemetry log without a single whole message; copy it again")
    vehicle = _vehicle(heard)
    zero_us = min(one.stamps_us[0] for one in heard.values())
    tables: dict[str, Table] = {}
    for sender, one in heard.items():
        name = str(_layout(sender[0])[1])
        if sender[1:] != vehicle and name in {_layout(n)[1] for n, *rest in heard if tuple(rest) == vehicle}:
            name = f"{name}@{sender[1]}.{sender[2]}"
        while name in tables:
            name = f"{name.partition('@')[0]}@{sender[1]}.{sender[2]}"
        tables[name] = _table(name, sender[0], one, zero_us)
    notes = [f"damaged or cut off: {lost} bytes are no whole message"] if lost else []
    if foreign:
        notes.append(f"{foreign} messages of a kind that is not known (their checksum can't be told) were left out")
    began = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(zero_us // 1_000_000))
    metadata = {
        "clock": {"utc_start": f"{began}Z", "utc": "the recorder's"},
        "vehicle": {"system": str(vehicle[0]), "component": str(vehicle[1])},
        **_parameters(tables),
    }
    return Log.of_tables(path, "tlog", _ABOUT, tables, notes, len(data), complete=not lost, metadata=metadata)


def _walk(data: bytes) -> tuple[dict[Sender, _Heard], int, int]:
    """Every whole frame by its sender, how many bytes belong to none, and how many frames are of no known kind."""
    heard: dict[Sender, _Heard] = {}
    at = lost = foreign = 0
    end = len(data)
    while at + _STAMP + 8 <= end:
        found = _frame(data, at + _STAMP)
        stamp_us = int.from_bytes(data[at : at + _STAMP], "big")
        if found is None and (after := _foreign_end(data, at + _STAMP)):
            foreign += 1
            at = after
            continue
        if found is None or not _EARLIEST_US <= stamp_us <= _LATEST_US:
            after = _next(data, at + 1)
            lost += after - at
            at = after
            continue
        sender, payload, size = found
        one = heard.get(sender)
        if one is None:
            one = heard[sender] = _Heard()
        one.stamps_us.append(stamp_us)
        one.payloads.append(payload)
        at += _STAMP + size
    return heard, lost + end - at, foreign


def _foreign_end(data: bytes, at: int) -> int:
    """Where a frame of an unknown kind ends, if another entry or the file's end follows there; else 0."""
    if data[at] != _V2 or at + 12 > len(data) or int.from_bytes(data[at + 7 : at + 10], "little") in _extras():
        return 0
    end = at + 12 + data[at + 1] + (13 if data[at + 2] & _SIGNED else 0)
    return end if end == len(data) or begins_like_a_tlog(data[end : end + 2 * _STAMP]) else 0


def _frame(data: bytes, at: int) -> tuple[Sender, bytes, int] | None:
    """Sender, payload and size of the frame at a place; None where there is none that is whole and known."""
    magic, length = data[at], data[at + 1]
    if magic == _V2:
        if at + 12 + length > len(data):
            return None
        head, signature = 10, 13 if data[at + 2] & _SIGNED else 0
        sender = int.from_bytes(data[at + 7 : at + 10], "little"), data[at + 5], data[at + 6]
    elif magic == _V1:
        head, signature = 6, 0
        sender = data[at + 5], data[at + 3], data[at + 4]
    else:
        return None
    body_end = at + head + length
    if body_end + 2 + signature > len(data):
        return None
    known = _extras().get(sender[0])
    if known is None:
        return None
    crc = mcrf4xx(data[at + 1 : body_end] + known)
    if crc != data[body_end] | data[body_end + 1] << 8:
        return None
    return sender, data[at + head : body_end], head + length + 2 + signature


def _next(data: bytes, at: int) -> int:
    """Where the next frame that is whole may begin, its stamp included; the end where there is none."""
    while True:
        places = [place for magic in (b"\xfd", b"\xfe") if (place := data.find(magic, at + _STAMP)) >= 0]
        if not places or min(places) + 8 > len(data):
            return len(data)
        if _frame(data, min(places)) is not None:
            return min(places) - _STAMP
        at = min(places) + 1 - _STAMP


def _vehicle(heard: dict[Sender, _Heard]) -> tuple[int, int]:
    """System and component of the autopilot that says most; of whoever says most where none shows itself."""
    told: Counter[tuple[int, int]] = Counter()
    autopilots = set()
    for (number, system, component), one in heard.items():
        told[system, component] += len(one.payloads)
        kinds = {payload[_AUTOPILOT] for payload in one.payloads[:5] if len(payload) > _AUTOPILOT}
        if number == 0 and kinds - {_NO_AUTOPILOT}:
            autopilots.add((system, component))
    return max(autopilots or told, key=lambda who: told[who])


@lru_cache(maxsize=1)
def _messages() -> dict[int, Any]:
    from pymavlink.dialects.v20 import all as dialect

    known: dict[int, Any] = dialect.mavlink_map
    return known


@lru_cache(maxsize=1)
def _extras() -> dict[int, bytes]:
    return {number: bytes([kind.crc_extra]) for number, kind in _messages().items()}


@lru_cache(maxsize=512)
def _layout(number: int) -> tuple[np.dtype[np.void], str, dict[str, str]]:
    """How a payload lies in memory, the message's name, and unit of each field."""
    kind = _messages()[number]
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    fields: list[Any] = []
    for name, count in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        code = _TYPES[types[name]]
        if code == "S1":
            fields.append((name, f"S{max(count, 1)}"))
        else:
            fields.append((name, code, (count,)) if count else (name, code))
    return np.dtype(fields), kind.msgname, dict(kind.fieldunits_by_name)


def _table(name: str, number: int, one: _Heard, zero_us: int) -> Table:
    """Payloads as columns: truncated ones are filled up with zeros, as MAVLink 2 means them."""
    dtype, _, units = _layout(number)
    size = dtype.itemsize
    block = b"".join([payload[:size].ljust(size, b"\0") for payload in one.payloads])
    rows = np.frombuffer(block, dtype)
    stamps = np.array(one.stamps_us, np.int64) - zero_us
    order = np.argsort(stamps, kind="stable")
    columns = {field: plain(rows[field][order]) for field in dtype.names or ()}
    return Table(name, stamps[order], columns, units)


def _parameters(tables: dict[str, Table]) -> dict[str, dict[str, str]]:
    """The last value that the vehicle told of each parameter; PX4 sends integers as their bits."""
    told = tables.get("PARAM_VALUE")
    if told is None:
        return {}
    value, whole = told["param_value"].astype(np.float32), told["param_type"] < _FLOAT
    bits = bool(np.any(whole & (value != 0.0) & (np.abs(value) < _DENORMAL)))
    found = {
        str(name): str(int(one.view(np.int32))) if bits and integer else repr(float(one))
        for name, one, integer in zip(told["param_id"], value, whole, strict=True)
    }
    return {"parameters": found}
