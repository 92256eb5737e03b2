"""UDP on 127.0.0.1: ports that aren't shared, the latch, lockstep's counted receive; addresses and the clock."""

from __future__ import annotations

import importlib
import socket
import threading
from collections.abc import Iterator
from types import ModuleType

import pytest
from pymavlink.dialects.v20 import common

from flightstack.types import InputError
from mavlink_bridge.framing import DatagramFraming, StreamFraming
from mavlink_bridge.transport import udp
from mavlink_bridge.transport.address import Serial, UdpIn, UdpOut, framing_for, open_address, parse_address
from mavlink_bridge.transport.clock import monotonic_us, sleep_until_us
from mavlink_bridge.transport.serial import SerialPort
from mavlink_bridge.transport.udp import UdpSocket

HOST = "127.0.0.1"
WAIT_S = 5.0


@pytest.fixture
def near() -> Iterator[UdpSocket]:
    with UdpSocket.bind(HOST, 0) as sock:
        yield sock


def _peer_of(sock: UdpSocket) -> UdpSocket:
    return UdpSocket.bind(HOST, 0, peer=sock.address, latch=False)


def test_a_port_in_use_is_an_error_of_one_line_that_names_it(near: UdpSocket) -> None:
    with pytest.raises(InputError) as caught:
        UdpSocket.bind(HOST, near.port)
    text = str(caught.value)
    assert text == f"port {near.port} of {HOST} is in use by another program: stop it or choose another port"


def test_a_port_is_not_shared_even_with_a_socket_that_offers_to() -> None:
    """pymavlink's udpin sets SO_REUSEADDR: two such sockets would share a port silently."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        other.bind((HOST, 0))
        with pytest.raises(InputError, match="in use"):
            UdpSocket.bind(HOST, other.getsockname()[1])


def test_our_own_port_can_not_be_taken_by_a_socket_that_offers_to_share(near: UdpSocket) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            other.bind((HOST, near.port))


@pytest.mark.parametrize(
    ("host", "port", "said"),
    [
        (HOST, 70_000, "out of range"),
        ("192.0.2.1", 0, "not one of this machine"),
        ("no host has this name", 0, "not known"),
    ],
)
def test_an_address_that_can_not_be_bound_is_an_error_of_one_line(host: str, port: int, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        UdpSocket.bind(host, port)
    assert "\n" not in str(caught.value)


def test_what_is_sent_arrives_whole_and_in_order(near: UdpSocket) -> None:
    with _peer_of(near) as far:
        datagrams = [bytes([i]) * (i + 1) for i in range(200)]
        assert all(far.send(data) for data in datagrams)
        assert near.receive_exactly(200, WAIT_S) == datagrams
        assert near.receive() is None
        assert near.receive_all() == []


def test_the_first_sender_becomes_the_peer_for_life(near: UdpSocket) -> None:
    with _peer_of(near) as first, _peer_of(near) as second:
        assert not near.send(b"to nobody yet")
        assert near.send_errors == 1
        first.send(b"1")
        assert near.receive_exactly(1, WAIT_S) == [b"1"]
        assert near.peer == first.address
        second.send(b"2")
        assert near.receive_exactly(1, WAIT_S) == [b"2"]  # still heard, as PX4 does
        assert (near.peer, near.foreign) == (first.address, 1)
        near.send(b"answer")
        assert first.receive_exactly(1, WAIT_S) == [b"answer"]
        assert second.receive() is None


def test_a_peer_given_beforehand_is_sent_to_until_someone_else_speaks_first() -> None:
    with UdpSocket.bind(HOST, 0) as expected, UdpSocket.bind(HOST, 0, peer=expected.address) as near:
        near.send(b"stream")
        assert expected.receive_exactly(1, WAIT_S) == [b"stream"]
        with _peer_of(near) as other:
            other.send(b"first")
            assert near.receive_exactly(1, WAIT_S) == [b"first"]
            assert near.peer == other.address


def test_a_flood_does_not_hold_the_reader_whoever_sends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp, "_MOST", 12)
    with UdpSocket.bind(HOST, 0, drop_foreign=True) as near, _peer_of(near) as first, _peer_of(near) as second:
        first.send(b"peer")
        assert near.wait(WAIT_S)
        assert near.receive_all() == [b"peer"]
        for _ in range(20):
            second.send(b"foreign")
        for number in range(20):
            first.send(b"%d" % number)
        assert near.wait(WAIT_S)
        assert near.receive_all(8) == []
        assert near.foreign == 12, "strangers' datagrams take time as well"
        assert near.receive_all(12) == [b"%d" % number for number in range(4)]
        assert near.receive_all(8) == [b"%d" % number for number in range(4, 12)]
        assert near.receive_all(100) == [b"%d" % number for number in range(12, 20)]


def test_foreign_datagrams_are_dropped_and_counted_where_asked() -> None:
    with UdpSocket.bind(HOST, 0, drop_foreign=True) as near, _peer_of(near) as first, _peer_of(near) as second:
        first.send(b"1")
        assert near.receive_exactly(1, WAIT_S) == [b"1"]
        for sender, data in ((second, b"2"), (first, b"3"), (second, b"4"), (first, b"5")):
            sender.send(data)
        assert near.receive_exactly(2, WAIT_S) == [b"3", b"5"]
        assert near.foreign == 2
        assert near.peer == first.address


def test_without_the_latch_the_peer_stays_as_given() -> None:
    with (
        UdpSocket.bind(HOST, 0) as given,
        UdpSocket.bind(HOST, 0, peer=given.address, latch=False, drop_foreign=True) as near,
        _peer_of(near) as other,
    ):
        other.send(b"foreign")
        given.peer = near.address
        given.send(b"mine")
        assert near.receive_exactly(1, WAIT_S) == [b"mine"]
        assert near.peer == given.address


def test_receive_exactly_leaves_the_rest_and_gives_up_after_its_time(near: UdpSocket) -> None:
    with _peer_of(near) as far:
        for data in (b"1", b"2", b"3"):
            far.send(data)
        assert near.receive_exactly(2, WAIT_S) == [b"1", b"2"]
        began = monotonic_us()
        assert near.receive_exactly(2, 0.05) == [b"3"]
        assert 50_000 <= monotonic_us() - began < 2_000_000


def test_receive_exactly_waits_for_a_late_sender(near: UdpSocket) -> None:
    with _peer_of(near) as far:
        timer = threading.Timer(0.02, lambda: far.send(b"late"))
        timer.start()
        assert near.receive_exactly(1, WAIT_S) == [b"late"]
        timer.join()


def test_a_peer_that_is_gone_is_counted_and_nothing_raises(near: UdpSocket) -> None:
    """A connected socket hears of the refusal, another one doesn't; both go on."""
    with UdpSocket.bind(HOST, 0) as gone:
        address = gone.address
    with UdpSocket.bind(HOST, 0, peer=address) as connected:
        connected.connect()
        near.peer = address
        for _ in range(5):
            for sock in (connected, near):
                sock.send(b"anyone?")
                assert sock.receive() is None
        assert connected.refused >= 1
        assert near.refused == 0


