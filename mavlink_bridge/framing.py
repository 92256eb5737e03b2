"""MAVLink frames: bytes -> checked frames, payload -> frame; and how frames lie in what arrives.

MAVLink 2: FD, length, incompatible flags, compatible flags, sequence, system, component, 24-bit id, payload without its
trailing zeros, CRC, and 13 bytes of signature where flag 1 says so.  MAVLink 1 (inbound only): FE, length, sequence,
system, component, 8-bit id, payload, CRC.  The CRC is MCRF4XX over everything but the magic byte, then the CRC extra.
Source: mavlink.io/en/guide/serialization.html.

A frame counts only if its CRC holds.  Where it doesn't, the search goes on one byte further and not behind the
supposed frame, so that a stray magic byte never costs a good frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from struct import Struct
from typing import NamedTuple, final

from fastcrc.crc16 import mcrf4xx

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
SIGNED = 0x01
"""The only incompatible flag there is: a signature follows."""
SIGNATURE_SIZE = 13
HEADER_SIZE = 10
LONGEST_FRAME = HEADER_SIZE + 255 + 2 + SIGNATURE_SIZE

HEADER = Struct("<BHxBBI")
"""Magic, length | incompatible flags << 8, (compatible flags), sequence, system, component | id << 8."""
CRC = Struct("<H")
ONE_BYTE = tuple(bytes([value]) for value in range(256))
"""The CRC extra goes into a CRC as one more byte."""
_STEP = tuple(mcrf4xx(byte, 0) for byte in ONE_BYTE)  # one more byte: _STEP[(crc ^ byte) & 0xFF] ^ crc >> 8
_INDEX = next(index for index in range(256) if _STEP[index] >> 8 == 0xFF)
_BEFORE_MAGIC = (_STEP[_INDEX] ^ 0xFFFF) << 8 | _INDEX ^ MAGIC_V2
"""A CRC that starts here has MAVLink's start value after the magic byte, which so needn't be cut off first."""
_pack_header, _pack_crc = HEADER.pack, CRC.pack


class Frame(NamedTuple):
    """A frame whose CRC holds."""

    end: int
    """Where the next one may begin."""
    payload_at: int
    payload_size: int
    sequence: int
    system: int
    component: int
    id: int
    flags: int


class FrameFault(NamedTuple):
    """Why there is no frame here."""

    reason: str
    """Name of the counter it belongs to."""
    needs: int = 0
    """Where more bytes could make it one: how many in all, from its first byte on."""
    source: int = 0
    """system << 8 | component of what looks like a frame but can't be checked."""
    sequence: int = 0


BAD_CRC = FrameFault("bad_crc")
BAD_FLAGS = FrameFault("bad_flags")
GARBAGE = FrameFault("garbage")


def frame_at(data: bytes, start: int, crc_extras: Mapping[int, int]) -> Frame | FrameFault:
    """The frame that begins at `start`.  One with an id that has no CRC extra can't be checked and is a fault."""
    have = len(data) - start
    magic = data[start]
    if magic == MAGIC_V2:
        if have < HEADER_SIZE + 2:
            return FrameFault("bad_length", HEADER_SIZE + 2)
        _, size, sequence, system, number = HEADER.unpack_from(data, start)
        size, flags = size & 0xFF, size >> 8
        if flags > SIGNED:
            return BAD_FLAGS
        component, number = number & 0xFF, number >> 8
        payload_at = start + HEADER_SIZE
        end = payload_at + size + 2 + SIGNATURE_SIZE * flags
    elif magic == MAGIC_V1:
        if have < 8:
            return FrameFault("bad_length", 8)
        size, sequence, system, component, number = data[start + 1 : start + 6]
        flags = 0
        payload_at = start + 6
        end = payload_at + size + 2
    else:
        return GARBAGE
    if end - start > have:
        return FrameFault("bad_length", end - start)
    extra = crc_extras.get(number)
    crc_at = payload_at + size
    if extra is None:
        return FrameFault("unknown_id", 0, system << 8 | component, sequence)
    if mcrf4xx(data[start + 1 : crc_at] + ONE_BYTE[extra]) != CRC.unpack_from(data, crc_at)[0]:
        return BAD_CRC
    return Frame(end, payload_at, size, sequence, system, component, number, flags)


def build_frame(
    payload: bytes, number: int, crc_extra: int, sequence: int, system: int, component: int, flags: int = 0
) -> bytes:
    """A MAVLink 2 frame without its signature; `payload` whole, its trailing zeros are cut here."""
    if payload[-1] == 0:
        payload = payload.rstrip(b"\0") or b"\0"
    frame = _pack_header(MAGIC_V2, len(payload) | flags << 8, sequence, system, component | number << 8) + payload
    return frame + _pack_crc(mcrf4xx(frame + ONE_BYTE[crc_extra], _BEFORE_MAGIC))


def next_magic(data: bytes, start: int) -> int:
    """Where the next frame could begin at or after `start`; len(data) where there is none."""
    two = data.find(MAGIC_V2, start)
    one = data.find(MAGIC_V1, start, two if two >= 0 else len(data))
    return one if one >= 0 else two if two >= 0 else len(data)


class Framing(ABC):
    """How frames lie in what arrives; holds what is left over between two arrivals."""

    @abstractmethod
    def arrive(self, data: bytes) -> bytes:
        """What to search, given what arrived."""

    @abstractmethod
    def keep(self, data: bytes, start: int) -> bool:
        """Take back `data` from `start` on, a frame that isn't complete; False: it never will be."""


@final
class DatagramFraming(Framing):
    """Frames never span datagrams: whatever one holds, the next starts afresh."""

    def arrive(self, data: bytes) -> bytes:
        """The datagram itself."""
        return data

    def keep(self, data: bytes, start: int) -> bool:
        """Never."""
        return False


@final
class StreamFraming(Framing):
    """A byte stream (serial line, TCP): a frame may arrive in pieces."""

    def __init__(self) -> None:
        self._rest = b""

    def arrive(self, data: bytes) -> bytes:
        """What was left over, then the new bytes."""
        data, self._rest = self._rest + data, b""
        return data

    def keep(self, data: bytes, start: int) -> bool:
        """At most one frame's worth of bytes waits."""
        self._rest = data[start:]
        return True
