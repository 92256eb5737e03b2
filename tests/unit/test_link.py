"""The link without a network: two of them, and what may go wrong between them."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from pymavlink.generator.mavcrc import x25crc

from mavlink_bridge import messages as m
from mavlink_bridge.framing import StreamFraming, build_frame
from mavlink_bridge.layout import dialect
from mavlink_bridge.link import MAX_DATAGRAM, Link, Received
from tests.mavlink_samples import random_event

HEARTBEAT = m.Heartbeat(2, 12, 0x81, 0x60000, 4)


def _sent(link: Link, *messages: Any) -> list[bytes]:
    for message in messages:
        link.send(message)
    return link.datagrams_to_send()


def _events(link: Link) -> list[Received]:
    events = []
    while (received := link.next_event()) is not None:
        events.append(received)
    return events


def _deliver(link: Link, datagrams: list[bytes]) -> list[Any]:
    for data in datagrams:
        link.receive_datagram(data, 0)
    return [received.message for received in _events(link)]


def _counters(link: Link) -> dict[str, int]:
    """Counters that aren't 0."""
    return {name: count for name, count in link.stats.as_dict().items() if count}


def test_a_message_arrives_with_its_sender_sequence_and_time() -> None:
    sender, receiver = Link(1, 1), Link(245, 190)
    sender.send(HEARTBEAT)
    sender.send(HEARTBEAT)
    for t_us, data in enumerate(sender.datagrams_to_send(), 1000):
        receiver.receive_datagram(data, t_us)
    assert _events(receiver) == [Received(1, 1, 0, 1000, HEARTBEAT), Received(1, 1, 1, 1001, HEARTBEAT)]
    assert receiver.next_event() is None
    assert sender.datagrams_to_send() == []


def test_each_component_of_a_system_counts_its_own_sequence_from_0_to_255_and_round() -> None:
    sender, receiver = Link(1, 1), Link(2, 2)
    for _ in range(300):
        sender.send(HEARTBEAT)
        sender.send(HEARTBEAT, component=190)
    for data in sender.datagrams_to_send():
        receiver.receive_datagram(data, 0)
    events = _events(receiver)
    assert [e.seq for e in events if e.component == 1] == [i % 256 for i in range(300)]
    assert [e.seq for e in events if e.component == 190] == [i % 256 for i in range(300)]
    assert _counters(receiver) == {"received": 600}


def test_missing_sequence_numbers_are_counted_as_lost_for_each_sender_apart() -> None:
    one, other, receiver = Link(1, 1), Link(2, 1), Link(9, 9)
    first, second = _sent(one, *[HEARTBEAT] * 300), _sent(other, *[HEARTBEAT] * 300)
    lost = {5, 6, 7, 120, 256}
    delivered = [data for i, data in enumerate(first) if i not in lost]
    for i in range(300):
        _deliver(receiver, delivered[i : i + 1] + second[i : i + 1])
    assert receiver.stats.lost == len(lost)
    assert receiver.stats.received == 600 - len(lost)


def test_a_late_message_is_delivered_and_no_longer_counts_as_lost() -> None:
    sender, receiver = Link(1, 1), Link(9, 9)
    a, b, c, d = _sent(sender, *(m.Ping(i, i, 0, 0) for i in range(4)))
    assert [message.seq for message in _deliver(receiver, [a, c, d, b])] == [0, 2, 3, 1]
    assert _counters(receiver) == {"received": 4, "reordered": 1}


def test_a_repeated_message_is_counted_and_delivered() -> None:
    """A sender that never counts would otherwise be heard only once."""
    sender, receiver = Link(1, 1), Link(9, 9)
    datagrams = _sent(sender, HEARTBEAT) * 3
    assert _deliver(receiver, datagrams) == [HEARTBEAT] * 3
    assert _counters(receiver) == {"received": 3, "duplicate": 2}


def test_a_sender_that_starts_anew_is_heard_and_costs_no_more_than_one_gap() -> None:
    receiver = Link(9, 9)
    _deliver(receiver, _sent(Link(1, 1), *[HEARTBEAT] * 100))
    _deliver(receiver, _sent(Link(1, 1), *[HEARTBEAT] * 100))
    assert receiver.stats.received == 200
    assert receiver.stats.lost == 256 - 100


