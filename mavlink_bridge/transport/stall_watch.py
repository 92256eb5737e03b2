"""What stalled a tick: the time between two ticks, and what the process did meanwhile.

The system's accounts (processor time, page faults, context switches, time for which the thread could run and was not
let) are read once a tick, which costs 5 us, and held against the tick before where the time between the two is too
long.  A thread of real-time priority is not let, too, where all of them together took 0.95 s of a second of a
processor: Linux then stops them for the rest of it (sched_rt_runtime_us), 50 ms by default.
"""

from __future__ import annotations

import gc
import os
import resource
import time
from types import TracebackType
from typing import NamedTuple, final

from mavlink_bridge.transport.clock import monotonic_us

_WHO = getattr(resource, "RUSAGE_THREAD", resource.RUSAGE_SELF)
_HALF = 0.5
WAITING = "waiting for the deadline"
_SCHEDSTAT = "/proc/thread-self/schedstat"
"""Linux: nanoseconds that the thread ran, and that it could run and did not."""


class _Accounts(NamedTuple):
    thread_us: float
    """Processor time of this thread."""
    process_us: float
    major: int
    minor: int
    voluntary: int
    involuntary: int
    held_back_us: float
    """For which this thread could run and was not let; 0 where the system does not say."""


def _read(schedstat: int) -> _Accounts:
    used = resource.getrusage(_WHO)
    thread_us = 1e6 * (used.ru_utime + used.ru_stime)
    process_us = 1e-3 * time.process_time_ns()
    held_back_us = 1e-3 * int(os.pread(schedstat, 64, 0).split()[1]) if schedstat >= 0 else 0.0
    return _Accounts(thread_us, process_us, used.ru_majflt, used.ru_minflt, used.ru_nvcsw, used.ru_nivcsw, held_back_us)


def _opened() -> int:
    """The file of this thread's accounts; -1 where there is none."""
    try:
        return os.open(_SCHEDSTAT, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return -1


class Stall(NamedTuple):
    """A tick that came too late."""

    between_us: int
    """Time since the tick before."""
    words: str
    """What kept it, one line."""


@final
class StallWatch:
    """Counts from its first `tick` on; `mark` names the phase of our own code that begins."""

    def __init__(self, period_us: int, *, told_from_us: int) -> None:
        """A time between ticks of `told_from_us` more than the period is a stall."""
        self.between_us = 0
        """From the tick before to the last one; 0 before the second."""
        self._limit_us = period_us + told_from_us
        self._period_us = period_us
        self._last_us = self._marked_us = -1
        self._phase, self._longest = WAITING, (0, WAITING)
        self._schedstat = _opened()
        self._before = _read(self._schedstat)
        self._gc_us = self._gc_began_us = 0

    def __enter__(self) -> StallWatch:
        gc.callbacks.append(self._on_gc)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        gc.callbacks.remove(self._on_gc)
        if self._schedstat >= 0:
            os.close(self._schedstat)
            self._schedstat = -1

    def mark(self, phase: str) -> None:
        """Our own code begins something else."""
        now_us = monotonic_us()
        self._end_phase(now_us)
        self._phase, self._marked_us = phase, now_us

    def tick(self, phase: str) -> Stall | None:
        """A tick begins; what stalled it, where something did."""
        now_us = monotonic_us()
        self._end_phase(now_us)
        after = _read(self._schedstat)
        before, self._before = self._before, after
        self.between_us = now_us - self._last_us if self._last_us >= 0 else 0
        stall = Stall(self.between_us, self._words(before, after)) if self.between_us > self._limit_us else None
        self._last_us = self._marked_us = now_us
        self._phase, self._longest, self._gc_us = phase, (0, phase), 0
        return stall

    def _end_phase(self, now_us: int) -> None:
        spent_us = now_us - self._marked_us if self._marked_us >= 0 else 0
        if self._phase == WAITING:
            spent_us -= self._period_us
        if spent_us > self._longest[0]:
            self._longest = (spent_us, self._phase)

    def _words(self, before: _Accounts, after: _Accounts) -> str:
        spent = _Accounts._make(b - a for a, b in zip(before, after, strict=True))
        late_us = self.between_us - self._period_us
        held_us, phase = self._longest
        return (
            f"{1e-3 * self.between_us:.0f} ms between two ticks: {self._cause(spent, late_us)}; "
            f"{1e-3 * held_us:.0f} ms of it while {phase}; processor {1e-3 * spent.thread_us:.1f} ms (all threads "
            f"{1e-3 * spent.process_us:.1f}), not let for {1e-3 * spent.held_back_us:.1f} ms, {spent.involuntary} "
            f"involuntary and {spent.voluntary} voluntary switches, page faults {spent.major} from disk, "
            f"{spent.minor} else, gc {1e-3 * self._gc_us:.1f} ms"
        )

    def _cause(self, spent: _Accounts, late_us: int) -> str:
        if self._gc_us > _HALF * late_us:
            return "garbage collection"
        if spent.thread_us > _HALF * late_us:
            return f"our own code, {self._longest[1]}"
        if spent.process_us > _HALF * late_us:
            return "another thread of ours"
        if spent.held_back_us > _HALF * late_us:
            return "other programs had the processor, or real time its fill of it"
        if spent.major:
            return "page faults from disk"
        stood = self._schedstat >= 0 and spent.thread_us + spent.held_back_us <= _HALF * late_us
        if spent.involuntary and not stood:  # a stopped process is interrupted by others besides, for a moment
            return "other programs had the processor"
        return "the process was stopped or not woken"

    def _on_gc(self, phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            self._gc_began_us = monotonic_us()
        else:
            self._gc_us += monotonic_us() - self._gc_began_us
