"""Framing: bytes to checked frames and back, with pymavlink's CRC and frames as the oracle."""

from __future__ import annotations

import random
from typing import NamedTuple

import pytest
from pymavlink.generator.mavcrc import x25crc

from mavlink_bridge import messages as m
from mavlink_bridge.codec import camel_to_upper, row, wire
from mavlink_bridge.framing import (
    LONGEST_FRAME,
    DatagramFraming,
    Frame,
    FrameFault,
    StreamFraming,
    build_frame,
    frame_at,
    next_magic,
)
from mavlink_bridge.layout import CRC_EXTRAS, crc_extra_of, dialect, layout
from tests.mavlink_samples import IN_DIALECT

EXTRAS = {entry.id: entry.crc_extra for entry in m.MESSAGES}


def _crc(data: bytes, extra: int) -> int:
    """pymavlink's own, byte by byte."""
    crc = x25crc(bytearray(data))
    crc.accumulate(bytearray([extra]))
    value: int = crc.crc
    return value


def _frame(payload: bytes = bytes(range(1, 29)), number: int = 32, sequence: int = 5) -> bytes:
    return build_frame(payload, number, EXTRAS[number], sequence, 3, 4)


def test_a_frames_crc_is_the_one_that_pymavlink_computes() -> None:
    rng = random.Random(1)
    for _ in range(300):
        payload = rng.randbytes(rng.randint(1, 254)) + b"\x01"
        extra = rng.randint(0, 255)
        frame = build_frame(payload, rng.randint(0, 2**24 - 1), extra, rng.randint(0, 255), 250, 190)
        assert int.from_bytes(frame[-2:], "little") == _crc(frame[1:-2], extra)


def test_a_frame_built_here_is_found_again_with_all_its_fields() -> None:
    data = b"\x00\x01" + _frame()
    frame = frame_at(data, 2, EXTRAS)
    assert frame == Frame(len(data), 12, 28, 5, 3, 4, 32, 0)


def test_trailing_zeros_of_a_payload_are_cut_but_never_its_first_byte() -> None:
    assert _frame(b"\x07" + bytes(27))[1] == 1
    assert _frame(bytes(28))[1] == 1
    assert len(_frame(bytes(28))) == 13


