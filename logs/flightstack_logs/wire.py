"""The messages of TABLE topics: protocol buffers whose fields all have a fixed place.

Numbers are written as fixed-size fields (double, float, sfixed32, sfixed64), arrays packed, zeros too, strings last.
So every message of a topic has the same values in the same places: writing is one `struct.pack`, reading a whole topic
one `numpy.frombuffer`, and any other reader (Foxglove, protobuf) sees plain proto3 with its descriptor in the file.
Wire format: https://protobuf.dev/programming-guides/encoding/
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flightstack.types import U8
from flightstack_logs.topics import Topic

_VARINT, _FIXED64, BYTES, _FIXED32 = 0, 1, 2, 5
_STRING = 9
_LENGTHY = {"string": _STRING, "bytes": 12}


@dataclass(frozen=True, slots=True)
class _Scalar:
    code: str
    """For `struct` and numpy, little endian."""
    wire: int
    number: int
    """FieldDescriptorProto.Type."""
    result: type[np.generic]


SCALARS = {
    "double": _Scalar("d", _FIXED64, 1, np.float64),
    "float": _Scalar("f", _FIXED32, 2, np.float64),
    "int64": _Scalar("q", _FIXED64, 16, np.int64),
    "int32": _Scalar("i", _FIXED32, 15, np.int64),
    "bool": _Scalar("?", _VARINT, 8, np.bool_),
}
_BY_NUMBER = {scalar.number: scalar for scalar in SCALARS.values()}


def varint(value: int) -> bytes:
    """Base-128 encoding of a number >= 0."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def read_varint(data: bytes, at: int) -> tuple[int, int]:
    """The number that begins at `at`, and where it ends; ValueError if it is cut off."""
    value = shift = 0
    while True:
        if at >= len(data) or shift > 63:
            raise ValueError("a number is cut off")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7


def walk(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Each field of a message as (number, value): int for a varint, else bytes; ValueError if malformed."""
    at = 0
    while at < len(data):
        tag, at = read_varint(data, at)
        wire = tag & 7
        if wire == _VARINT:
            value, at = read_varint(data, at)
            yield tag >> 3, value
            continue
        if wire == BYTES:
            size, at = read_varint(data, at)
        elif wire in (_FIXED64, _FIXED32):
            size = 8 if wire == _FIXED64 else 4
        else:
            raise ValueError(f"wire type {wire} is not known")
        if at + size > len(data):
            raise ValueError("a field is cut off")
        yield tag >> 3, data[at : at + size]
        at += size


def _bytes_field(number: int, data: bytes) -> bytes:
    return varint(number << 3 | BYTES) + varint(len(data)) + data


def _int_field(number: int, value: int) -> bytes:
    return varint(number << 3 | _VARINT) + varint(value)


def descriptor(topic: Topic) -> bytes:
    """The FileDescriptorSet of a TABLE topic's schema (google/protobuf/descriptor.proto), as MCAP wants it."""
    package, _, name = topic.schema.rpartition(".")
    message = _bytes_field(1, name.encode())
    for number, field in enumerate(topic.fields, 1):
        kind = _LENGTHY[field.type] if field.type in _LENGTHY else SCALARS[field.type].number
        entry = _bytes_field(1, field.name.encode()) + _int_field(3, number) + _int_field(4, 3 if field.size else 1)
        message += _bytes_field(2, entry + _int_field(5, kind))
    file_name = f"{topic.schema.replace('.', '/')}.proto"
    file = _bytes_field(1, file_name.encode()) + _bytes_field(2, package.encode())
    return _bytes_field(1, file + _bytes_field(4, message) + _bytes_field(12, b"proto3"))


@dataclass(frozen=True, slots=True)
class _ProtoField:
    name: str
    type: int


def _proto_fields(schema: bytes, message_name: str) -> dict[int, _ProtoField]:
    """Number -> field of the named message in a FileDescriptorSet; ValueError where it isn't in there."""
    package, _, short = message_name.rpartition(".")
    for _, file in _parts(schema, 1):
        if _one(file, 2).decode() != package:
            continue
        for _, message in _parts(file, 4):
            if _one(message, 1).decode() != short:
                continue
            fields, number, kind = {}, 3, 5  # of FieldDescriptorProto
            for _, entry in _parts(message, 2):
                numbers = {key: value for key, value in walk(entry) if isinstance(value, int)}
                fields[numbers[number]] = _ProtoField(_one(entry, 1).decode(), numbers[kind])
            return fields
    raise ValueError(f"its schema does not describe {message_name}")


def _parts(data: bytes, number: int) -> list[tuple[int, bytes]]:
    return [(key, value) for key, value in walk(data) if key == number and isinstance(value, bytes)]


def _one(data: bytes, number: int) -> bytes:
    parts = _parts(data, number)
    return parts[-1][1] if parts else b""


@dataclass(frozen=True, slots=True)
class _Layout:
    dtype: np.dtype[np.void]
    results: dict[str, type[np.generic]]
    texts: dict[int, str]
    """Number -> name of the string fields, which come behind the fixed part."""


def _layout(first: bytes, fields: dict[int, _ProtoField]) -> _Layout:
    """Where each field of a topic's messages lies, by its first message."""
    names: list[str] = []
    formats: list[Any] = []
    offsets: list[int] = []
    results: dict[str, type[np.generic]] = {}
    texts = {number: field.name for number, field in fields.items() if field.type == _STRING}
    at = 0
    while at < len(first):
        tag, begin = read_varint(first, at)
        if tag >> 3 in texts:
            break
        field = fields.get(tag >> 3)
        scalar = _BY_NUMBER.get(field.type) if field else None
        if field is None or scalar is None:
            raise ValueError(f"field {tag >> 3} is of a kind that tables don't have")
        dtype = np.dtype("<" + scalar.code)
        shape: tuple[int, ...] = ()
        size = dtype.itemsize
        if tag & 7 == BYTES:
            size, begin = read_varint(first, begin)
            shape = (size // dtype.itemsize,)
        names.append(field.name)
        formats.append((dtype, shape))
        offsets.append(begin)
        results[field.name] = scalar.result
        at = begin + size
    if at > len(first) or len(names) + len(texts) != len(fields):
        raise ValueError("its messages lack fields that its schema has")
    record = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at})
    return _Layout(record, results, texts)


