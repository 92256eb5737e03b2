"""A process of one thread, as a flight's is: one that a test before left idling would keep a fork from being begun."""

from __future__ import annotations

import gc
import os
import sys
import threading

import pytest

from flightstack.gap import cores


def require_one_thread() -> None:
    """End pools that idle; what is left fails the test by its name.  On one core it is skipped."""
    if sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2:
        pytest.skip("no second core for a process, or no fork")
    cores._pool().shutdown()
    cores._pool.cache_clear()
    gc.collect()  # pools that nobody holds any more end with their owner
    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    for thread in others:
        thread.join(2.0)
    left = [thread.name for thread in others if thread.is_alive()]
    assert not left, f"threads of tests before this one: {left}"