def test_once_the_peer_is_known_only_its_losses_count() -> None:
    receiver = Link(9, 9)
    receiver.expect_peer(1)
    for system in (1, 2):
        datagrams = _sent(Link(system, 1), *[HEARTBEAT] * 5)
        assert len(_deliver(receiver, datagrams[:1] + datagrams[4:])) == 2
    assert receiver.stats.lost == 3


def test_several_frames_in_one_datagram_all_arrive_in_order() -> None:
    sender, receiver = Link(1, 1), Link(9, 9)
    pings = [m.Ping(i, i, 0, 0) for i in range(1, 6)]
    assert _deliver(receiver, [b"".join(_sent(sender, *pings))]) == pings


@pytest.mark.parametrize("garbage", [b"", b"\x00", b"hello", b"\xfd", b"\xfe", b"\xfd\xfd\xfe" * 9, bytes(range(256))])
def test_garbage_round_frames_in_a_datagram_costs_none_of_them(garbage: bytes) -> None:
    sender, receiver = Link(1, 1), Link(9, 9)
    a, b = _sent(sender, m.Ping(1, 1, 0, 0), m.Ping(2, 2, 0, 0))
    messages = _deliver(receiver, [garbage + a + garbage + b + garbage])
    assert [message.seq for message in messages] == [1, 2]
    assert receiver.stats.skipped_bytes == 3 * len(garbage)
    assert receiver.stats.dropped == (3 if garbage else 0)


def test_a_corrupt_frame_costs_itself_only() -> None:
    sender, receiver = Link(1, 1), Link(9, 9)
    a, b, c = _sent(sender, *(m.Ping(i, i, 0, 0) for i in range(3)))
    corrupt = b[:12] + bytes([b[12] ^ 1]) + b[13:]
    assert [message.seq for message in _deliver(receiver, [a + corrupt + c])] == [0, 2]
    assert receiver.stats.bad_crc == 1
    assert receiver.stats.lost == 1


@pytest.mark.parametrize("flags", [2, 3, 0x80])
def test_a_frame_with_unknown_flags_is_dropped_although_its_crc_is_right(flags: int) -> None:
    row, receiver = m.BY_EVENT[m.Heartbeat], Link(9, 9)
    frame = build_frame(row.encode(HEARTBEAT), row.id, row.crc_extra, 0, 1, 1, flags)
    assert _deliver(receiver, [frame, *_sent(Link(1, 1), HEARTBEAT)]) == [HEARTBEAT]
    assert receiver.stats.bad_flags == 1


def test_a_frame_whose_length_lies_is_dropped_although_its_crc_is_right() -> None:
    row, receiver = m.BY_EVENT[m.Heartbeat], Link(9, 9)
    frame = bytearray(build_frame(row.encode(HEARTBEAT), row.id, row.crc_extra, 0, 1, 1))
    for length in (0, 8, 10, 255):
        frame[1] = length
        frame[-2:] = x25crc(frame[1:-2] + bytes([row.crc_extra])).crc.to_bytes(2, "little")
        assert _deliver(receiver, [bytes(frame)]) == []


def test_an_unknown_message_is_counted_and_is_no_loss() -> None:
    """One that the dialect knows but the table doesn't (its CRC is checked), and one that nobody knows."""
    known = dialect.MAVLink_terrain_report_message(1, 2, 3, 4.0, 5.0, 6, 7)
    sender = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    sender.seq = 1
    known_frame = bytes(known.pack(sender))
    ours = _sent(Link(1, 1), *[HEARTBEAT] * 5)
    nobodys = [build_frame(b"\x01\x02\x03", 54321, 99, sequence, 1, 1) for sequence in (2, 3)]
    receiver = Link(9, 9)
    assert _deliver(receiver, [ours[0], known_frame, b"".join(nobodys), ours[4]]) == [HEARTBEAT, HEARTBEAT]
    assert receiver.stats.unknown_id == 2  # a run of bytes that belong to no known frame counts once
    assert receiver.stats.lost == 0


def test_a_message_with_a_number_that_must_be_finite_and_is_not_is_dropped() -> None:
    receiver = Link(9, 9)
    bad = m.LocalPositionNed(0, (0.0, math.nan, 0.0), (0.0, 0.0, 0.0))
    assert _deliver(receiver, _sent(Link(1, 1), bad, HEARTBEAT)) == [HEARTBEAT]
    assert _counters(receiver) == {"received": 1, "not_finite": 1}