def test_a_connected_socket_hears_its_peer_only(near: UdpSocket) -> None:
    with pytest.raises(ValueError, match="needs a peer"):
        near.connect()
    with _peer_of(near) as first, _peer_of(near) as second:
        first.send(b"1")
        near.receive_exactly(1, WAIT_S)
        near.connect()
        second.send(b"2")
        first.send(b"3")
        assert near.receive_exactly(1, WAIT_S) == [b"3"]
        assert near.receive() is None
        near.send(b"4")
        assert first.receive_exactly(1, WAIT_S) == [b"4"]


def test_a_datagram_that_can_not_be_sent_is_counted_and_nothing_raises(near: UdpSocket) -> None:
    with _peer_of(near) as far:
        assert not far.send(bytes(70_000))
        assert far.send_errors == 1
        assert far.send(b"next")


def test_a_burst_of_a_hundred_messages_fits_the_receive_buffer(near: UdpSocket) -> None:
    with _peer_of(near) as far:
        for _ in range(100):
            far.send(bytes(280))
        assert len(near.receive_exactly(100, WAIT_S)) == 100


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("udpin:127.0.0.1:14540", UdpIn("127.0.0.1", 14540)),
        ("udpin://0.0.0.0:14540", UdpIn("0.0.0.0", 14540)),
        ("udpout:192.168.1.7:14580", UdpOut("192.168.1.7", 14580)),
        ("udpout://localhost:14580", UdpOut("localhost", 14580)),
        ("serial:/dev/ttyUSB0:921600", Serial("/dev/ttyUSB0", 921600)),
        ("serial:COM7:57600", Serial("COM7", 57600)),
    ],
)
def test_an_address_is_read_as_written(text: str, address: UdpIn | UdpOut | Serial) -> None:
    assert parse_address(text) == address
    assert isinstance(framing_for(address), StreamFraming if isinstance(address, Serial) else DatagramFraming)


NOT_ADDRESSES = """
udpin|udpin:|udpin:14540|udpin::14540|udpin:127.0.0.1:|udpin:127.0.0.1:0|udpin:127.0.0.1:65536|udpin:127.0.0.1:-1
udpin:127.0.0.1:x|udpin:127.0.0.1:１４|tcp:127.0.0.1:5760|127.0.0.1:14540|serial:/dev/ttyUSB0
serial:/dev/ttyUSB0:fast|serial:/dev/ttyUSB0:0|serial::57600
"""


