"""A ULog's messages as they lie in the file: only what is whole and well-framed goes on to pyulog.

pyulog trusts sizes; on damaged files it can turn in circles.  So a file is walked first: definitions, then data, each
message of a known type and wholly there; after damage the walk goes on at the next synchronisation message.  What PX4
appended after a crash (offsets in the flag bits) follows the rest.  Layout: docs.px4.io, "ULog File Format".
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

HEADER_BYTES = 16
_FRAME = struct.Struct("<HB")
_SYNC = b"\x08\x00S\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_DEFINITIONS = b"FIMPQ"
_KNOWN = frozenset(b"BFIMPQARSOLCD")
_FLAGS, _DATA = ord("B"), ord("D")
_FLAG_BYTES = 40
_BASIC = {"int8_t", "uint8_t", "int16_t", "uint16_t", "int32_t", "uint32_t", "int64_t", "uint64_t", "float", "double",
          "bool", "char"}  # fmt: skip
_MOST_FIELDS = 4000
_DEEPEST = 6


@dataclass(slots=True)
class Frames:
    """The file, mended: what can be given to pyulog."""

    data: bytes
    damage: list[str] = field(default_factory=list)
    topics: NDArray[np.uint16] = field(default_factory=lambda: np.zeros(0, np.uint16))
    """(N,) number of the topic of each message of data, in the order of the file."""


@dataclass(slots=True)
class _Walk:
    definitions: list[bytes] = field(default_factory=list)
    rest: list[bytes] = field(default_factory=list)
    formats: dict[str, list[tuple[str, int]]] = field(default_factory=dict)
    lost: int = 0


def mended(data: bytes) -> Frames:
    """The header, whole definitions and whole data of a ULog; `damage` says what was left out."""
    at, appended = HEADER_BYTES, []
    flags = b""
    if len(data) >= at + 3 and data[at + 2] == _FLAGS:
        size = _FRAME.unpack_from(data, at)[0]
        flags = data[at + 3 : at + 3 + size]
        at += 3 + size
        if len(flags) >= _FLAG_BYTES:
            appended = [offset for offset in struct.unpack_from("<3Q", flags, 16) if at < offset < len(data)]
    walk = _Walk()
    ends = [*sorted(appended), len(data)]
    for end in ends:
        _walk(data, at, end, walk, last=end == len(data))
        at = end
    kept = [part for part in walk.rest if part[2] != ord("A") or _is_small(part, walk.formats)]
    walk.lost += sum(map(len, walk.rest)) - sum(map(len, kept))
    blank = flags[:8] + bytes(_FLAG_BYTES - 8)
    head = data[:HEADER_BYTES] + (_FRAME.pack(_FLAG_BYTES, _FLAGS) + blank if len(flags) >= 8 else b"")
    damage = [f"damaged or cut off: {walk.lost} bytes could not be read"] if walk.lost else []
    incompatible = flags[8:16]
    if len(incompatible) == 8 and (incompatible[0] & ~1 or any(incompatible[1:])):
        damage.append("of a newer format than this program knows; what it knows was read")
    topics = np.frombuffer(b"".join(part[3:5] for part in kept if part[2] == _DATA and len(part) > 5), np.uint16)
    return Frames(head + b"".join(walk.definitions) + b"".join(kept), damage, topics)


def _walk(data: bytes, at: int, end: int, walk: _Walk, *, last: bool) -> None:
    """Sort the messages from `at` to `end`; a message cut by the end of an early section is what a crash leaves."""
    unpack = _FRAME.unpack_from
    rest, definitions = walk.rest, walk.definitions
    while at + 3 <= end:
        size, kind = unpack(data, at)
        to = at + 3 + size
        if to <= end and size and kind in _KNOWN:
            part = data[at:to]
            if rest or kind not in _DEFINITIONS:
                if rest or kind in b"ALC":
                    rest.append(part)
            else:
                definitions.append(part)
                if kind == 70:  # F
                    _note_format(part, walk.formats)
            at = to
            continue
        if to <= end and size and 64 < kind < 123:  # a letter: a message of a later format
            at = to
            continue
        found = data.find(_SYNC, at + 1, end)
        if found < 0:
            break
        walk.lost += found - at
        at = found
    if last:
        walk.lost += end - at


def _note_format(part: bytes, formats: dict[str, list[tuple[str, int]]]) -> None:
    name, _, fields = part[3:].decode("utf-8", "replace").partition(":")
    out = []
    for said in fields.split(";"):
        kind, _, count = said.partition(" ")[0].partition("[")
        if kind:
            digits = count.rstrip("]")
            out.append(
                (kind, int(digits) if digits.isdecimal() and len(digits) < 6 else 1 if not count else _MOST_FIELDS)
            )
    formats[name] = out


def _is_small(part: bytes, formats: dict[str, list[tuple[str, int]]]) -> bool:
    """Whether a logged topic comes out at a sane number of fields: formats can be nested into each other."""
    return 0 < _fields(part[6:].decode("utf-8", "replace"), formats, 0) <= _MOST_FIELDS


def _fields(name: str, formats: dict[str, list[tuple[str, int]]], depth: int) -> int:
    if depth > _DEEPEST or name not in formats:
        return _MOST_FIELDS + 1
    total = 0
    for kind, count in formats[name]:
        total += count * (1 if kind in _BASIC else _fields(kind, formats, depth + 1))
        if total > _MOST_FIELDS:
            break
    return total
