"""Sockets round the simulated autopilot: one per MAVLink link, with PX4's ports and its peer latch."""

from __future__ import annotations

from dataclasses import dataclass

from mavlink_bridge.transport.udp import UdpSocket
from sim.server import Server

ONBOARD, GCS = 0, 1


@dataclass(slots=True)
class Shell:
    """A server and its sockets, in the server's order of links (None: that link goes nowhere)."""

    server: Server
    sockets: tuple[UdpSocket | None, ...]

    def advance(self, milliseconds: int) -> list[int]:
        """Simulate, then send what is due: how many datagrams went out on each link."""
        self.server.advance(milliseconds)
        sent = []
        for index, socket in enumerate(self.sockets):
            datagrams = self.server.datagrams(index)
            if socket is not None:
                for data in datagrams:
                    socket.send(data)
            sent.append(len(datagrams))
        return sent

    def receive(self) -> None:
        """Hand over everything that has arrived."""
        for index, socket in enumerate(self.sockets):
            if socket is not None:
                for data in socket.receive_all():
                    self.server.receive(index, data)

    def receive_exactly(self, index: int, count: int, timeout_s: float) -> None:
        """Hand over `count` datagrams of one link; in lockstep both ends know how many are on the way."""
        socket = self.sockets[index]
        if socket is not None:
            for data in socket.receive_exactly(count, timeout_s):
                self.server.receive(index, data)

    def close(self) -> None:
        """Close all sockets."""
        for socket in self.sockets:
            if socket is not None:
                socket.close()