@pytest.mark.parametrize("text", ["", *NOT_ADDRESSES.strip().replace("\n", "|").split("|")])
def test_what_is_no_address_is_an_error_of_one_line_that_shows_it(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_address(text)
    assert repr(text) in str(caught.value)
    assert "write" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_udpin_answers_whoever_speaks_first_and_udpout_speaks_first() -> None:
    with UdpSocket.bind(HOST, 0) as probe:
        port = probe.port
    listener = open_address(f"udpin:{HOST}:{port}")
    caller = open_address(UdpOut(HOST, port))
    hello = _heartbeat(1)
    try:
        assert caller.send(hello)
        assert listener.wait(WAIT_S)
        assert listener.receive() == hello
        assert listener.send(b"welcome")
        assert caller.wait(WAIT_S)
        assert caller.receive_all() == [b"welcome"]
        assert not caller.wait(0.0)
        with pytest.raises(InputError, match="in use"):
            open_address(f"udpin:{HOST}:{port}")
    finally:
        listener.close()
        caller.close()


def test_a_latched_sender_that_has_gone_makes_room_for_another() -> None:
    """Its own next word holds the place as well; without a latch there is nothing to make room for."""
    with UdpSocket.bind(HOST, 0, drop_foreign=True) as near, _peer_of(near) as first, _peer_of(near) as second:
        for sender, expected in ((first, [b"hello"]), (second, [])):
            sender.send(b"hello")
            near.wait(WAIT_S)
            assert near.receive_all() == expected
        near.unlatch()
        assert near.peer == first.address
        second.send(b"again")
        near.wait(WAIT_S)
        assert near.receive_all() == [b"again"]
        assert (near.peer, near.latched) == (second.address, True)
        first.send(b"late")
        near.wait(WAIT_S)
        assert near.receive_all() == []
    with UdpSocket.bind(HOST, 0, peer=(HOST, 1), latch=False) as fixed:
        fixed.unlatch()
        assert (fixed.peer, fixed.latched) == ((HOST, 1), False)


@pytest.mark.parametrize("first_word", [b"noise", b"\xfd" * 30, b"", "ground station"])
def test_udpin_is_not_made_deaf_by_whoever_is_no_autopilot(first_word: bytes | str) -> None:
    with UdpSocket.bind(HOST, 0) as probe:
        port = probe.port
    with UdpSocket.bind(HOST, 0, peer=(HOST, port)) as other, UdpSocket.bind(HOST, 0, peer=(HOST, port)) as vehicle:
        listener = open_address(f"udpin:{HOST}:{port}")
        try:
            other.send(first_word if isinstance(first_word, bytes) else _heartbeat(190))
            vehicle.send(_heartbeat(1))
            assert listener.wait(WAIT_S)
            assert listener.receive_all() == [_heartbeat(1)]
            assert isinstance(listener, UdpSocket)
            assert (listener.peer, listener.foreign) == (vehicle.address, 1)
        finally:
            listener.close()


def _heartbeat(component: int) -> bytes:
    """By pymavlink's own codec."""
    mav = common.MAVLink(None, srcSystem=1, srcComponent=component)
    data: bytes = mav.heartbeat_encode(2, 12, 0x1D, 0x03040000, 3).pack(mav)
    return data


def test_udpout_to_this_machine_is_bound_to_loopback_only() -> None:
    for host, bound in ((HOST, HOST), ("localhost", HOST), ("192.0.2.1", "0.0.0.0")):
        transport = open_address(UdpOut(host, 14580))
        assert isinstance(transport, UdpSocket)
        assert transport.address[0] == bound
        transport.close()


def test_a_serial_line_without_pyserial_is_an_error_that_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> ModuleType:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InputError, match="pip install pyserial"):
        open_address("serial:/dev/ttyUSB0:57600")


class _Line:
    """What pyserial's Serial offers, with a line that can fail."""

    def __init__(self) -> None:
        self.arrived = [b"ab", b"c", b""]
        self.written: list[bytes] = []
        self.broken = False
        self.in_waiting = 2

    def read(self, size: int) -> bytes:
        if self.broken:
            raise OSError("unplugged")
        return self.arrived.pop(0) if self.arrived else b""

    def write(self, data: bytes) -> int:
        if self.broken:
            raise OSError("unplugged")
        self.written.append(data)
        return min(len(data), 4)

    def close(self) -> None:
        self.broken = True


def test_a_serial_line_gives_what_came_and_counts_what_failed() -> None:
    line = _Line()
    port = SerialPort(line)
    assert port.wait(0.1)
    assert port.receive_all() == [b"ab", b"c"]
    assert port.send(b"1234")
    assert not port.send(b"12345")
    port.close()
    assert port.receive() is None
    assert not port.send(b"1")
    assert (port.send_errors, port.receive_errors) == (2, 1)


def test_sleeping_until_a_deadline_never_ends_before_it() -> None:
    for ahead_us in (-100, 0, 50, 400, 2_000):
        deadline = monotonic_us() + ahead_us
        sleep_until_us(deadline)
        assert monotonic_us() >= deadline
