"""A serial line with a real port: one end of a pseudo-terminal pair opened as users do, a vehicle at the other."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator

import pytest
from pymavlink.generator.mavcrc import x25crc

from mavlink_bridge import messages as m
from mavlink_bridge.framing import StreamFraming
from mavlink_bridge.link import Link
from mavlink_bridge.transport.address import Serial, Transport, framing_for, open_address, parse_address

pytest.importorskip("serial")
WAIT_S = 5.0


@pytest.fixture
def line() -> Iterator[tuple[int, Transport]]:
    """The near end's file number and the far end, open as a transport."""
    near, far = os.openpty()
    port = open_address(f"serial:{os.ttyname(far)}:921600")
    os.close(far)
    yield near, port
    port.close()
    os.close(near)


def _read(near: int, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += os.read(near, 4096)
    return data


def test_every_message_comes_whole_through_a_serial_line_in_both_directions(line: tuple[int, Transport]) -> None:
    """Also bytes that a terminal would eat or change: XON, XOFF, line ends, Ctrl-C, Ctrl-D; noise costs nothing."""
    near, port = line
    address = parse_address("serial:/dev/x:921600")
    assert isinstance(address, Serial)
    ours, theirs = Link(240, 191, framing=framing_for(address)), Link(1, 1, framing=StreamFraming())
    rng, taken = random.Random(5), 0
    hostile = bytes([0x11, 0x13, 0x0A, 0x0D, 0x03, 0x04, 0x1A, 0x7F, 0x00, 0xFF])
    for turn in range(200):
        pings = [m.Ping(rng.getrandbits(63), turn, 0, 0) for _ in range(3)]
        for ping in pings:
            theirs.send(ping)
        stream = b"".join(theirs.datagrams_to_send()) + hostile * (turn % 2)
        for at in range(0, len(stream), 29):
            os.write(near, stream[at : at + 29])
        have = 0
        while have < len(stream):
            assert port.wait(WAIT_S)
            for data in port.receive_all():
                have += len(data)
                ours.receive_datagram(data, 0)
        heard = []
        while (received := ours.next_event()) is not None:
            heard.append(received.message)
        assert heard == pings
        taken += len(heard)
        ours.send(pings[0])
        (answer,) = ours.datagrams_to_send()
        assert port.send(answer)
        theirs.receive_datagram(_read(near, len(answer)), 0)
        back = theirs.next_event()
        assert back is not None
        assert back.message == pings[0]
    assert taken == 600
    assert ours.stats.lost == 0


def test_what_goes_out_is_framed_as_mavlink_says(line: tuple[int, Transport]) -> None:
    """The CRC by pymavlink's own function over the bytes that a receiver would see on the wire."""
    near, port = line
    link = Link(240, 191)
    link.send(m.Heartbeat(18, 8, 0, 0, 4))
    (frame,) = link.datagrams_to_send()
    assert port.send(frame)
    data = _read(near, len(frame))
    assert data[0] == 0xFD
    crc = x25crc(bytearray(data[1:-2]))
    crc.accumulate(bytearray([50]))
    assert crc.crc == int.from_bytes(data[-2:], "little")


def test_an_unplugged_line_is_silence_and_counted(line: tuple[int, Transport]) -> None:
    """The near end closes: reads fail or end, writes fail; nothing raises."""
    _, port = line
    near2, far2 = os.openpty()
    other = open_address(f"serial:{os.ttyname(far2)}:57600")
    os.close(far2)
    os.close(near2)
    for _ in range(3):
        assert other.receive() is None
        assert not other.wait(0.0)
        other.send(b"lost")
    other.close()
    assert port.receive() is None
