"""MCAP as it lies on disk: every record that is whole, in order, from finished, cut-off and damaged files alike.

The index at the file's end isn't used: a killed process leaves none, and reading everything in one pass is as fast.
Nothing in a file can raise from here but `InputError` for what is no MCAP at all; damage ends up in `notes`.
Record layout: https://mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import lz4.frame
import zstandard

from flightstack.types import InputError
from flightstack_logs.topics import Attachment

MAGIC = b"\x89MCAP0\r\n"
_MAX_CHUNK_BYTES = 1 << 30
_FOOTER_BYTES = 29
_COMPRESSIONS = (b"\x03\x00\x00\x00lz4", b"\x04\x00\x00\x00zstd")
_BEFORE_COMPRESSION = 37
"""Bytes of a chunk's record before its compression: opcode, size, two times, size and checksum unpacked."""
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _METADATA, _DATA_END = 2, 3, 4, 5, 6, 9, 12, 15
_TOP_LEVEL = (_SCHEMA, _CHANNEL, _MESSAGE, _ATTACHMENT, _METADATA)
"""Records outside chunks that matter here; indexes, header and summary don't."""
_OPENING = struct.Struct("<BQ")
_MESSAGE_START = struct.Struct("<BQHIQ")
_CHUNK_START = struct.Struct("<QQQI")
_MESSAGE_BYTES = 22
"""Of a message's record, before its data: channel, sequence, log time, publish time."""
_PADDING = bytes(32)
"""So that the last record can be opened as if it were a message, whatever it is."""


@dataclass(frozen=True, slots=True)
class Schema:
    """What the messages of a channel look like."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True, eq=False)
class McapChannel:
    """One channel with all its messages, in file order."""

    topic: str
    message_encoding: str
    metadata: dict[str, str]
    schema: Schema | None
    times_ns: list[int] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class McapContent:
    """Everything of a file that could be read."""

    channels: dict[int, McapChannel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[Attachment] = field(default_factory=list)
    finished: bool = False
    """Whether the file was closed properly."""
    notes: list[str] = field(default_factory=list)
    orphans: int = 0
    """Messages of channels that nothing describes."""


class _Cursor:
    """Reads the fields of a rare record; ValueError where it ends too early."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def take(self, size: int) -> bytes:
        part = self._data[self._at : self._at + size]
        if len(part) != size:
            raise ValueError("a record is too short")
        self._at += size
        return part

    def text(self) -> str:
        return self.take(self.number(4)).decode(errors="replace")

    def texts(self) -> dict[str, str]:
        end = self.number(4) + self._at
        out: dict[str, str] = {}
        while self._at < end:
            key = self.text()
            out[key] = self.text()
        return out


def scan(data: bytes, source: str) -> McapContent:
    """All whole records of an MCAP file; InputError if it isn't one."""
    if not data.startswith(MAGIC):
        raise InputError(f"log {source}: is no MCAP file")
    content = McapContent()
    schemas: dict[int, Schema] = {}
    _summary(data, content, schemas)
    at = len(MAGIC)
    while at + _OPENING.size <= len(data):
        op, size = _OPENING.unpack_from(data, at)
        begin, at = at, at + _OPENING.size + size
        if op == 0 or at > len(data):
            at = _next_chunk(data, begin + 1)
            if at < 0:
                content.notes.append(f"cut off: the last {len(data) - begin} bytes are not whole")
                break
            content.notes.append(f"damaged: the {at - begin} bytes from byte {begin} on are no record; skipped")
            continue
        try:
            if op == _CHUNK:
                _messages(_unpack_chunk(data[begin + _OPENING.size : at]), content, schemas)
            elif op == _DATA_END:
                break
            elif op in _TOP_LEVEL:
                _messages(data[begin:at], content, schemas)
        except ValueError as error:
            content.notes.append(f"damaged: {error} at byte {begin}{_span_words(op, data, begin)}; skipped")
    if content.orphans:
        content.notes.append(f"damaged: {content.orphans} messages belong to topics whose description was lost")
    content.finished = data.endswith(MAGIC) and len(data) > 2 * len(MAGIC)
    if not content.finished and not any(note.startswith("cut off") for note in content.notes):
        content.notes.append("cut off: the log was not closed; it ends with the last chunk written")
    return content


