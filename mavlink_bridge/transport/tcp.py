"""A TCP port for one client at a time: PX4 comes to its simulator's port and stays.  Never blocking for long.

`receive` gives any piece of the stream (use `StreamFraming`).  A client that goes away shows as `connected` False;
a second one waits in the queue until the first is gone.  Errors of the network are never raised in flight.
"""

from __future__ import annotations

import errno
import select
import socket
from typing import Final, final

from flightstack.types import InputError

_CHUNK: Final = 65_536
_SEND_LIMIT_S: Final = 2.0
"""A client that takes nothing for so long is gone."""


@final
class TcpServer:
    """See the module's text; make one with `bind`."""

    def __init__(self, sock: socket.socket) -> None:
        self._listener = sock
        self._client: socket.socket | None = None
        self.address: Final[tuple[str, int]] = sock.getsockname()[:2]
        """Host and port this socket is bound to."""
        self.peer: tuple[str, int] | None = None

    @classmethod
    def bind(cls, host: str, port: int) -> TcpServer:
        """Listen on `host` and `port` (0: any free one); InputError where that can't be."""
        sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # TCP: skips the wait after a close, no more
            sock.bind((host, port))
            sock.listen(1)
        except (OSError, OverflowError) as error:
            sock.close()
            if getattr(error, "errno", None) == errno.EADDRINUSE:
                raise InputError(
                    f"TCP port {port} of {host} is in use by another program (another simulator?): stop it"
                    " or choose another port"
                ) from error
            raise InputError(f"TCP port {port} of {host} can't be bound ({error}): choose another") from error
        return cls(sock)

    @property
    def connected(self) -> bool:
        """Whether a client is there."""
        return self._client is not None

    def accept(self, timeout_s: float) -> bool:
        """Wait for a client, at most `timeout_s`; whether there is one now."""
        if self._client is None and select.select([self._listener], [], [], timeout_s)[0]:
            try:
                self._client, self.peer = self._listener.accept()
            except OSError:
                return False
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client.settimeout(_SEND_LIMIT_S)
        return self._client is not None

    def receive(self, timeout_s: float = 0.0) -> bytes | None:
        """What has arrived, waiting for it at most `timeout_s`; None where nothing has or nobody is there."""
        client = self._client
        if client is None:
            return None
        try:
            if not select.select([client], [], [], timeout_s)[0]:
                return None
            data = client.recv(_CHUNK)
        except OSError:
            data = b""
        if not data:
            self.drop()
            return None
        return data

    def send(self, data: bytes) -> bool:
        """Send it all; False where the client is gone, or has taken nothing for long."""
        if self._client is None:
            return False
        try:
            self._client.sendall(data)
        except OSError:
            self.drop()
            return False
        return True

    def drop(self) -> None:
        """Let the client go."""
        if self._client is not None:
            self._client.close()
        self._client = self.peer = None

    def close(self) -> None:
        """Give the port back."""
        self.drop()
        self._listener.close()
