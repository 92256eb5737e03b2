"""Many messages of one topic as one: what makes a flight's log small and keeps every bit.

In a compact log the messages of a fast table stand in blocks, a channel `/rows/TOPIC` for each topic; the topic itself
carries a thinned copy, which any viewer shows.  A block is a protocol buffer:

    1  size   sfixed32   bytes of a row
    2  data   bytes      (size, n) bytes: byte k of all rows side by side, each less that of the row before, modulo 256

and a row is its log time (int64, us), its place in the order of everything written (uint32) and the message as it would
stand in the topic, little-endian.  Byte by byte and row less row is what compresses: of a number that changes slowly
only the last bytes differ.  Rows of another size (a text at their end) stand in a block of their own.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flightstack.types import F64, I64, U8
from flightstack_logs.encoder import NumbersEncoder
from flightstack_logs.topics import Field, Kind, Topic
from flightstack_logs.wire import BYTES, descriptor, varint, walk

PREFIX = "/rows"
_HEAD = struct.Struct("<qI")
_HEAD_TYPE = np.dtype([("t_us", "<i8"), ("place", "<u4")])
_SIZE_TAG = varint(1 << 3 | 5)
_DATA_TAG = varint(2 << 3 | BYTES)
SCHEMA_NAME = "flightstack.Rows"


def schema() -> bytes:
    """The FileDescriptorSet of a block."""
    fields = Field("size", "int32", 0, "", ""), Field("data", "bytes", 0, "", "")
    return descriptor(Topic("", Kind.TABLE, SCHEMA_NAME, 0.0, "", "", fields))


Numbers = list[tuple[int, int, F64]]
"""Time, place and numbers of rows."""


class RowBlocks:
    """Rows that are collected until the chunk ends."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, int], list[bytes]] = {}
        self._numbers: dict[tuple[str, int], Numbers] = {}
        self._encoders: dict[str, NumbersEncoder] = {}
        self._count = 0

    def add(self, topic: str, t_us: int, message: bytes) -> None:
        """One more row."""
        row = _HEAD.pack(t_us, self._count & 0xFFFF_FFFF) + message
        self._count += 1
        key = topic, len(row)
        rows = self._rows.get(key)
        if rows is None:
            rows = self._rows[key] = []
        rows.append(row)

    def hold(self, topic: str, encoder: NumbersEncoder) -> Numbers:
        """From now on rows of numbers are taken as well (`add_numbers`), encoded all at once when the chunk ends."""
        key = topic, encoder.size + _HEAD.size
        self._encoders[topic] = encoder
        self._rows.setdefault(key, [])
        return self._numbers.setdefault(key, [])

    def add_numbers(self, t_us: int, numbers: F64, held: Numbers) -> None:
        """One more row to those that `hold` has given; nobody writes to `numbers` meanwhile."""
        held.append((t_us, self._count & 0xFFFF_FFFF, numbers))
        self._count += 1

    def take(self) -> Iterator[tuple[str, bytes]]:
        """(topic, block) of all that was collected, which is forgotten; each is made when it is asked for."""
        for key, rows in self._rows.items():
            topic, numbers = key[0], self._numbers.get(key)
            if numbers:
                table = _table_of(numbers, self._encoders[topic])
                if rows:  # of both kinds: in the order in which they came
                    table = np.vstack([table, _table(rows)])
                    table = table[
                        np.argsort(np.ascontiguousarray(table[:, : _HEAD.size]).view(_HEAD_TYPE)["place"][:, 0])
                    ]
                yield topic, _packed(table)
                numbers.clear()
            elif rows:
                yield topic, pack(rows)
            rows.clear()


def _table(rows: list[bytes]) -> U8:
    """(n, size) bytes of rows of one size."""
    return np.frombuffer(b"".join(rows), np.uint8).reshape(-1, len(rows[0]))


def _table_of(rows: Numbers, encoder: NumbersEncoder) -> U8:
    """(n, size) bytes of rows of numbers, each with its log time and place."""
    heads = np.array([(t_us, place) for t_us, place, _ in rows], _HEAD_TYPE)
    messages = encoder.encode(np.array([numbers for _, _, numbers in rows]))
    return np.hstack([heads.view(np.uint8).reshape(len(rows), -1), messages])


def pack(rows: list[bytes]) -> bytes:
    """One block of rows that are all of one size."""
    return _packed(_table(rows))


def _packed(table: U8) -> bytes:
    size = table.shape[1]
    data = np.diff(table, axis=0, prepend=np.zeros((1, size), np.uint8)).T.tobytes()
    return b"".join((_SIZE_TAG, struct.pack("<i", size), _DATA_TAG, varint(len(data)), data))


@dataclass(frozen=True, slots=True, eq=False)
class Unpacked:
    """All rows of a topic, in the order written."""

    t_us: I64
    place: I64
    """(n,) among everything in the log's blocks."""
    messages: U8 | list[bytes]
    """(n, size) where all are of one size."""


def unpack(blocks: list[bytes]) -> Unpacked:
    """The rows of all blocks of a topic; ValueError where one is damaged."""
    by_size: dict[int, list[U8]] = {}
    for block in blocks:
        table = _unpacked(block)
        by_size.setdefault(table.shape[1], []).append(table)
    tables = [np.concatenate(parts) for parts in by_size.values()]
    heads = np.concatenate([np.ascontiguousarray(table[:, : _HEAD.size]) for table in tables]).view(_HEAD_TYPE)[:, 0]
    order = np.argsort(heads["place"], kind="stable")
    t_us, place = heads["t_us"][order].astype(np.int64), heads["place"][order].astype(np.int64)
    if len(tables) == 1:
        return Unpacked(t_us, place, tables[0][order, _HEAD.size :])
    bodies = [row[_HEAD.size :].tobytes() for table in tables for row in table]
    return Unpacked(t_us, place, [bodies[index] for index in order.tolist()])


def _unpacked(block: bytes) -> U8:
    """(n, size) the rows of one block."""
    fields = dict(walk(block))
    packed, data = fields.get(1), fields.get(2)
    if not isinstance(packed, bytes) or not isinstance(data, bytes) or len(packed) != 4:
        raise ValueError("a block of rows is malformed")
    size = int.from_bytes(packed, "little")
    if size < _HEAD.size or not data or len(data) % size:
        raise ValueError("a block of rows is malformed")
    return np.cumsum(np.frombuffer(data, np.uint8).reshape(size, -1), axis=1, dtype=np.uint8).T
