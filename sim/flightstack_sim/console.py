"""What a vehicle's console says: each warning once in a while, so that a hostile client fills nobody's pipe."""

from __future__ import annotations

from typing import Final

from flightstack_sim.autopilot.notices import CRITICAL, Notice

AGAIN_AFTER_US: Final = 10_000_000
MOST_LINES: Final = 200
"""In all: some 12 kB, less than the pipe of somebody who never reads holds."""


class Console:
    """Lines that nobody has taken yet; mutable."""

    __slots__ = ("_lines", "_said", "_said_at_us")

    def __init__(self) -> None:
        self._lines: list[tuple[int, str]] = []
        self._said_at_us: dict[str, int] = {}
        self._said = 0

    def add(self, notice: Notice, now_us: int) -> None:
        """A warning becomes a line, unless it was one lately or there were too many."""
        text = (notice.text or notice.console).strip()
        if notice.severity > CRITICAL or not text or self._said >= MOST_LINES:
            return
        if now_us - self._said_at_us.get(text, -AGAIN_AFTER_US) >= AGAIN_AFTER_US:
            self._said_at_us[text] = now_us
            self._said += 1
            self._lines.append((now_us, text))

    def take(self) -> list[tuple[int, str]]:
        """The vehicle's time and the text of what is new."""
        taken, self._lines = self._lines, []
        return taken
