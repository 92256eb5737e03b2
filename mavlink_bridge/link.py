"""One MAVLink link, sans-IO: bytes in, events out; messages in, bytes out.  No sockets, no clock.

    link.receive_datagram(data, now_us)         whatever came in; never raises, drops and counts what it can't use
    while (received := link.next_event()): ...  what it meant
    link.send(message)                          queue a message
    for data in link.datagrams_to_send(): ...   what must go out

What is dropped is counted by reason in `link.stats`; losses are seen in the gaps of each sender's sequence numbers.
Commands, modes and time-outs are the business of those who use the link.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

from fastcrc.crc16 import mcrf4xx

from mavlink_bridge.codec import Row
from mavlink_bridge.framing import (
    CRC,
    HEADER,
    HEADER_SIZE,
    MAGIC_V2,
    ONE_BYTE,
    SIGNED,
    DatagramFraming,
    Frame,
    Framing,
    build_frame,
    frame_at,
    next_magic,
)
from mavlink_bridge.layout import CRC_EXTRAS
from mavlink_bridge.messages import BY_EVENT, BY_ID, MESSAGES

MAX_DATAGRAM = 1400
"""Bytes: below every usual MTU."""
_REORDER_WINDOW = 16
_SHORTEST = HEADER_SIZE + 2
_EXTRAS = CRC_EXTRAS | {row.id: row.crc_extra for row in MESSAGES}
_KNOWN: dict[int, tuple[bytes, Row | None]] = {
    number: (ONE_BYTE[extra], BY_ID.get(number)) for number, extra in _EXTRAS.items()
}
"""Id -> CRC extra, and the row, None where there is none."""


class Received(NamedTuple):
    """A message and who sent it."""

    system: int
    component: int
    seq: int
    t_us: int
    """The `now_us` it was received with."""
    message: Any
    """One of the event classes of `mavlink_bridge.messages`."""


class RunReader(Protocol):
    """Reads several messages of one sender at once (`frequent`)."""

    source: int
    """system << 8 | component."""

    def read(self, data: bytes, at: int, sequence: int) -> tuple[int, int, object | None]:
        """What begins at `at`, its sequence number given: where it ends, how many messages, and what they are."""


class Signing(Protocol):
    """MAVLink 2 signing, as the link needs it."""

    refused: int
    """Frames that did not count."""

    def judge(self, frame: bytes, signed: bool, number: int, now_us: int) -> str:
        """Empty where a received frame (whole, signature included) may be used, else the counter it belongs to."""

    def signature(self, frame: bytes) -> bytes:
        """The 13 bytes to append to an outgoing frame whose signed flag is set."""


@dataclass(slots=True)
class Stats:
    """What a link has seen, counted."""

    received: int = 0
    """Messages handed out."""
    sent: int = 0
    garbage: int = 0
    """Runs of bytes between frames that begin with no magic byte."""
    bad_length: int = 0
    """Frames cut short."""
    bad_flags: int = 0
    """Frames with incompatible flags that no one knows."""
    bad_crc: int = 0
    skipped_bytes: int = 0
    """All bytes that belonged to no frame."""
    bad_signature: int = 0
    """Signed with another key, or altered on the way."""
    unsigned: int = 0
    """Without a signature where one is needed."""
    replayed: int = 0
    """Rightly signed, but no newer than what was heard before."""
    unknown_id: int = 0
    not_finite: int = 0
    """NaN or infinity where the message's row forbids it."""
    lost: int = 0
    """Missing sequence numbers."""
    duplicate: int = 0
    """The sender's last sequence number again (delivered all the same: some senders never count)."""
    reordered: int = 0
    """Late ones, no longer counted as lost."""
    signed: int = 0

    @property
    def dropped(self) -> int:
        """Frames and runs of bytes that gave no message."""
        return (
            self.garbage + self.bad_length + self.bad_flags + self.bad_crc
            + self.bad_signature + self.unsigned + self.replayed + self.unknown_id + self.not_finite
        )  # fmt: skip

    def as_dict(self) -> dict[str, int]:
        """Counter by name, for logs and JSON."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class Link:
    """One link of ours: `system` and `component` are what we send as."""

    def __init__(
        self, system: int, component: int, *, framing: Framing | None = None, signing: Signing | None = None
    ) -> None:
        if not (1 <= system <= 255 and 1 <= component <= 255):
            raise ValueError(f"system {system} and component {component} must lie in 1..255")
        self.system = system
        self.component = component
        self.stats = Stats()
        self._framing = framing or DatagramFraming()
        self._signing = signing
        self._flags = SIGNED if signing else 0
        self._events: deque[Received] = deque()
        self._outgoing: list[bytes] = []
        self._next_sequence: dict[int, int] = {}
        self._expected: dict[int, int] = {}
        self._peer = 0
        self._lean = signing is None and isinstance(self._framing, DatagramFraming)
        self._runs: RunReader | None = None

    @property
    def signing(self) -> bool:
        """What goes out is signed, and only what is rightly signed comes in."""
        return self._signing is not None

    @property
    def refused(self) -> int:
        """Frames that did not count for want of our key's signature; 0 where there is no key."""
        return 0 if self._signing is None else self._signing.refused

    def expect_peer(self, system: int) -> None:
        """From now on only this system's sequence gaps count as losses; its messages and others' come in as before."""
        self._peer = system

    def read_runs(self, reader: RunReader) -> None:
        """From now on what `reader` can read is handed out as it says, where good frames follow one another."""
        self._runs = reader

    def receive_datagram(self, data: bytes, now_us: int) -> None:
        """Take what arrived at `now_us`: one datagram, or any piece of a stream."""
        at = self._take_plain(data, now_us) if self._lean else 0
        if at < len(data):
            self._search(self._framing.arrive(data[at:]), now_us)

    def next_event(self) -> Received | None:
        """The oldest message not yet handed out, None where there is none."""
        return self._events.popleft() if self._events else None

    def take_events(self) -> tuple[Received, ...]:
        """All of them, the oldest first."""
        if not self._events:
            return ()
        taken = tuple(self._events)
        self._events.clear()
        return taken

    def send(self, message: Any, *, component: int | None = None) -> None:
        """Queue a message, as this link's component or as another one of the same system."""
        row = BY_EVENT[type(message)]
        source = component or self.component
        sequences = self._next_sequence
        sequence = sequences.get(source, 0)
        sequences[source] = (sequence + 1) & 0xFF
        frame = build_frame(row.encode(message), row.id, row.crc_extra, sequence, self.system, source, self._flags)
        if self._signing is not None:
            frame += self._signing.signature(frame)
        self._outgoing.append(frame)
        self.stats.sent += 1

    def queue(self, frames: bytes, ends: list[int]) -> None:
        """Queue unsigned frames of this link's own, one after the other, each numbered on from `next_sequence`."""
        self._outgoing += [frames[begin:end] for begin, end in pairwise((0, *ends))]
        sequences, own = self._next_sequence, self.component
        sequences[own] = (sequences.get(own, 0) + len(ends)) & 0xFF
        self.stats.sent += len(ends)

    def next_sequence(self, component: int) -> int:
        """Sequence number of the next message as that component."""
        return self._next_sequence.get(component, 0)

    def skip_sequence(self, sequence: int, component: int) -> None:
        """Somebody else spoke as that component: go on from `sequence`."""
        self._next_sequence[component] = sequence & 0xFF

    def datagrams_to_send(self, max_bytes: int = 0) -> list[bytes]:
        """What to send now, in order: a datagram per message, or packed into datagrams of at most `max_bytes`."""
        if not self._outgoing:
            return []
        outgoing, self._outgoing = self._outgoing, []
        if not max_bytes or len(outgoing) == 1:
            return outgoing
        return _packed(outgoing, min(max_bytes, MAX_DATAGRAM))

    def _take_plain(self, data: bytes, now_us: int) -> int:
        """Take good unsigned frames that follow one another (nearly always: all there is); where they end."""
        at, have, expected, runs = 0, len(data), self._expected, self._runs
        while at + _SHORTEST <= have:
            if runs is not None and (sequence := expected.get(runs.source, -1)) >= 0:
                at, count, message = runs.read(data, at, sequence)
                if count:
                    expected[runs.source] = (sequence + count) & 0xFF
                    self.stats.received += count
                    sender = runs.source >> 8, runs.source & 0xFF, sequence, now_us, message
                    self._events.append(_new_received(Received, sender))
                    continue
            magic, size, sequence, system, number = _header(data, at)
            known, crc_at = _KNOWN.get(number >> 8), at + HEADER_SIZE + size
            if known is None or magic != MAGIC_V2 or size > 0xFF or crc_at + 2 > have:  # the size's upper byte: flags
                break
            extra, row = known
            if mcrf4xx(data[at + 1 : crc_at] + extra) != _crc(data, crc_at)[0]:
                break
            component = number & 0xFF
            source = system << 8 | component
            if row is None or expected.get(source) != sequence:
                self._take(data, at + HEADER_SIZE, size, sequence, system, component, number >> 8, now_us)
            else:
                expected[source] = (sequence + 1) & 0xFF
                self._hand_out(row, data, at + HEADER_SIZE, size, system, component, sequence, now_us)
            at = crc_at + 2
        return at

    def _search(self, data: bytes, now_us: int) -> None:
        """Take every frame in `data`, whatever lies between them."""
        at, size = 0, len(data)
        in_frames = True  # one run of unusable bytes is counted once, by its first fault
        while at < size:
            frame = frame_at(data, at, _EXTRAS)
            if isinstance(frame, Frame):
                if self._trusted(data, at, frame, now_us):
                    self._take(data, *frame[1:-1], now_us)
                at = frame.end
                in_frames = True
                continue
            if frame.needs and self._framing.keep(data, at):
                return
            if in_frames:
                setattr(self.stats, frame.reason, getattr(self.stats, frame.reason) + 1)
                in_frames = False
            if frame.source and self._expected.get(frame.source) == frame.sequence:
                self._expected[frame.source] = (frame.sequence + 1) & 0xFF  # most likely good, only unknown: no loss
            after = next_magic(data, at + 1)
            self.stats.skipped_bytes += after - at
            at = after

    def _trusted(self, data: bytes, at: int, frame: Frame, now_us: int) -> bool:
        """Whether signing lets a frame pass; without a key, signatures are neither checked nor needed."""
        self.stats.signed += frame.flags & SIGNED
        if self._signing is None:
            return True
        fault = self._signing.judge(data[at : frame.end], bool(frame.flags & SIGNED), frame.id, now_us)
        if fault:
            setattr(self.stats, fault, getattr(self.stats, fault) + 1)
        return not fault

    def _take(
        self, data: bytes, at: int, size: int, sequence: int, system: int, component: int, number: int, now_us: int
    ) -> None:
        """A frame whose CRC holds, its payload at `at`: account for it, decode it, hand it out."""
        source = system << 8 | component
        expected = self._expected
        if expected.get(source, sequence) != sequence:
            self._account(source, sequence)
        else:
            expected[source] = (sequence + 1) & 0xFF
        row = BY_ID.get(number)
        if row is None:
            self.stats.unknown_id += 1
            return
        self._hand_out(row, data, at, size, system, component, sequence, now_us)

    def _hand_out(
        self, row: Row, data: bytes, at: int, size: int, system: int, component: int, sequence: int, now_us: int
    ) -> None:
        """Decode a known message and queue it."""
        if size < row.size:  # MAVLink 2 cuts trailing zeros
            data, at = data[at : at + size].ljust(row.size, b"\0"), 0
        message = row.decode(data, at)
        if message is None:
            self.stats.not_finite += 1
            return
        self.stats.received += 1
        self._events.append(_new_received(Received, (system, component, sequence, now_us, message)))

    def _account(self, source: int, sequence: int) -> None:
        """A sequence number that isn't the expected one: after a gap, repeated, or late."""
        ahead = (sequence - self._expected[source]) & 0xFF
        late = ahead > 0xFF - _REORDER_WINDOW
        if not late:
            self._expected[source] = (sequence + 1) & 0xFF
        if self._peer not in (0, source >> 8):
            return
        if ahead == 0xFF:
            self.stats.duplicate += 1
        elif late:
            self.stats.reordered += 1
            self.stats.lost = max(0, self.stats.lost - 1)
        else:
            self.stats.lost += ahead


def _packed(frames: list[bytes], max_bytes: int) -> list[bytes]:
    """The frames in order, joined as long as they fit."""
    if sum(map(len, frames)) <= max_bytes:
        return [b"".join(frames)]
    datagrams, size = [frames[:1]], len(frames[0])
    for frame in frames[1:]:
        size += len(frame)
        if size > max_bytes:
            datagrams.append([])
            size = len(frame)
        datagrams[-1].append(frame)
    return [b"".join(datagram) for datagram in datagrams]


_new_received = tuple.__new__
_header, _crc = HEADER.unpack_from, CRC.unpack_from
