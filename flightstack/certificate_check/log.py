"""Reading a flight's log anew: MCAP records in one pass, and two of its tables as columns.

A table's messages are protocol buffers of fixed-size fields; the names and numbers of the fields come from the schema
that the log carries.  Sources: https://mcap.dev/spec, https://protobuf.dev/programming-guides/encoding/.

A fast table stands in blocks of rows beside a thinned copy of it: /rows/TOPIC, `_rows`.

Memory: one chunk (at most 8 MiB unpacked) and the rows wanted; a log of more than 2 million rows is refused.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO

import lz4.frame
import numpy as np
import zstandard

from .reading import Unreadable

_MAGIC = b"\x89MCAP0\r\n"
_CHUNK_BYTES = 8 << 20
_ROWS = 2_000_000
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _DATA_END = 3, 4, 5, 6, 9, 15
_OPENING = struct.Struct("<BQ")
_PACKED = "/rows"
_ROW = struct.Struct("<qI")
_SIZES = {1: ("<f8", 8), 2: ("<f4", 4), 15: ("<i4", 4), 16: ("<i8", 8)}
"""By FieldDescriptorProto.Type."""

Table = dict[str, Any]
"""Columns (n,) or (n, k); `t_us` the log time."""


class FlightRecording:
    """Some tables of a log; its attachments by name."""

    def __init__(self) -> None:
        self.tables: dict[str, Table] = {}
        self.attachments: dict[str, bytes] = {}


def read_log(file: BinaryIO, wanted: dict[str, tuple[str, ...]]) -> FlightRecording:
    """The columns `wanted` of each topic; `Unreadable` where it is no whole log or a table lacks a column."""
    schemas: dict[int, tuple[str, bytes]] = {}
    channels: dict[int, tuple[str, int]] = {}
    rows: dict[str, tuple[list[int], list[bytes]]] = {topic: ([], []) for topic in wanted}
    blocks: dict[str, list[tuple[int, int, bytes]]] = {}
    of_topic: dict[str, int] = {}
    recording, count = FlightRecording(), 0
    try:
        for op, body in _records(file):
            if op == _SCHEMA:
                number, at = int.from_bytes(body[:2], "little"), 2
                name, at = _text(body, at)
                _, at = _text(body, at)
                schemas[number] = name, _block(body, at)[0]
            elif op == _CHANNEL:
                number, schema = struct.unpack_from("<HH", body)
                channels[number] = _text(body, 4)[0], schema
            elif op == _MESSAGE:
                number, _, time_ns, _ = struct.unpack_from("<HIQQ", body)
                topic, schema = channels[number]
                if topic.startswith(_PACKED) and topic.removeprefix(_PACKED) in rows:
                    unpacked = _rows(body[22:])
                    count += len(unpacked)
                    if count > _ROWS:
                        raise Unreadable(f"log: more than {_ROWS} rows")
                    blocks.setdefault(topic.removeprefix(_PACKED), []).extend(unpacked)
                elif topic in rows:
                    count += 1
                    if count > _ROWS:
                        raise Unreadable(f"log: more than {_ROWS} rows")
                    of_topic[topic] = schema
                    rows[topic][0].append(time_ns // 1000)
                    rows[topic][1].append(body[22:])
            elif op == _ATTACHMENT:
                name, at = _text(body, 16)
                _, at = _text(body, at)
                recording.attachments[name] = body[at + 8 : at + 8 + int.from_bytes(body[at : at + 8], "little")]
    except (KeyError, IndexError, struct.error, UnicodeDecodeError, ValueError) as error:
        raise Unreadable(f"log: damaged ({type(error).__name__})") from None
    for topic, whole in blocks.items():
        whole.sort(key=lambda row: row[1])
        rows[topic] = [row[0] for row in whole], [row[2] for row in whole]
    for topic, (times, messages) in rows.items():
        if topic in of_topic:
            recording.tables[topic] = _columns(topic, times, messages, *schemas[of_topic[topic]], wanted[topic])
    return recording


def _rows(block: bytes) -> list[tuple[int, int, bytes]]:
    """(log time us, place, message) of each row: field 1 is the size of a row, field 2 the rows, byte by byte side by
    side, each less the row before."""
    size, data = 0, b""
    for number, at, length in _walk(block):
        part = block[at : at + length]
        size, data = (int.from_bytes(part, "little"), data) if number == 1 else (size, part)
    if size < _ROW.size or len(data) % size:
        raise Unreadable("log: a block of rows is malformed")
    table = np.cumsum(np.frombuffer(data, np.uint8).reshape(size, -1), axis=1, dtype=np.uint8).T
    return [(*_ROW.unpack_from(row), row[_ROW.size :]) for row in (each.tobytes() for each in table)]


def _records(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Every record of a closed log, also those in chunks."""
    if file.read(len(_MAGIC)) != _MAGIC:
        raise Unreadable("log: is no MCAP file")
    while True:
        head = file.read(_OPENING.size)
        if len(head) < _OPENING.size:
            raise Unreadable("log: ends early")
        op, size = _OPENING.unpack(head)
        if op == _DATA_END:
            return
        if size > 2 * _CHUNK_BYTES:
            raise Unreadable(f"log: a record of {size / 1e6:.0f} MB")
        body = file.read(size)
        if len(body) < size:
            raise Unreadable("log: ends early")
        if op != _CHUNK:
            yield op, body
            continue
        records, at = _unpacked(body), 0
        while at < len(records):
            op, size = _OPENING.unpack_from(records, at)
            at += _OPENING.size
            if at + size > len(records):
                raise Unreadable("log: a record reaches beyond its chunk")
            yield op, records[at : at + size]
            at += size


