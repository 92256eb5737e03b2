"""Datagrams that nobody sane sends: malformed ones, and good frames whose numbers are hostile."""

from __future__ import annotations

import math
import random
import struct
from functools import cache

from mavlink_bridge.codec import Row
from mavlink_bridge.framing import build_frame
from mavlink_bridge.layout import WireField
from mavlink_bridge.messages import MESSAGES
from tests.mavlink_samples import random_event

FLOATS = (math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, -1.0, 0.0, 1.0, 7.0, 1e6)
COMMANDS = (20, 21, 22, 34, 176, 178, 179, 192, 246, 400, 410, 510, 511, 512, 519, 520, 31999)


@cache
def good_frames(seed: int) -> list[bytes]:
    """Three sane frames of every message."""
    rng = random.Random(seed)
    return [
        build_frame(row.encode(random_event(row, rng)), row.id, row.crc_extra, 0, 7, 7)
        for row in MESSAGES
        for _ in range(3)
    ]


def malformed(rng: random.Random, frames: list[bytes]) -> bytes:
    """A datagram that isn't a good frame: noise, or a frame mutated, cut, or spliced with another."""
    kind = rng.randrange(6)
    if kind == 0:
        return rng.randbytes(rng.randint(0, 300))
    frame = bytearray(rng.choice(frames))
    if kind == 1:
        return bytes(frame[: rng.randrange(len(frame))])
    if kind == 2:
        other = rng.choice(frames)
        return bytes(frame[: rng.randrange(len(frame))]) + other[rng.randrange(1, len(other)) :]
    if kind == 3:
        return bytes([rng.choice([0xFD, 0xFE])]) * rng.randint(1, 40)
    for _ in range(rng.randint(1, 6)):
        frame[rng.randrange(len(frame))] ^= rng.randint(1, 255)
    return bytes(frame) if kind == 4 else bytes(frame) + rng.randbytes(rng.randint(0, 20))


def _number(field: WireField, rng: random.Random) -> float | int:
    if field.is_float:
        return rng.choice(FLOATS)
    low, high = field.integer_range
    return rng.choice((low, high, 0, 1, rng.randint(low, high)))


def _value(field: WireField, rng: random.Random) -> list[float | int | bytes]:
    if field.name == "target_system":
        return [rng.choice((0, 1, 1, 1, 255))]
    if field.name == "target_component":
        return [rng.choice((0, 1, 1, 1, 190))]
    if field.name == "command":
        return [rng.choice((*COMMANDS, rng.randrange(65536)))]
    if field.is_bytes:
        return [rng.randbytes(field.length)]
    return [_number(field, rng) for _ in range(field.elements)]


@cache
def _packer(row: Row) -> struct.Struct:
    return struct.Struct("<" + "".join(field.format for field in row.layout.fields))


def hostile(rng: random.Random, *, system: int, component: int, row: Row | None = None) -> bytes:
    """A frame with a right checksum whose numbers are extreme, infinite or none at all."""
    row = row or rng.choice(MESSAGES)
    values = [value for field in row.layout.fields for value in _value(field, rng)]
    size = _packer(row).size
    payload = _packer(row).pack(*values)
    assert len(payload) == size
    return build_frame(payload, row.id, row.crc_extra, rng.randrange(256), system, component)