def _check_prefixes(block: bytes, layout: _Layout, count: int) -> None:
    """All bytes between the values (tags, lengths) must be the same in every message."""
    rows = np.frombuffer(block, dtype=np.uint8).reshape(count, layout.dtype.itemsize)
    between = np.ones(layout.dtype.itemsize, dtype=np.bool_)
    for dtype, offset, *_ in (layout.dtype.fields or {}).values():
        between[offset : offset + dtype.itemsize] = False
    if not np.array_equal(rows[:, between], np.broadcast_to(rows[0, between], (count, int(between.sum())))):
        raise ValueError("its messages differ in form")


def decode_columns(schema: bytes, schema_name: str, messages: Sequence[bytes] | U8) -> dict[str, np.ndarray]:
    """Messages of one TABLE topic (at least one) as columns (N,) or (N, k), in the schema's order.

    `messages` may be (N, size) bytes where all are of one size.  Floats come as float64, integers as int64, strings as
    numpy strings.  ValueError where they aren't of this form.
    """
    fields = _proto_fields(schema, schema_name)
    layout = _layout(bytes(messages[0]), fields)
    size, count = layout.dtype.itemsize, len(messages)
    if isinstance(messages, np.ndarray):
        block = messages[:, :size].tobytes()
        told = [row.tobytes() for row in messages] if messages.shape[1] > size else []
    else:
        block = b"".join([message[:size] for message in messages] if layout.texts else messages)
        told = list(messages)
    if len(block) != size * count:
        raise ValueError("its messages differ in length")
    columns: dict[str, np.ndarray] = {}
    if size:
        _check_prefixes(block, layout, count)
        values = np.frombuffer(block, dtype=layout.dtype)
        columns = {name: np.ascontiguousarray(values[name].astype(result)) for name, result in layout.results.items()}
    columns |= _texts(told, size, count, layout.texts)
    return {field.name: columns[field.name] for _, field in sorted(fields.items())}


def _texts(messages: Sequence[bytes], begin: int, count: int, texts: dict[int, str]) -> dict[str, np.ndarray]:
    """The string columns: what stands behind the fixed part of each of `count` messages; absent means empty."""
    columns = {number: [""] * count for number in texts}
    for row, message in enumerate(messages):
        if len(message) == begin:
            continue
        for number, value in walk(message[begin:]):
            if number not in columns or not isinstance(value, bytes):
                raise ValueError("its messages differ in form")
            columns[number][row] = value.decode(errors="replace")
    return {name: np.array(columns[number], dtype=np.str_) for number, name in texts.items()}
