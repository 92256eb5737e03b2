"""Pacing a real-time loop: absolute deadlines, counted misses, and a process that is left alone meanwhile."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

from threadpoolctl import threadpool_limits

from mavlink_bridge.transport.clock import SPIN_US, monotonic_us, sleep_until_us
from mavlink_bridge.transport.machine import ahead_of_others, locked_memory

_SWITCH_INTERVAL_S = 20e-6


class Pace:
    """Deadlines at a fixed period from the first `wait` on.

    A late loop skips deadlines, it never queues old ones.  A simulator may be patient instead: it catches up as long
    as it is not more than `patience_us` behind, so that its clock keeps its rate on a busy machine.

    `meanwhile` is told before each sleep when it ends, in `monotonic_us`: what others of the program may do until then.

    `is_ahead`: this thread has real-time priority, and may look at the clock for the last moment before a deadline.
    Where turns are shared that moment, a thirtieth of a processor at 250 Hz, is missing from the turns to come.
    """

    def __init__(
        self, period_us: float, *, patience_us: float = 0.0, is_ahead: bool = False,
        meanwhile: Callable[[int], None] = lambda until_us: None,
    ) -> None:  # fmt: skip
        self.period_us = period_us
        self._spin_us = SPIN_US if is_ahead else 0
        self._meanwhile = meanwhile
        self._patience_us = patience_us
        self.missed = 0
        """Deadlines that passed without a tick."""
        self.between_us = 0
        """From the tick before to the last one; 0 before the second."""
        self._deadline_us = -1.0
        self._began_us = -1

    def wait(self) -> int:
        """Sleep to the next deadline; how late the return is, in microseconds."""
        now = monotonic_us()
        if self._deadline_us < 0:
            self._deadline_us = float(now)
        else:
            self._deadline_us += self.period_us
        behind = now - self._deadline_us
        if behind > max(self.period_us, self._patience_us):
            skipped = int(behind // self.period_us)
            self.missed += skipped
            self._deadline_us += skipped * self.period_us
        self._meanwhile(int(self._deadline_us))
        sleep_until_us(int(self._deadline_us), self._spin_us)
        before_us, self._began_us = self._began_us, monotonic_us()
        self.between_us = self._began_us - before_us if before_us >= 0 else 0
        return max(0, self._began_us - int(self._deadline_us))

    def busy_us(self) -> int:
        """Time since the last `wait` returned."""
        return monotonic_us() - self._began_us


@contextmanager
def undisturbed(*, real_time: bool) -> Iterator[bool]:
    """No garbage collection inside the loop, and other threads give the interpreter back within 20 us.

    Linear algebra keeps to one thread: a second one beside a busy core makes matrices of 300 rows several times slower.

    real_time: the loop is to keep pace with a clock, so this thread and those that it starts meanwhile get real-time
    priority and memory is locked, both where that is permitted; tells whether the priority was.
    """
    interval = sys.getswitchinterval()
    enabled = gc.isenabled()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    try:
        with (
            threadpool_limits(1, "blas"),
            ahead_of_others() if real_time else nullcontext(False) as is_ahead,
            locked_memory(real_time),
        ):
            yield is_ahead
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if enabled:
            gc.enable()
