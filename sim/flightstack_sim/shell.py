"""Sockets round the simulated autopilot: one per MAVLink link, with PX4's ports and its peer latch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from flightstack_sim.link_faults import BadLink
from flightstack_sim.server import Server
from mavlink_bridge.transport.udp import UdpSocket

ONBOARD, GCS = 0, 1


class Seam:
    """Between a server and the network: where link faults happen, each direction of each link on its own."""

    __slots__ = ("_faults", "_in", "_out", "_server")

    def __init__(self, server: Server, links: int, seed: int) -> None:
        self._server, self._faults = server, server.faults
        self._out = [BadLink(seed, 2 * index) for index in range(links)]
        self._in = [BadLink(seed, 2 * index + 1) for index in range(links)]

    @property
    def bad(self) -> bool:
        """Whether any fault concerns the link: then every message has a datagram of its own, as on PX4."""
        return self._faults.on_the_link

    def out(self, index: int, datagrams: list[bytes]) -> list[bytes]:
        """What leaves now of what the server has sent till now."""
        return self._carry(self._out[index], datagrams)

    def into(self, index: int, datagrams: list[bytes]) -> list[bytes]:
        """What the server gets now of what was sent to it."""
        return self._carry(self._in[index], datagrams)

    def _carry(self, link: BadLink, datagrams: list[bytes]) -> list[bytes]:
        if not self.bad:
            return datagrams
        now_us = self._server.t_us
        return link.carry(datagrams, self._faults.link_quality(now_us), now_us)


@dataclass(slots=True)
class Shell:
    """A server and its sockets, in the server's order of links (None: that link goes nowhere)."""

    server: Server
    sockets: tuple[UdpSocket | None, ...]
    seed: int = 0
    """Of the link faults."""
    on_datagram: Callable[[str, int, bytes], None] | None = None
    """Hears of every datagram: direction as the client sees it (rx, tx), link, data."""
    seam: Seam = field(init=False)

    def __post_init__(self) -> None:
        self.seam = Seam(self.server, len(self.sockets), self.seed)

    def advance(self, milliseconds: int) -> list[int]:
        """Simulate, then send what is due: how many datagrams went out on each link."""
        self.server.advance(milliseconds)
        sent = []
        for index, socket in enumerate(self.sockets):
            datagrams = self.seam.out(index, self.server.datagrams(index))
            if socket is not None:
                for data in datagrams:
                    socket.send(data)
            if self.on_datagram is not None:
                for data in datagrams:
                    self.on_datagram("rx", index, data)
            sent.append(len(datagrams))
        return sent

    def receive(self) -> None:
        """Hand over everything that has arrived."""
        for index, socket in enumerate(self.sockets):
            if socket is not None:
                for data in self.seam.into(index, socket.receive_all()):
                    if self.on_datagram is not None:
                        self.on_datagram("tx", index, data)
                    self.server.receive(index, data)

    def close(self) -> None:
        """Close all sockets."""
        for socket in self.sockets:
            if socket is not None:
                socket.close()