def test_a_cut_payload_is_padded_with_zeros_again() -> None:
    entry = m.BY_ID[32]
    event = m.LocalPositionNed(4_000, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    frame = build_frame(entry.encode(event), 32, EXTRAS[32], 0, 1, 1)
    assert frame[1] == 8
    theirs = dialect.MAVLink(None).decode(bytearray(frame))
    assert (theirs.time_boot_ms, theirs.x, theirs.vz) == (4, 1.0, 0.0)


def test_mavlink_1_frames_of_pymavlink_are_understood() -> None:
    sender = dialect.MAVLink(None, srcSystem=7, srcComponent=8)
    sender.seq = 9
    message = dialect.MAVLink_heartbeat_message(2, 12, 81, 0x60000, 4, 3)
    data = bytes(message.pack(sender, force_mavlink1=True))
    assert data[0] == 0xFE
    frame = frame_at(data, 0, EXTRAS)
    assert isinstance(frame, Frame)
    assert frame == Frame(len(data), 6, 9, 9, 7, 8, 0, 0)
    assert m.BY_ID[0].decode(data, frame.payload_at) == m.Heartbeat(2, 12, 81, 0x60000, 4)


def test_a_signed_frame_is_thirteen_bytes_longer() -> None:
    sender = dialect.MAVLink(None, srcSystem=7, srcComponent=8)
    sender.signing.secret_key = bytearray(range(32))
    sender.signing.sign_outgoing = True
    data = bytes(dialect.MAVLink_heartbeat_message(2, 12, 81, 1, 4, 3).pack(sender))
    frame = frame_at(data, 0, EXTRAS)
    assert isinstance(frame, Frame)
    assert (frame.flags, frame.end) == (1, len(data))
    assert frame_at(data[:-1], 0, EXTRAS) == FrameFault("bad_length", len(data))


@pytest.mark.parametrize("flags", [2, 3, 4, 0x80, 0xFF])
def test_a_frame_with_unknown_incompatible_flags_is_none(flags: int) -> None:
    data = build_frame(bytes(range(1, 29)), 32, EXTRAS[32], 0, 1, 1, flags)
    frame = frame_at(data, 0, EXTRAS)
    assert isinstance(frame, FrameFault)
    assert frame.reason == "bad_flags"


def test_every_prefix_of_a_frame_asks_for_more_and_is_no_frame() -> None:
    data = _frame()
    for size in range(1, len(data)):
        fault = frame_at(data[:size], 0, EXTRAS)
        assert isinstance(fault, FrameFault)
        assert fault.reason == "bad_length"
        assert size < fault.needs <= len(data)


def test_the_longest_frame_is_as_long_as_mavlink_says() -> None:
    frame = build_frame(bytes([1]) * 255, 110, EXTRAS[110], 0, 1, 1, 1)
    assert len(frame) + 13 == LONGEST_FRAME == 280


def test_the_next_magic_byte_is_found_whichever_comes_first() -> None:
    assert next_magic(b"ab\xfd\xfe", 0) == 2
    assert next_magic(b"ab\xfe\xfd", 0) == 2
    assert next_magic(b"ab\xfe\xfd", 3) == 3
    assert next_magic(b"\xfd\xfd", 1) == 1
    assert next_magic(b"abc", 0) == 3


def test_a_datagram_keeps_nothing_and_a_stream_keeps_an_unfinished_frame() -> None:
    assert not DatagramFraming().keep(b"abc", 1)
    stream = StreamFraming()
    assert stream.keep(b"abc", 1)
    assert stream.arrive(b"d") == b"bcd"
    assert stream.arrive(b"e") == b"e"


def test_crc_extras_follow_from_names_and_types_as_in_the_dialect() -> None:
    """All of the dialect's messages whose base fields are known: those that have no extension fields.

    pymavlink doesn't say where extensions begin, so every count of base fields is tried; one must give its CRC extra.
    """
    for entry in IN_DIALECT:
        fields = entry.layout.fields
        if entry.name in ("PARAM_VALUE", "PARAM_SET"):  # read as bits here
            continue
        candidates = {crc_extra_of(entry.name, fields[:count]) for count in range(1, len(fields) + 1)}
        assert CRC_EXTRAS[entry.id] in candidates, entry.name


def test_layouts_have_pymavlinks_sizes() -> None:
    for entry in IN_DIALECT:
        theirs = {message.msgname: message for message in dialect.mavlink_map.values()}[entry.name]
        known = [field for field in entry.layout.fields if field.name in theirs.fieldnames]
        assert [field.name for field in known] == theirs.ordered_fieldnames
        assert sum(field.size for field in known) == theirs.unpacker.size


def test_a_row_refuses_fields_that_event_or_message_do_not_have() -> None:
    class SystemTime(NamedTuple):
        unix_us: int
        t_boot_us: int

    times = {"unix_us": "time_unix_usec", "t_boot_us": wire("time_boot_ms", times=1000)}
    assert row(SystemTime, **times).id == 2
    with pytest.raises(ValueError, match="no field"):
        row(SystemTime, **times, t_us="time_unix_usec")
    with pytest.raises(ValueError, match="no field"):
        row(SystemTime, nan="speed_mps", **times)
    with pytest.raises(KeyError, match="SYSTEM_TIME has no field"):
        row(SystemTime, unix_us="time", t_boot_us="time_boot_ms")
    with pytest.raises(KeyError):
        layout("NO_SUCH_MESSAGE")


def test_a_class_name_gives_the_messages_name() -> None:
    assert camel_to_upper("LocalPositionNed") == "LOCAL_POSITION_NED"
    assert camel_to_upper("Heartbeat") == "HEARTBEAT"
