"""What the dead-man reads and writes: a few MAVLink 2 frames and the memory that it shares with the companion.

Its process has to be there within milliseconds and to need next to no memory, so nothing here or in `dead_man` imports
the codec, the dialect or numpy: `struct` alone.  A test holds every layout against the codec's.
Source of frames and checksums: mavlink.io/en/guide/serialization.html, of signatures message_signing.html.
"""

from __future__ import annotations

from collections import namedtuple
from struct import Struct

MAGIC = 0xFD
HEADER = Struct("<BBBBBBB")
HEADER_SIZE = 10
CRC_SIZE, SIGNATURE_SIZE, HASH_SIZE = 2, 13, 6
LONGEST = HEADER_SIZE + 255 + CRC_SIZE + SIGNATURE_SIZE
_SIGNED = 0x01
_AUTOPILOT = 1

HEARTBEAT, ATTITUDE_QUATERNION, COMMAND_ACK, COMMAND_LONG, SET_ATTITUDE_TARGET, CURRENT_MODE = 0, 31, 77, 76, 82, 436
EXTRAS = {
    HEARTBEAT: 50, ATTITUDE_QUATERNION: 246, COMMAND_ACK: 143, COMMAND_LONG: 152, SET_ATTITUDE_TARGET: 49,
    CURRENT_MODE: 193,
}  # fmt: skip
"""Message id -> CRC extra."""
LAYOUTS = {
    HEARTBEAT: Struct("<I5B"),  # custom_mode, type, autopilot, base_mode, system_status, mavlink_version
    ATTITUDE_QUATERNION: Struct("<I7f"),  # time_boot_ms, q, rates
    COMMAND_ACK: Struct("<HBBiBB"),  # command, result, progress, result_param2, target_system, target_component
    COMMAND_LONG: Struct("<7fH3B"),  # params, command, target_system, target_component, confirmation
    SET_ATTITUDE_TARGET: Struct("<I8f3B"),  # time_boot_ms, q, rates, thrust, target_system, target_component, mask
    CURRENT_MODE: Struct("<IIB"),  # custom_mode, intended_custom_mode, standard_mode
}

CompanionRecord = namedtuple(
    "CompanionRecord",
    "serial sent_ns stamp_us next_stamp heard_stamp q_w q_x q_y q_z thrust_norm thrust_factor flags "
    "system own_system own_component sequence peer_host peer_port",
)
"""The companion's last word.  serial: grows with each tick; sent_ns: monotonic time of the last setpoint; stamp_us: its
vehicle time; next_stamp, heard_stamp: signing stamps, next of ours and newest of the vehicle's; q: attitude, body to
NED; thrust_norm: what carries the vehicle, before the curve thrust_factor (THR_MDL_FAC) is applied, 0 on the ground;
flags: `ACTIVE`, `IN_OFFBOARD`; system: the vehicle's; sequence: our next one; peer: IPv4 address (0: none) and port."""
COMPANION_STRUCT = Struct("<qqqqq6f5BxIH")
ACTIVE, IN_OFFBOARD = 1, 2
"""ACTIVE: setpoints are streamed, silence is to be answered.  IN_OFFBOARD: seen there of late, by the companion."""

DeadManRecord = namedtuple(
    "DeadManRecord", "alive_ns acts silent_ns began_ns hold_ns held_ns mode_ns mode sequence touched frames"
)
"""The dead-man's last word.  alive_ns: monotonic time; acts: how often it acted; of the last time: silent_ns, the last
setpoint before it; began_ns; hold_ns, the first command to hold; held_ns, Hold seen; mode_ns, mode: when a mode was
heard last, and which; sequence: the next one free; touched: 1 where anybody else changed the mode; frames: sent."""
DEAD_MAN_STRUCT = Struct("<qqqqqqqIBBxxq")
NOBODY = DeadManRecord(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)

SHARED_SIZE = 1024
QUIT_AT = 8
"""Offset of a byte that is 1 once the companion wants no more of the dead-man."""
COMPANION_AT, DEAD_MAN_AT = 64, 512
_SLOT = 128


def _steps() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte >> 1) ^ (0x8408 if byte & 1 else 0)
        table.append(byte)
    return tuple(table)


_STEPS = _steps()


def checksum(data: bytes, extra: int) -> int:
    """CRC-16/MCRF4XX of a frame without its magic byte, and the message's CRC extra."""
    crc, steps = 0xFFFF, _STEPS
    for byte in data:
        crc = steps[(crc ^ byte) & 0xFF] ^ crc >> 8
    return steps[(crc ^ extra) & 0xFF] ^ crc >> 8


