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
    """The first one asks for a landing, the second one ends the program.

    A signal that was ignored when the program began stays so (SIGHUP under nohup, SIGINT in the background of a
    shell's script), but for those in `always`.
    """

    def __init__(self, always: tuple[signal.Signals, ...] = ()) -> None:
        self.reason = ""
        self.at_once = False
        """While it is set the first signal ends the program: nothing flies yet."""
        for number in _HEARD:
            if number in always or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.reason or self.at_once:
            raise KeyboardInterrupt
        self.reason = _HEARD[signal.Signals(number)]

    def requested(self) -> str:
        """Why to stop; empty if not."""
        return self.reason
