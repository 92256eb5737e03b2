"""Several parts of one work at a time, on as many cores as there are: compiled loops and NumPy let others work."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from threading import local
from typing import TypeVar

T = TypeVar("T")
_MOST_THREADS = 4
_here = local()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_MOST_THREADS - 1)


os.register_at_fork(after_in_child=_pool.cache_clear)  # a child has none of its parent's threads


def on_cores(work: Callable[[T], object], parts: Sequence[T]) -> None:
    """`work` of every part, each by whichever core is free; a part's own parts are done where it is.

    No part may need what another makes.
    """
    count = min(os.cpu_count() or 1, _MOST_THREADS, len(parts))
    if count < 2 or getattr(_here, "busy", False):
        for part in parts:
            work(part)
        return
    left = iter(parts)  # whoever takes the next one does so alone: it is one step of the interpreter's

    def some() -> None:
        _here.busy = True
        try:
            for part in left:
                work(part)
        finally:
            _here.busy = False

    jobs = [_pool().submit(some) for _ in range(count - 1)]
    try:
        some()
    finally:
        for job in jobs:
            job.result()


def share(work: Callable[[slice], None], rows: int, least: int) -> None:
    """`work` of all rows, a part of them (`least` or more) on each core."""
    count = max(1, min(os.cpu_count() or 1, _MOST_THREADS, rows // least))
    on_cores(work, [slice(low, high) for low, high in pairwise(rows * k // count for k in range(count + 1))])