class Keyed:
    """Signs and checks with a secret key; stamps always grow."""

    def __init__(self, key: bytes, link_id: int) -> None:
        from hashlib import sha256  # costs as much as all the rest; only who signs pays

        self._key, self._link_id, self._sha256 = key, link_id, sha256
        self._last = 0

    def signature(self, frame: bytes, stamp: int) -> bytes:
        """The 13 bytes to append; `stamp` at least."""
        self._last = max(stamp, self._last + 1)
        head = bytes((self._link_id,)) + self._last.to_bytes(6, "little")
        return head + self._sha256(self._key + frame + head).digest()[:HASH_SIZE]

    def is_good(self, frame: bytes, newer_than: int) -> bool:
        """Whether a whole signed frame has this key's signature and a stamp newer than that."""
        body, head, given = frame[:-SIGNATURE_SIZE], frame[-SIGNATURE_SIZE:-HASH_SIZE], frame[-HASH_SIZE:]
        stamp = int.from_bytes(head[1:], "little")
        return stamp > newer_than and self._sha256(self._key + body + head).digest()[:HASH_SIZE] == given


def build(number: int, values: tuple[float, ...], sequence: int, record: CompanionRecord) -> bytes:
    """A frame from the companion's system and component, unsigned."""
    payload = LAYOUTS[number].pack(*values).rstrip(b"\0") or b"\0"
    head = HEADER.pack(MAGIC, len(payload), 0, 0, sequence, record.own_system, record.own_component)
    return _checked(head + number.to_bytes(3, "little") + payload, number)


def signed(frame: bytes, number: int, keyed: Keyed, stamp: int) -> bytes:
    """The same frame with a signature."""
    frame = _checked(frame[:2] + bytes((_SIGNED,)) + frame[3:-CRC_SIZE], number)
    return frame + keyed.signature(frame, stamp)


def _checked(frame: bytes, number: int) -> bytes:
    return frame + checksum(frame[1:], EXTRAS[number]).to_bytes(2, "little")


class Reader:
    """Bytes as they come, in datagrams or pieces of a stream, to the vehicle's messages that matter here."""

    def __init__(self, keyed: Keyed | None, *, stream: bool) -> None:
        self._keyed, self._stream = keyed, stream
        self._rest = b""

    def read(self, data: bytes, record: CompanionRecord) -> list[tuple[int, tuple[float, ...]]]:
        """(message id, unpacked fields) of `record.system`'s autopilot, in order; whatever is not right is skipped."""
        data = self._rest + data
        found, at, size = [], 0, len(data)
        while (at := data.find(MAGIC, at)) >= 0 and at + HEADER_SIZE <= size:
            _, length, flags, _, _, system, component = HEADER.unpack_from(data, at)
            end = at + HEADER_SIZE + length + CRC_SIZE + SIGNATURE_SIZE * (flags & _SIGNED)
            number = int.from_bytes(data[at + 7 : at + 10], "little")
            if end > size:
                if self._stream:
                    break
                at += 1
            elif number not in EXTRAS:
                at = end if end == size or data[end] == MAGIC else at + 1
            elif self._is_good(data[at:end], number, length, record):
                if system == record.system and component == _AUTOPILOT:
                    layout = LAYOUTS[number]
                    payload = data[at + HEADER_SIZE : at + HEADER_SIZE + length]
                    found.append((number, layout.unpack(payload[: layout.size].ljust(layout.size, b"\0"))))
                at = end
            else:
                at += 1
        self._rest = data[at:] if self._stream and at >= 0 and size - at < LONGEST else b""
        return found

    def _is_good(self, frame: bytes, number: int, length: int, record: CompanionRecord) -> bool:
        crc_at = HEADER_SIZE + length
        if checksum(frame[1:crc_at], EXTRAS[number]) != int.from_bytes(frame[crc_at : crc_at + 2], "little"):
            return False
        if self._keyed is None:
            return True
        return frame[2] == _SIGNED and self._keyed.is_good(frame, record.heard_stamp)


def store(memory: memoryview, at: int, layout: Struct, values: tuple[float, ...]) -> None:
    """Write a record where its reader is not looking, then turn its eyes there; whole even if killed half-way."""
    spare = 1 - memory[at]
    layout.pack_into(memory, at + 8 + _SLOT * spare, *values)
    memory[at] = spare


def load(memory: memoryview, at: int, layout: Struct) -> tuple[float, ...]:
    """The newest whole record."""
    while True:
        start = at + 8 + _SLOT * (memory[at] & 1)
        first, again = bytes(memory[start : start + layout.size]), bytes(memory[start : start + layout.size])
        if first == again and start == at + 8 + _SLOT * (memory[at] & 1):
            return layout.unpack(first)
