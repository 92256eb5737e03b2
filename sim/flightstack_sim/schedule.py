"""When the streams of one MAVLink link are due: a heap, so that a tick costs only what it sends.

Times are simulated microseconds.  A stream keeps its own grid (due + interval), so a rate that is no multiple of the
tick comes out right on average; a stream that fell behind starts a new grid instead of catching up.
"""

from __future__ import annotations

from heapq import heapify, heappush, heapreplace

STOPPED = -1


class Schedule:
    """Due times of numbered streams.  `key`: any number of the caller's, unique on the link."""

    __slots__ = ("_heap", "_intervals_us")

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, int]] = []  # (due, key, interval it was pushed with)
        self._intervals_us: dict[int, int] = {}

    def interval_us(self, key: int) -> int:
        """The stream's interval, STOPPED without one."""
        return self._intervals_us.get(key, STOPPED)

    def start(self, key: int, interval_us: int, first_us: int) -> None:
        """Run stream `key` every `interval_us` (> 0) from `first_us` on; replaces what it did before."""
        self.stop(key)
        self._intervals_us[key] = interval_us
        heappush(self._heap, (first_us, key, interval_us))

    def stop(self, key: int) -> None:
        """Stop a stream."""
        if self._intervals_us.pop(key, None) is not None:
            self._heap = [entry for entry in self._heap if entry[1] != key]
            heapify(self._heap)

    def due(self, now_us: int) -> list[int]:
        """Keys of the streams that are due at `now_us`, in order of due time, then key; each once."""
        heap = self._heap
        keys = []
        while heap:
            due_us, key, interval_us = heap[0]
            if due_us > now_us:
                break
            next_us = due_us + interval_us
            heapreplace(heap, (next_us if next_us > now_us else now_us + interval_us, key, interval_us))
            keys.append(key)
        return keys
