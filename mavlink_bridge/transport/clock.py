"""The only clocks: monotonic microseconds and a sleep that keeps its deadline; signatures count the wall's time."""

from __future__ import annotations

import time

SPIN_US = 150
"""The system wakes a sleeper some 50 to 100 us late."""
_SIGNING_EPOCH_NS = 1_420_070_400 * 10**9


def monotonic_us() -> int:
    """Microseconds of a clock that never jumps; its zero means nothing."""
    return time.monotonic_ns() // 1000


def sleep_until_us(deadline_us: int, spin_us: int = SPIN_US) -> None:
    """Return at `deadline_us` of `monotonic_us`, or at once if it has passed.

    The last `spin_us` are spent looking at the clock.
    """
    rest_us = deadline_us - monotonic_us() - spin_us
    if rest_us > 0:
        time.sleep(rest_us * 1e-6)
    deadline_ns = deadline_us * 1000
    clock = time.monotonic_ns
    while clock() < deadline_ns:
        pass


def utc_us() -> int:
    """The wall clock, microseconds since 1970 UTC; it may jump."""
    return time.time_ns() // 1000


def signing_stamp() -> int:
    """The wall clock in tens of microseconds since 2015-01-01 UTC, as MAVLink's signatures count; it may jump."""
    return max(0, (time.time_ns() - _SIGNING_EPOCH_NS) // 10_000)
