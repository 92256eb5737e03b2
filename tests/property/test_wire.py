"""Whatever comes over the wire: nothing raises, nothing false is believed, no good message is lost."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.generator.mavcrc import x25crc

from mavlink_bridge import messages as m
from mavlink_bridge.codec import Row
from mavlink_bridge.framing import StreamFraming, build_frame
from mavlink_bridge.link import Link, Received
from tests.hostile import malformed
from tests.mavlink_samples import random_event

SEED = 11
MALFORMED = 100_000
ROWS = pytest.mark.parametrize("row", m.MESSAGES, ids=lambda row: row.name)


def _frame(row: Row, rng: random.Random, sequence: int = 0) -> bytes:
    return build_frame(row.encode(random_event(row, rng)), row.id, row.crc_extra, sequence, 1, 1)


def _drain(link: Link) -> list[Received]:
    events = []
    while (received := link.next_event()) is not None:
        events.append(received)
    return events


def _holds_checked_frame(data: bytes) -> bool:
    """Whether `data` has a frame of the table anywhere whose CRC holds, by pymavlink's CRC and a plain search."""
    for at in range(len(data)):
        v2 = data[at] == 0xFD and len(data) - at >= 12
        if not v2 and not (data[at] == 0xFE and len(data) - at >= 8):
            continue
        header = 10 if v2 else 6
        number = int.from_bytes(data[at + 7 : at + 10], "little") if v2 else data[at + 5]
        end = at + header + data[at + 1]
        if number not in m.BY_ID or end + 2 > len(data):
            continue
        crc = x25crc(bytearray(data[at + 1 : end]))
        crc.accumulate(bytearray([m.BY_ID[number].crc_extra]))
        if crc.crc == int.from_bytes(data[end : end + 2], "little"):
            return True
    return False


@ROWS
def test_no_truncation_of_a_message_raises_or_is_taken_for_one(row: Row) -> None:
    rng = random.Random(SEED)
    link = Link(9, 9)
    for _ in range(3):
        frame = _frame(row, rng)
        for size in range(len(frame)):
            link.receive_datagram(frame[:size], 0)
            assert not _drain(link) or _holds_checked_frame(frame[:size])


@ROWS
def test_no_flipped_bit_raises_or_gives_a_message_whose_crc_is_wrong(row: Row) -> None:
    rng = random.Random(SEED + 1)
    link = Link(9, 9)
    frame = _frame(row, rng)
    for at in range(len(frame)):
        for bit in range(8):
            data = bytearray(frame)
            data[at] ^= 1 << bit
            link.receive_datagram(bytes(data), 0)
            assert not _drain(link) or _holds_checked_frame(bytes(data))


def test_a_hundred_thousand_malformed_datagrams_raise_nothing_and_cost_no_good_message() -> None:
    """A good heartbeat after every tenth; each arrives, and what else arrives has a CRC that holds."""
    rng = random.Random(SEED + 2)
    frames = [_frame(row, rng) for row in m.MESSAGES for _ in range(3)]
    sender, link = Link(1, 1), Link(9, 9)
    heard = 0
    for count in range(MALFORMED):
        data = malformed(rng, frames)
        link.receive_datagram(data, count)
        if link.next_event() is not None:
            assert _holds_checked_frame(data)
            _drain(link)
        if count % 10 == 0:
            sender.send(m.Heartbeat(2, 12, 0, count, 4))
            link.receive_datagram(sender.datagrams_to_send()[0], count)
            heartbeat = link.next_event()
            assert heartbeat is not None
            assert heartbeat.message.custom_mode == count
            heard += 1
    assert heard == MALFORMED // 10
    stats = link.stats
    assert min(stats.garbage, stats.bad_length, stats.bad_flags, stats.bad_crc, stats.unknown_id) > 0


@settings(max_examples=300, deadline=None, derandomize=True)
@given(garbage=st.lists(st.binary(max_size=320), max_size=6), spare=st.binary(max_size=40))
def test_a_good_message_after_any_garbage_is_never_lost(garbage: list[bytes], spare: bytes) -> None:
    """In datagrams of its own, and around it in the same datagram, unless the garbage itself holds a frame."""
    sender, link = Link(1, 1), Link(9, 9)
    for data in garbage:
        link.receive_datagram(data, 0)
    _drain(link)
    sender.send(m.Ping(5, 77, 0, 0))
    good = sender.datagrams_to_send()[0]
    link.receive_datagram(good, 1)
    link.receive_datagram(spare + good + spare, 2)
    assert [received.message.seq for received in _drain(link) if isinstance(received.message, m.Ping)] == [77, 77]


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    pieces=st.lists(st.one_of(st.binary(max_size=40), st.integers(0, len(m.MESSAGES) - 1)), max_size=12),
    cuts=st.lists(st.integers(1, 60), min_size=1, max_size=8),
)
def test_a_stream_cut_anywhere_gives_the_messages_of_the_stream_in_one_piece(
    pieces: list[bytes | int], cuts: list[int]
) -> None:
    rng = random.Random(SEED + 3)
    stream = b"".join(p if isinstance(p, bytes) else _frame(m.MESSAGES[p], rng) for p in pieces) + bytes(600)
    whole, cut = Link(9, 9), Link(9, 9, framing=StreamFraming())
    whole.receive_datagram(stream, 0)
    at = turn = 0
    while at < len(stream):
        step = cuts[turn % len(cuts)]
        cut.receive_datagram(stream[at : at + step], 0)
        at, turn = at + step, turn + 1
    expected = [type(received.message) for received in _drain(whole)]
    assert [type(received.message) for received in _drain(cut)] == expected
    assert len(expected) >= sum(isinstance(piece, int) for piece in pieces)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.binary(min_size=0, max_size=300), st.sampled_from(m.MESSAGES))
def test_any_payload_with_a_right_crc_decodes_or_is_refused_but_never_raises(payload: bytes, row: Row) -> None:
    frame = build_frame(payload[:255] or b"\0", row.id, row.crc_extra, 0, 1, 1)
    link = Link(9, 9)
    link.receive_datagram(frame, 0)
    received = link.next_event()
    assert (received is None) == (link.stats.not_finite == 1)
    if received is not None:
        assert type(received.message) is row.event
        link.send(received.message)  # what came in can go out again
        assert len(link.datagrams_to_send()) == 1
