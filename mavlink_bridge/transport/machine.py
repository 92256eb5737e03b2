"""What the machine is asked for so that a loop keeps its time: priority, and memory that stays where it is.

Imported by the dead-man's process too, so at the top it needs nothing but `os` and `signal`.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator

_NICENESS = -15
_PR_SET_PDEATHSIG = 1
_FIFO_PRIORITY = 10
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4
"""Of glibc's mallopt: from how much on free memory is given back; how many blocks are pages of their own."""
_TRIM_BYTES, _MMAP_MAX = 128 * 1024, 65536
"""What they are by default."""
_SPARE_BYTES = 32 * 1024 * 1024
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""Number of the system call, which the C library does not know."""
_TURN_NS = 100_000


def raise_priority() -> None:
    """Ahead of everything else where that is permitted, else short turns: it needs the processor for moments."""
    with contextlib.suppress(AttributeError, OSError):
        inherited = os.sched_getparam(0).sched_priority  # 0 where it is an ordinary process
        priority = min(os.sched_get_priority_max(os.SCHED_FIFO), max(_FIFO_PRIORITY, inherited + 1))
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        return
    with contextlib.suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
        return
    take_short_turns()


def stand_back(niceness: int = 0) -> None:
    """Run where others leave room: a service's real-time priority (docs/companion.md) is inherited, not meant."""
    with contextlib.suppress(AttributeError, OSError):  # Linux has the first, Windows neither
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with contextlib.suppress(AttributeError, OSError):
        os.nice(niceness)


def take_short_turns() -> bool:
    """Ask for turns of 0.1 ms on the processor, the shortest there are, and so to be let in soon; whether it is done.

    A loop that sleeps most of the time then need not wait for others to end turns of some milliseconds.  It needs no
    permission and gets no more of the processor; Linux has it from 6.12 on, and before that refuses or ignores it.
    """
    number = _SCHED_SETATTR.get(os.uname().machine) if hasattr(os, "uname") else None
    try:
        import ctypes
        import struct

        if number is None or os.sched_getscheduler(0) != os.SCHED_OTHER:
            return False
        niceness = os.getpriority(os.PRIO_PROCESS, 0)
        asked = struct.pack("<IIQiIQQQII", 56, os.SCHED_OTHER, 0, niceness, 0, _TURN_NS, 0, 0, 0, 0)
        return bool(ctypes.CDLL(None).syscall(number, 0, asked, 0) == 0)
    except (ImportError, OSError, AttributeError):
        return False


def die_with_parent(parent: int) -> None:
    """Linux kills this process, a fork, when its parent ends; elsewhere it must see that its socket is closed."""
    with contextlib.suppress(ImportError, OSError, AttributeError):
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


@contextlib.contextmanager
def ahead_of_others() -> Iterator[bool]:
    """Real-time priority for this thread and those that it starts meanwhile, where that is permitted; else short turns.

    Tells whether it is permitted.  Whoever began in real time keeps the priority that was given.
    """
    try:
        before = os.sched_getscheduler(0)
        if before == os.SCHED_OTHER:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    except (AttributeError, OSError):
        take_short_turns()
        yield False
        return
    try:
        yield True
    finally:
        if before == os.SCHED_OTHER:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextlib.contextmanager
def locked_memory(wanted: bool) -> Iterator[None]:
    """`lock_memory` where it is wanted, and back."""
    is_locked = wanted and lock_memory(_SPARE_BYTES)
    try:
        yield
    finally:
        if is_locked:
            import ctypes

            libc = ctypes.CDLL(None)
            libc.munlockall()
            with contextlib.suppress(AttributeError):
                libc.mallopt(_M_MMAP_MAX, _MMAP_MAX)
                libc.mallopt(_M_TRIM_THRESHOLD, _TRIM_BYTES)
                libc.malloc_trim(0)


def lock_memory(spare_bytes: int = 0) -> bool:
    """Keep every page in memory where that is permitted for all of them; whether it is.

    And have some to spare: a page that is new costs some 10 us, of which a learner that begins takes a thousand.
    """
    try:
        import ctypes
        import resource

        unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
        if not unlimited and os.geteuid():
            return False  # pages that are locked up to a limit would make later allocations fail
        libc = ctypes.CDLL(None)
        is_locked = bool(libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0)
        with contextlib.suppress(AttributeError):  # of another C library
            if not (is_locked and spare_bytes):
                return is_locked
            if libc.mallopt(_M_MMAP_MAX, 0) and libc.mallopt(_M_TRIM_THRESHOLD, 2 * spare_bytes):
                libc.malloc.restype, libc.free.argtypes = ctypes.c_void_p, (ctypes.c_void_p,)
                libc.free(libc.malloc(ctypes.c_size_t(spare_bytes)))  # locked, so it is there at once
        return is_locked
    except (ImportError, OSError, AttributeError):
        return False