def test_what_may_be_nan_passes() -> None:
    """PX4 sends NaN for what isn't set, and takes a NaN thrust for motors off: the receiver's decision."""
    nan = math.nan
    messages = [
        m.SetAttitudeTarget(0, 1, 1, 128, (nan,) * 4, (0.0, 0.0, 0.0), nan),
        m.CommandLong(1, 1, 22, 0, (nan,) * 7),
        m.VfrHud(nan, 0.0, 0, 0, 0.0, 0.0),
    ]
    received = _deliver(Link(9, 9), _sent(Link(1, 1), *messages))
    assert [str(message) for message in received] == [str(message) for message in messages]


class _FakeSigning:
    """Signs with a running number and takes only what carries the next one."""

    def __init__(self) -> None:
        self.count = self.refused = 0

    def signature(self, frame: bytes) -> bytes:
        assert frame[2] == 1
        self.count += 1
        return self.count.to_bytes(13, "little")

    def judge(self, frame: bytes, signed: bool, number: int, now_us: int) -> str:
        if not signed:
            return "unsigned"
        if int.from_bytes(frame[-13:], "little") <= self.count:
            return "replayed"
        self.count += 1
        return ""


def test_without_a_key_a_signed_message_is_taken_and_counted() -> None:
    sender, receiver = Link(1, 1, signing=_FakeSigning()), Link(9, 9)
    assert _deliver(receiver, _sent(sender, HEARTBEAT)) == [HEARTBEAT]
    assert receiver.stats.signed == 1


def test_with_a_key_only_what_it_accepts_comes_in() -> None:
    sender, receiver = Link(1, 1, signing=_FakeSigning()), Link(9, 9, signing=_FakeSigning())
    signed = _sent(sender, HEARTBEAT)
    unsigned = _sent(Link(1, 1), HEARTBEAT)
    assert _deliver(receiver, signed + signed + unsigned) == [HEARTBEAT]
    assert (receiver.stats.replayed, receiver.stats.unsigned) == (1, 1)


def test_messages_are_packed_into_datagrams_that_are_not_too_long() -> None:
    sender, receiver = Link(1, 1), Link(9, 9)
    events = [random_event(row, random.Random(3)) for row in m.MESSAGES]
    for event in events:
        sender.send(event)
    datagrams = sender.datagrams_to_send(max_bytes=10_000)
    assert len(datagrams) < len(events) // 4
    assert all(len(data) <= MAX_DATAGRAM for data in datagrams)
    assert [type(message) for message in _deliver(receiver, datagrams)] == [type(event) for event in events]


@pytest.mark.parametrize("chunk", [1, 2, 7, 64, 10_000])
def test_a_stream_in_pieces_of_any_size_gives_every_message(chunk: int) -> None:
    rng = random.Random(4)
    sender, receiver = Link(1, 1), Link(9, 9, framing=StreamFraming())
    pings = [m.Ping(rng.getrandbits(60), i, 0, 0) for i in range(50)]
    stream = b"".join(frame + b"\xfd\x00junk" * (i % 3) for i, frame in enumerate(_sent(sender, *pings)))
    stream += bytes(300)  # what is held back for a frame that never comes is read when more arrives
    messages = []
    for at in range(0, len(stream), chunk):
        messages += _deliver(receiver, [stream[at : at + chunk]])
    assert messages == pings


def test_a_link_must_have_a_system_and_a_component() -> None:
    for system, component in ((0, 1), (256, 1), (1, 0), (1, 256)):
        with pytest.raises(ValueError, match=r"1\.\.255"):
            Link(system, component)


@pytest.mark.parametrize("broken", range(4))
def test_a_broken_frame_among_others_in_one_datagram_costs_only_itself(broken: int) -> None:
    sender, receiver = Link(1, 1), Link(2, 2)
    frames = _sent(sender, *(HEARTBEAT._replace(custom_mode=k) for k in range(4)))
    frames[broken] = frames[broken][:-1] + bytes([frames[broken][-1] ^ 0xFF])
    received = _deliver(receiver, [b"".join(frames)])
    assert [message.custom_mode for message in received] == [k for k in range(4) if k != broken]
    assert _counters(receiver)["bad_crc"] == 1
