"""What the machine is asked for so that a loop keeps its time: priority, and memory that stays where it is.

Imported by the dead-man's process too, so at the top it needs nothing but `os`.
"""

from __future__ import annotations

import contextlib
import os

_NICENESS = -15
_FIFO_PRIORITY = 10
_MCL_CURRENT, _MCL_FUTURE = 1, 2


def raise_priority() -> None:
    """Ahead of everything else where that is permitted: it runs a few hundred microseconds a second."""
    with contextlib.suppress(AttributeError, OSError):
        inherited = os.sched_getparam(0).sched_priority  # 0 where it is an ordinary process
        priority = min(os.sched_get_priority_max(os.SCHED_FIFO), max(_FIFO_PRIORITY, inherited + 1))
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        return
    with contextlib.suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)


def lock_memory() -> bool:
    """Keep every page in memory where that is permitted for all of them; whether it is."""
    try:
        import ctypes
        import resource

        unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
        if not unlimited and os.geteuid():
            return False  # pages that are locked up to a limit would make later allocations fail
        return bool(ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0)
    except (ImportError, OSError, AttributeError):
        return False
