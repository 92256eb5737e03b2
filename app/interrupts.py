"""Ctrl-C and SIGTERM: the first asks, the second ends."""

from __future__ import annotations

import signal
from types import FrameType


class Interrupts:
    """Ctrl-C: once asks for a landing, twice ends the program."""

    def __init__(self) -> None:
        self.reason = ""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.reason:
            raise KeyboardInterrupt
        self.reason = "stopped by the user (Ctrl-C)" if number == signal.SIGINT else "stopped by a signal (SIGTERM)"

    def requested(self) -> str:
        """Why to stop; empty if not."""
        return self.reason
