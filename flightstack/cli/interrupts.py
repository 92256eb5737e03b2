"""Ctrl-C, SIGTERM and SIGHUP: the first asks for an end, the second ends."""

from __future__ import annotations

import signal
from types import FrameType

_HEARD = {
    signal.SIGINT: "stopped by the user (Ctrl-C)",
    signal.SIGTERM: "stopped by a signal (SIGTERM)",
    signal.SIGHUP: "stopped by a signal (SIGHUP): its terminal is gone",
}


class Interrupts:
    """The first one asks for a landing, the second one ends the program."""

    def __init__(self) -> None:
        self.reason = ""
        for number in _HEARD:
            if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
                signal.signal(number, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.reason:
            raise KeyboardInterrupt
        self.reason = _HEARD[signal.Signals(number)]

    def requested(self) -> str:
        """Why to stop; empty if not."""
        return self.reason
