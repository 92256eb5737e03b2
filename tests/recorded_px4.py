"""A small ULog reader for tests: topics as structured arrays and the parameters (ULog file format, PX4 documentation)."""

from __future__ import annotations

import gzip
import struct
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

_TYPES = {
    **{f"int{8 * n}_t": f"<i{n}" for n in (1, 2, 4, 8)},
    **{f"uint{8 * n}_t": f"<u{n}" for n in (1, 2, 4, 8)},
    "float": "<f4",
    "double": "<f8",
    "bool": "?",
    "char": "S1",
}
FLIGHT = "px4_sih_flight.ulg.gz"


@cache
def read_flight(folder: Path) -> tuple[dict[str, Any], dict[str, tuple[str, float]]]:
    """(topic -> structured array of its first instance, parameter -> (type, value)) of the recorded PX4 SIH flight."""
    data = gzip.decompress((folder / FLIGHT).read_bytes())
    formats: dict[str, str] = {}
    topics: dict[int, str] = {}
    rows: dict[str, list[bytes]] = {}
    params: dict[str, tuple[str, float]] = {}
    at = 16
    while at + 3 <= len(data):
        size, kind = struct.unpack_from("<HB", data, at)
        body = data[at + 3 : at + 3 + size]
        at += 3 + size
        if kind == ord("F"):
            name, fields = body.decode().split(":")
            formats[name] = fields
        elif kind == ord("A") and body[0] == 0:
            topics[struct.unpack_from("<H", body, 1)[0]] = body[3:].decode()
        elif kind == ord("D") and (topic := topics.get(struct.unpack_from("<H", body)[0])):
            rows.setdefault(topic, []).append(body[2:])
        elif kind == ord("P"):
            type_, name = body[1 : 1 + body[0]].decode().split(" ")
            code = "<i" if type_ == "int32_t" else "<f"
            params[name] = (type_, struct.unpack(code, body[1 + body[0] : 5 + body[0]])[0])
    return {name: _table(formats[name], chunks) for name, chunks in rows.items() if _plain(formats[name])}, params


def _plain(fields: str) -> bool:
    return all(field.split(" ")[0].split("[")[0] in _TYPES for field in fields.split(";") if field)


def _table(fields: str, chunks: list[bytes]) -> Any:
    columns: list[Any] = []
    size = min(map(len, chunks))  # padding at the end is left out of the file
    for field in filter(None, fields.split(";")):
        type_, name = field.split(" ")
        base, _, count = type_.partition("[")
        column = (name, _TYPES[base], (int(count[:-1]),)) if count else (name, _TYPES[base])
        if np.dtype([*columns, column]).itemsize <= size:
            columns.append(column)
    dtype = np.dtype(columns)
    return np.frombuffer(b"".join(chunk[: dtype.itemsize] for chunk in chunks), dtype)


def latest(table: Any, t_us: int) -> Any:
    """The table's last row at or before `t_us`."""
    return table[max(0, int(np.searchsorted(table["timestamp"], t_us, side="right")) - 1)]
