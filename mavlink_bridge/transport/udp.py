"""A UDP socket for one MAVLink link: bound alone to its port, never blocking, never raising in flight.

The port is never shared: SO_REUSEADDR would let a second program take half of the packets without an error.
With `latch` the first sender whose word counts (`greets`) becomes the peer for life, as on PX4's links.  Lost peers
show as ECONNREFUSED on some systems; that and every other error of the network is counted, never raised: a link that
is gone may come back.
"""

from __future__ import annotations

import errno
import select
import socket
import time
from collections.abc import Callable
from types import TracebackType
from typing import Final, final

from flightstack.types import InputError

Address = tuple[str, int]

_RECEIVE_BUFFER_BYTES: Final = 4 << 20
_LARGEST: Final = 4096  # MAVLink datagrams stay below an Ethernet frame; a larger buffer costs time at every call
LOOPBACK: Final = "127.0.0.1"
_MOST: Final = 1000
"""Datagrams, strangers' too, that one call looks at: two ticks' backlog after a stall of a second is taken, and a flood
does not hold the loop."""
SILENT_READS: Final = 25
"""So many reads one after the other, one a tick, brought nothing of the peer: 0.1 s in which its vehicle sends 50."""


@final
class UdpSocket:
    """See the module's text; make one with `bind`."""

    def __init__(
        self, sock: socket.socket, peer: Address | None, greets: Callable[[bytes], int] | None, *, drop_foreign: bool,
        follow: bool = False,
    ) -> None:  # fmt: skip
        self._socket = sock
        self._greets = greets
        self._greeting = 0
        self._drop_foreign = drop_foreign
        self._follow = follow
        self._silent = 0
        self._connected = False
        self._poll = select.poll()
        self._poll.register(sock, select.POLLIN)
        self.address: Final[Address] = sock.getsockname()[:2]
        """Host and port this socket is bound to."""
        self.peer = peer
        """Where `send` sends; None: nowhere yet."""
        self.latched = False
        """Whether the first packet has fixed the peer."""
        self.foreign = 0
        """Datagrams from others than the latched peer."""
        self.refused = 0
        """Times the system said that nobody listens at the peer's port."""
        self.other = 0
        """Of a link that follows: what another sender greeted with, the latched one aside; 0: nobody did."""
        self.send_errors = 0
        """Datagrams not sent: no peer yet, no route, no room."""

    @classmethod
    def bind(
        cls,
        host: str,
        port: int,
        *,
        peer: Address | None = None,
        latch: bool = True,
        greets: Callable[[bytes], int] = lambda data: True,
        drop_foreign: bool = False,
        follow: bool = False,
    ) -> UdpSocket:
        """Bind to `host` and `port` (0: any free one); InputError where that can't be.

        peer: where to send before anyone was heard.  latch: the first sender of a datagram that `greets` likes becomes
        the peer for good; else the peer stays as given.  drop_foreign: ignore (and count) datagrams from others than
        the latched or given peer; else they come in too.  follow: where a latched peer on this machine has been silent
        for `SILENT_READS`, another port that greets with the same number takes its place (a router started anew).
        """
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
            sock.bind((host, port))
            if peer is not None:
                peer = (socket.gethostbyname(peer[0]), peer[1])
        except (OSError, OverflowError) as error:
            sock.close()
            raise InputError(_why(error, host, port, peer)) from error
        return cls(sock, peer, greets if latch else None, drop_foreign=drop_foreign, follow=follow)

    @property
    def port(self) -> int:
        """The port this socket is bound to."""
        return self.address[1]

    def fileno(self) -> int:
        """The file descriptor."""
        return self._socket.fileno()

    def receive(self) -> bytes | None:
        """The next datagram that has arrived, None where there is none."""
        if not self._connected:
            received = self.receive_from()
            return received[0] if received else None
        while True:
            try:
                return self._socket.recv(_LARGEST)
            except BlockingIOError:
                return None
            except OSError as error:
                if not self._count(error):
                    return None

    def receive_from(self) -> tuple[bytes, Address] | None:
        """The same with its sender's address."""
        for _ in range(_MOST):
            try:
                data, sender = self._socket.recvfrom(_LARGEST)
            except BlockingIOError:
                self._silent += 1
                return None
            except OSError as error:  # one pending error of an earlier send; the next call reads on
                if not self._count(error):
                    return None
                continue
            if sender != self.peer or not self.latched:
                if not self._admit(data, sender):
                    continue
            self._silent = 0
            return data, sender
        return None

    def receive_all(self, most: int = _MOST) -> list[bytes]:
        """What has arrived, in order; of a flood, a stranger's too, the first `most`, the rest in calls to come."""
        datagrams: list[bytes] = []
        dropped = self.foreign
        while len(datagrams) + self.foreign - dropped < most and (data := self.receive()) is not None:
            datagrams.append(data)
        return datagrams

    def receive_exactly(self, count: int, timeout_s: float) -> list[bytes]:
        """The next `count` datagrams, waiting for them; fewer only where the time ran out.  For lockstep."""
        datagrams: list[bytes] = []
        deadline = -1.0
        receive = self.receive
        for _ in range(count):
            while (data := receive()) is None:
                now = time.monotonic()
                if deadline < 0.0:
                    deadline = now + timeout_s
                if now >= deadline:
                    return datagrams
                self.wait(deadline - now)
            datagrams.append(data)
        return datagrams

    def wait(self, timeout_s: float) -> bool:
        """Wait until something can be received, at most `timeout_s` (rounded up to 1 ms); whether it can."""
        return bool(self._poll.poll(max(0.0, timeout_s) * 1e3))

    def send(self, data: bytes) -> bool:
        """Send one datagram to the peer; False (and counted) where it couldn't go."""
        if self.peer is None:
            self.send_errors += 1
            return False
        try:
            if self._connected:
                self._socket.send(data)
            else:
                self._socket.sendto(data, self.peer)
        except OSError as error:
            if not self._count(error):
                self.send_errors += 1
            return False
        return True

    def connect(self) -> None:
        """Speak with `peer` alone for life: the system drops everyone else's datagrams, uncounted.

        Saves about half the cost of a datagram, and reports a peer that is gone.  For lockstep on loopback.
        """
        if self.peer is None:
            raise ValueError("connect needs a peer: give one to bind, or wait for the first sender")
        self._socket.connect(self.peer)
        self._connected = self.latched = True

    def unlatch(self) -> None:
        """Where the first sender was latched: the next one whose datagram is liked takes its place.

        Until then `send` goes where it went.
        """
        self.latched = self.latched and self._greets is None

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()

    def __enter__(self) -> UdpSocket:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _admit(self, data: bytes, sender: Address) -> bool:
        """Latch a first sender; whether a datagram of this sender may come in."""
        if self._greets is not None and not self.latched and (greeting := self._greets(data)):
            self.peer, self.latched, self._greeting = sender, True, greeting
            return True
        if sender == self.peer:
            return True
        if self._follow and self._silent >= SILENT_READS and self._is_next(data, sender):
            self.peer = sender
            return True
        if self._follow and not self.other and self._greets is not None:
            greeting = self._greets(data)
            self.other = 0 if greeting == self._greeting else greeting
        self.foreign += 1
        return not self._drop_foreign

    def _is_next(self, data: bytes, sender: Address) -> bool:
        """Whether this is whom the latched peer was, by another port of this machine."""
        same = self.peer is not None and sender[0] == self.peer[0] == LOOPBACK
        return same and self._greets is not None and self._greets(data) == self._greeting

    def _count(self, error: OSError) -> bool:
        """Count a refusal; whether it was one."""
        if error.errno == errno.ECONNREFUSED:
            self.refused += 1
            return True
        return False


