"""The log in real time: a thread writes, the loop only appends to a bounded queue and never waits.

Appending to a deque is atomic and wakes nobody, which keeps the cost in the loop at a fraction of a microsecond.  A
loop that is paced tells when it sleeps and until when (`meanwhile`); the thread writes then and no longer, in pieces.
Two threads that both want the interpreter hand it to and fro every 20 us, which costs more than either's work: a chunk
that was closed while the loop computed made ticks of 12 to 20 ms (measured beside a real PX4, two busy cores).  If the
disk hangs, log lines are dropped and counted, no setpoint.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from flightstack.barrier.records import Certificate
from flightstack.types import TickRecord
from flightstack_logs import scene as viewer
from flightstack_logs.topics import Attachment
from flightstack_logs.writer import FlightLog

POLL_S = 0.05
FLUSH_S = 0.6
"""Without a chunk for so long, a little longer than a log's own, one is closed: the vehicle's time stands still."""
CAPACITY = 20_000
"""About six seconds of a flight."""
BACKLOG = 2_000
"""With so many calls in the queue, a second of a flight, it is written whatever the loop does."""
_WORTH_WAKING = 32
"""Calls, of some four ticks: a thread that is woken each tick costs more than it does."""
_CALL_US, _PIECE_US = 300, 600
"""Most of the time that a call of the queue takes (99 in 100 on a slow core, cold), and a piece of a chunk."""
_GONE_US = 50_000
"""A loop that has told nothing for so long after its sleep stands still or has ended."""


class ThreadedLog:
    """A `FlightLog` behind a queue; it may only be used through this object until `close` has returned."""

    def __init__(self, log: FlightLog, *, capacity: int = CAPACITY, start: bool = True, poll_s: float = POLL_S) -> None:
        self.log = log
        self.dropped = 0
        """Calls that found the queue full."""
        self._queue: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self._capacity, self._poll_s = capacity, poll_s
        self._last_t_us = 0
        self.keeps_wire = log.keeps_wire
        self._stop = threading.Event()
        self._free_until_us: float = math.inf
        self._chunk_s = time.monotonic()
        """When the last chunk was closed."""
        self._closing_chunk = False
        self._wake = threading.Lock()
        """Held while the thread waits to be woken."""
        self._wake.acquire()
        log.between_pieces = self._await_room
        self._late = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        if start:
            self._thread.start()

    @property
    def failed(self) -> str | None:
        """The first thing that went wrong, one line."""
        if self._late:
            return f"log {self.log.path}: the disk took too long; {len(self._queue)} lines are not in the log"
        if self.log.failed is None and self.dropped:
            return f"log {self.log.path}: the disk was too slow; {self.dropped} lines are not in the log"
        return self.log.failed

    def _put(self, t_us: int, call: Callable[..., None], *arguments: object) -> None:
        if self._closed:
            return
        if len(self._queue) >= self._capacity:
            self.dropped += 1
            return
        self._last_t_us = t_us
        self._queue.append((call, arguments))

    def write(self, topic: str, t_us: int, record: object) -> None:
        """One message of a topic of the table."""
        if len(self._queue) < self._capacity and not self._closed:  # as `_put`, for the calls of every tick
            self._queue.append((self.log.write, (topic, t_us, record)))
        else:
            self._put(t_us, self.log.write, topic, t_us, record)

    def mavlink(self, direction: str, t_us: int, data: bytes) -> None:
        """One datagram as it was on the wire; direction rx or tx, seen from the companion."""
        if self.keeps_wire:
            self._put(t_us, self.log.mavlink, direction, t_us, data)

    def tick(self, record: TickRecord, t_us: int | None = None) -> None:
        """One tick of the stack; `t_us`: log time, where it is not the vehicle's."""
        at_us = record.t_us if t_us is None else t_us
        if len(self._queue) < self._capacity and not self._closed:
            self._last_t_us = at_us
            self._queue.append((self.log.tick, (record, t_us)))
        else:
            self._put(at_us, self.log.tick, record, t_us)

    def truth(self, t_us: int, truth: object) -> None:
        """The simulator's truth."""
        if len(self._queue) < self._capacity and not self._closed:
            self._last_t_us = t_us
            self._queue.append((self.log.truth, (t_us, truth)))
        else:
            self._put(t_us, self.log.truth, t_us, truth)

    def event(self, t_us: int, name: str, text: str, severity: str = "info") -> None:
        """Something that happened."""
        self._put(t_us, self.log.event, t_us, name, text, severity)

    def statustext(self, t_us: int, severity: int, text: str) -> None:
        """A line that the vehicle said, with its MAV_SEVERITY."""
        self._put(t_us, self.log.statustext, t_us, severity, text)

    def location(self, t_us: int, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        """Where the vehicle is on the map."""
        self._put(t_us, self.log.location, t_us, latitude_deg, longitude_deg, altitude_m)

    def scene(self, t_us: int, view: viewer.Shown) -> None:
        """What the 3-D view shows."""
        self._put(t_us, self.log.scene, t_us, view)

    def certificate(self, t_us: int, certificate: Certificate) -> None:
        """What the filter keeps to from now on; the last one becomes an attachment when the log is closed."""
        self._put(t_us, self.log.certificate, t_us, certificate)

    def result(self, attachment: Attachment) -> None:
        """What the flight came to; written when the log is closed."""
        self._put(self._last_t_us, self.log.result, attachment)

    def close(self, timeout_s: float = 5.0) -> None:
        """Write what is queued and finish the file, waiting at most so long; again does nothing."""
        if self._closed:
            return
        self._closed = True
        self._stop.set()
        if self._thread.ident is None:
            self._finish()
            return
        self._thread.join(timeout_s)
        self._late = self._thread.is_alive()

    def meanwhile(self, until_us: int) -> None:
        """The loop sleeps until then, by time.monotonic: what is queued is written, once it is worth it."""
        self._free_until_us = until_us
        if (self._closing_chunk or len(self._queue) >= _WORTH_WAKING) and self._wake.locked():
            self._wake.release()

    def _has_room(self, for_us: int) -> bool:
        """Whether the thread may take so long now."""
        left_us = self._free_until_us - time.monotonic_ns() // 1000
        return left_us > for_us or left_us < -_GONE_US or len(self._queue) > BACKLOG or self._stop.is_set()

    def _await_room(self) -> None:
        self._chunk_s = time.monotonic()
        self._closing_chunk = True
        while not self._has_room(_PIECE_US):
            self._wake.acquire(timeout=self._poll_s)
        self._closing_chunk = False

    def _run(self) -> None:
        while not self._stop.is_set():
            self._wake.acquire(timeout=self._poll_s)
            self._drain()
            if time.monotonic() - self._chunk_s >= FLUSH_S:
                self.log.flush()
        self._finish()

    def _drain(self) -> None:
        queue = self._queue
        while queue and self._has_room(_CALL_US):
            call, arguments = queue.popleft()
            call(*arguments)

    def _finish(self) -> None:
        self._drain()
        if self.dropped:
            self.log.event(
                self._last_t_us, "log", f"the disk was too slow: {self.dropped} lines are missing", "warning"
            )
        self.log.close()