def _summary(data: bytes, content: McapContent, schemas: dict[int, Schema]) -> None:
    """Schemas and channels are told once more at the end of a finished file: they survive damage to their chunk."""
    footer = len(data) - len(MAGIC) - _FOOTER_BYTES
    if footer < len(MAGIC) or not data.endswith(MAGIC) or data[footer] != _FOOTER:
        return
    at = int.from_bytes(data[footer + _OPENING.size : footer + _OPENING.size + 8], "little")
    while len(MAGIC) <= at < footer:
        op, size = _OPENING.unpack_from(data, at)
        body = data[at + _OPENING.size : at + _OPENING.size + size]
        try:
            if op in (_SCHEMA, _CHANNEL):
                _rare_record(op, body, content, schemas)
        except ValueError:
            return
        at += _OPENING.size + size


def _next_chunk(data: bytes, at: int) -> int:
    """Where the next chunk that can be unpacked begins; -1 where there is none."""
    while True:
        places = [p - _BEFORE_COMPRESSION for mark in _COMPRESSIONS if (p := data.find(mark, at)) >= 0]
        places = [p for p in places if p >= at - _BEFORE_COMPRESSION]
        if not places:
            return -1
        begin = min(places)
        if begin >= at and data[begin] == _CHUNK:
            size = int.from_bytes(data[begin + 1 : begin + 9], "little")
            record = data[begin + _OPENING.size : begin + _OPENING.size + size]
            try:
                if len(record) == size and _unpack_chunk(record):
                    return begin
            except ValueError:
                pass
        at = begin + _BEFORE_COMPRESSION + 1


def _span_words(op: int, data: bytes, begin: int) -> str:
    """From when to when a chunk that is lost would have reached, by its own header."""
    header = data[begin + _OPENING.size : begin + _OPENING.size + 16]
    if op != _CHUNK or len(header) < 16:
        return ""
    first_s, last_s = (1e-9 * int.from_bytes(part, "little") for part in (header[:8], header[8:]))
    return f" (what was logged from {first_s:.2f} s to {last_s:.2f} s)" if first_s <= last_s < 1e10 else ""


def _unpack_chunk(record: bytes) -> bytes:
    """The records inside a chunk; ValueError if they can't be had as they were."""
    if len(record) < _CHUNK_START.size:
        raise ValueError("a chunk is too short")
    *_, size, crc = _CHUNK_START.unpack_from(record)
    rest = _Cursor(record[_CHUNK_START.size :])
    compression = rest.text()
    packed = rest.take(rest.number(8))
    if size > _MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk claims {size} bytes")
    try:
        if compression == "zstd":
            records = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        elif compression == "lz4":
            records = lz4.frame.decompress(packed)
        elif compression == "":
            records = packed
        else:
            raise ValueError(f"a chunk is compressed with {compression!r}, which is not known")
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ValueError(f"a chunk can't be unpacked ({error})") from None
    if len(records) != size or (crc and zlib.crc32(records) != crc):
        raise ValueError("a chunk's checksum is wrong")
    return records


def _messages(records: bytes, content: McapContent, schemas: dict[int, Schema]) -> None:
    """Sort records into `content`; ValueError at the first that is malformed."""
    end = len(records)
    padded = records + _PADDING
    channels = content.channels
    at = 0
    while at < end:
        op, size, channel_id, _, time_ns = _MESSAGE_START.unpack_from(padded, at)
        begin = at + 9
        at = begin + size
        if at > end:
            raise ValueError("a record reaches beyond its chunk")
        if op != _MESSAGE:
            _rare_record(op, padded[begin:at], content, schemas)
        elif size < _MESSAGE_BYTES:
            raise ValueError("a message is too short")
        elif channel_id not in channels:
            content.orphans += 1
        else:
            channel = channels[channel_id]
            channel.times_ns.append(time_ns)
            channel.messages.append(padded[begin + _MESSAGE_BYTES : at])


def _rare_record(op: int, body: bytes, content: McapContent, schemas: dict[int, Schema]) -> None:
    record = _Cursor(body)
    if op == _SCHEMA:
        number = record.number(2)
        schemas[number] = Schema(record.text(), record.text(), record.take(record.number(4)))
    elif op == _CHANNEL:
        number, schema = record.number(2), record.number(2)
        if number not in content.channels:
            topic, encoding = record.text(), record.text()
            content.channels[number] = McapChannel(topic, encoding, record.texts(), schemas.get(schema))
    elif op == _ATTACHMENT:
        record.take(16)
        content.attachments.append(Attachment(record.text(), record.text(), record.take(record.number(8))))
    elif op == _METADATA:
        name = record.text()
        content.metadata[name] = record.texts()
