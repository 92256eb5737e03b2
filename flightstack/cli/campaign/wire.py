"""Messages between the campaign and its workers: one JSON object a line over a socket."""

from __future__ import annotations

import json
import select
import socket
from typing import Any

Message = dict[str, Any]


class Lines:
    """One end; a peer that is gone raises EOFError."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._rest = b""

    def fileno(self) -> int:
        """For select."""
        return self._end.fileno()

    def send(self, message: Message) -> None:
        """One message."""
        try:
            self._end.sendall(json.dumps(message).encode() + b"\n")
        except OSError:
            raise EOFError("the other end is gone") from None

    @property
    def pending(self) -> bool:
        """Whether a whole message has been read already."""
        return b"\n" in self._rest

    def ready(self, timeout_s: float) -> bool:
        """Whether something, or the end, can be read."""
        return self.pending or bool(select.select([self._end], [], [], timeout_s)[0])

    def receive(self) -> Message:
        """The next message, waited for."""
        while b"\n" not in self._rest:
            try:
                data = self._end.recv(1 << 20)
            except OSError:
                data = b""
            if not data:
                raise EOFError("the other end is gone")
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        message: Message = json.loads(line)
        return message

    def close(self) -> None:
        """Close this end."""
        self._end.close()
