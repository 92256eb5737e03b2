"""Which port speaks with which: a router that is started anew, a second vehicle, PX4's own ports."""

from __future__ import annotations

from contextlib import closing

from pymavlink.dialects.v20 import common

from mavlink_bridge.transport import udp
from mavlink_bridge.transport.address import UdpOut, open_address
from mavlink_bridge.transport.udp import UdpSocket

HOST = "127.0.0.1"
WAIT_S = 5.0


def _peer_of(sock: UdpSocket) -> UdpSocket:
    return UdpSocket.bind(HOST, 0, peer=sock.address, latch=False)


def _heartbeat(system: int) -> bytes:
    """An autopilot's, by pymavlink's own codec."""
    mav = common.MAVLink(None, srcSystem=system, srcComponent=1)
    data: bytes = mav.heartbeat_encode(2, 12, 0x1D, 0x03040000, 3).pack(mav)
    return data


def test_a_router_on_this_machine_that_was_started_anew_is_followed_to_its_new_port() -> None:
    """Only once the port before has been silent for a tenth of a second of ticks, and only to the same vehicle."""
    with UdpSocket.bind(HOST, 0) as probe:
        port = probe.port
    near = open_address(f"udpin:{HOST}:{port}")
    assert isinstance(near, UdpSocket)
    with near, _peer_of(near) as first, _peer_of(near) as second:
        first.send(_heartbeat(1))
        assert near.receive_all() == [_heartbeat(1)]
        for _ in range(udp.SILENT_READS - 2):
            assert near.receive_all() == []
        second.send(_heartbeat(1))
        assert near.receive_all() == [], "not yet"
        first.send(_heartbeat(1))
        assert near.receive_all() == [_heartbeat(1)], "the port before speaks again: it keeps its place"
        for _ in range(udp.SILENT_READS):
            assert near.receive_all() == []
        second.send(b"noise")
        assert near.receive_all() == []
        assert near.other == 0
        second.send(_heartbeat(9))
        assert near.receive_all() == [], "another vehicle"
        assert near.other == 9, "and the flight is told of it"
        second.send(_heartbeat(1))
        assert near.receive_all() == [_heartbeat(1)]
        assert near.send(b"word")
        assert second.wait(WAIT_S)
        assert second.receive() == b"word"
        first.send(_heartbeat(1))
        assert near.receive_all() == [], "the new port has the place"


def test_udpout_speaks_from_the_port_that_px4_answers_run_after_run() -> None:
    """PX4's links answer one port for life: that to which they send until somebody speaks, 40 below their own."""
    with UdpSocket.bind(HOST, 0) as probe:
        port = probe.port
    for _ in range(2):
        with closing(open_address(UdpOut(HOST, port + 40))) as caller:
            assert isinstance(caller, UdpSocket)
            assert caller.port == port
    with UdpSocket.bind(HOST, port), closing(open_address(UdpOut(HOST, port + 40))) as other:
        assert isinstance(other, UdpSocket)
        assert other.port != port, "another program has it: any free one"