def connected_pair() -> tuple[UdpSocket, UdpSocket]:
    """Two sockets on free ports of loopback that speak with each other alone: both ends of a link in lockstep."""
    one = UdpSocket.bind(LOOPBACK, 0)
    other = UdpSocket.bind(LOOPBACK, 0, peer=one.address)
    one.peer = other.address
    one.connect()
    other.connect()
    return one, other


def _why(error: Exception, host: str, port: int, peer: Address | None) -> str:
    """One line for a user: why the socket couldn't be bound, and what to do."""
    if isinstance(error, socket.gaierror):
        name = host if peer is None else f"{host} or {peer[0]}"
        return f"host {name} is not known: give an IPv4 address such as 127.0.0.1"
    if isinstance(error, OverflowError):
        return f"port {port} is out of range: choose one in 1..65535 (0: any free one)"
    number = getattr(error, "errno", None)
    if number == errno.EADDRINUSE:
        return f"port {port} of {host} is in use by another program: stop it or choose another port"
    if number == errno.EACCES:
        return f"port {port} of {host} may not be used without privileges: choose one above 1023"
    if number == errno.EADDRNOTAVAIL:
        return f"address {host} is not one of this machine: choose 127.0.0.1, or 0.0.0.0 for all of its addresses"
    return f"port {port} of {host} can't be bound ({error}): choose another"