def _unpacked(body: bytes) -> bytes:
    _, _, size, crc = struct.unpack_from("<QQQI", body)
    kind, at = _text(body, 28)
    packed = body[at + 8 : at + 8 + int.from_bytes(body[at : at + 8], "little")]
    if size > _CHUNK_BYTES:
        raise Unreadable(f"log: a chunk of {size / 1e6:.0f} MB")
    try:
        if kind == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
                packed = reader.read(size + 1)
        elif kind == "lz4":
            packed = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        elif kind:
            raise Unreadable(f"log: a chunk is compressed with {kind[:20]!r}")
    except (zstandard.ZstdError, RuntimeError, EOFError):
        raise Unreadable("log: a chunk can't be unpacked") from None
    if len(packed) != size or (crc and zlib.crc32(packed) != crc):
        raise Unreadable("log: a chunk's checksum is wrong")
    return packed


def _columns(
    topic: str, times: list[int], messages: list[bytes], schema: str, described: bytes, wanted: tuple[str, ...]
) -> Table:
    """Columns of messages that all have the layout of the first, up to the last field wanted."""
    fields = _fields(described, schema.rpartition(".")[2])
    places, end = _layout(messages[0], fields, wanted, topic)
    if min(map(len, messages)) < end:
        raise Unreadable(f"log: {topic} has a message that is cut off")
    block = np.frombuffer(b"".join(message[:end] for message in messages), np.uint8).reshape(-1, end)
    table: Table = {"t_us": np.array(times, np.int64)}
    held = np.zeros(end, np.bool_)
    for name, (at, code, count) in places.items():
        width = int(code[-1]) * count
        held[at : at + width] = True
        column = np.ascontiguousarray(block[:, at : at + width]).view(code)
        table[name] = column[:, 0] if count == 1 else column
    if np.any(
        block[:, ~held & _fixed(messages[0][:end], fields)] != block[0, ~held & _fixed(messages[0][:end], fields)]
    ):
        raise Unreadable(f"log: {topic} has messages of different layouts")
    return table


def _layout(
    message: bytes, fields: dict[int, tuple[str, int]], wanted: tuple[str, ...], topic: str
) -> tuple[dict[str, tuple[int, str, int]], int]:
    """Where each wanted field lies: (at, type, count) by name; and where the last one ends."""
    found: dict[str, tuple[int, str, int]] = {}
    for number, at, size in _walk(message):
        name, kind = fields.get(number, ("", 0))
        if name in wanted and kind in _SIZES:
            code, each = _SIZES[kind]
            found[name] = at, code, size // each
    missing = [name for name in wanted if name not in found]
    if missing:
        raise Unreadable(f"log: {topic} has no {missing[0]}")
    return found, max(at + int(code[-1]) * count for at, code, count in found.values())


def _fixed(message: bytes, fields: dict[int, tuple[str, int]]) -> Any:
    """Which bytes of a message are tags and lengths."""
    out = np.ones(len(message), np.bool_)
    for _, at, size in _walk(message):
        out[at : at + size] = False
    return out


def _walk(data: bytes) -> Iterator[tuple[int, int, int]]:
    """(number, where its value begins, bytes) of each field; one that is cut off ends it."""
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        wire, size = tag & 7, 0
        if wire == 0:
            size = _varint(data, at)[1] - at
        elif wire == 2:
            size, at = _varint(data, at)
        else:
            size = {1: 8, 5: 4}[wire]
        if at + size > len(data):
            return
        yield tag >> 3, at, size
        at += size


def _fields(described: bytes, name: str) -> dict[int, tuple[str, int]]:
    """Number -> (name, type) of a message's fields, from a FileDescriptorSet (descriptor.proto)."""
    for _, at, size in _walk(described):
        file = described[at : at + size]
        for number, inner, length in _walk(file):
            message = file[inner : inner + length]
            if number == 4 and _of(message, 1) == name.encode():
                parts = [message[i : i + n] for k, i, n in _walk(message) if k == 2]
                return {_number(part, 3): (_of(part, 1).decode(), _number(part, 5)) for part in parts}
    return {}


def _of(message: bytes, number: int) -> bytes:
    return next(message[at : at + size] for k, at, size in _walk(message) if k == number)


def _number(message: bytes, number: int) -> int:
    return _varint(_of(message, number), 0)[0]


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80 or shift > 63:
            return value, at
        shift += 7


def _block(body: bytes, at: int) -> tuple[bytes, int]:
    size = int.from_bytes(body[at : at + 4], "little")
    if at + 4 + size > len(body):
        raise Unreadable("log: a record is cut off")
    return body[at + 4 : at + 4 + size], at + 4 + size


def _text(body: bytes, at: int) -> tuple[str, int]:
    data, at = _block(body, at)
    return data.decode(), at
