"""What a loop asks of the machine, and that it gives it back."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from mavlink_bridge.pace import undisturbed
from mavlink_bridge.transport import machine

SPARE_KB = 32 * 1024
linux = pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="there is no such scheduler")


@linux
def test_real_time_priority_is_taken_where_permitted_and_given_back() -> None:
    before = os.sched_getscheduler(0)
    with machine.ahead_of_others() as is_ahead:
        assert is_ahead is (os.sched_getscheduler(0) == os.SCHED_FIFO)
    assert os.sched_getscheduler(0) == before


@linux
@pytest.mark.parametrize("real_time", [False, True])
def test_a_loop_in_real_time_has_it_and_one_in_lockstep_does_not(real_time: bool) -> None:
    before = os.sched_getscheduler(0)
    with machine.ahead_of_others() as is_permitted:
        pass
    with undisturbed(real_time=real_time) as is_ahead:
        assert is_ahead is (real_time and is_permitted)
        assert (os.sched_getscheduler(0) == before) is not is_ahead
        assert not gc.isenabled()
    assert os.sched_getscheduler(0) == before
    assert gc.isenabled()


def test_linear_algebra_keeps_to_one_thread_while_something_flies() -> None:
    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    np.linalg.inv(np.eye(2))
    with threadpool_limits(2, "blas"):  # as a program has it that imports numpy before
        before = threads()
        with undisturbed(real_time=False):
            assert threads() == {1}
        assert threads() == before


@linux
def test_where_it_is_not_permitted_nothing_is_changed_but_the_length_of_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError

    asked: list[bool] = []
    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(machine, "take_short_turns", lambda: asked.append(True))
    with machine.ahead_of_others() as is_ahead:
        assert not is_ahead
    assert asked == [True]


@linux
def test_a_process_that_may_not_go_ahead_of_others_asks_for_short_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError

    asked: list[bool] = []
    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(os, "setpriority", refused)
    monkeypatch.setattr(machine, "take_short_turns", lambda: asked.append(True))
    machine.raise_priority()
    assert asked == [True]


def test_a_system_without_any_of_it_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getscheduler", raising=False)
    monkeypatch.delattr(os, "uname", raising=False)
    assert machine.take_short_turns() is False
    with machine.ahead_of_others() as is_ahead:
        assert not is_ahead


@linux
def test_memory_that_a_flight_takes_is_already_there() -> None:
    """The kernel's own count: a learner that began took a thousand new pages in the tick of take-off, 10 us each."""
    import resource

    def new_pages(megabytes: int) -> int:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(3):
            np.ones(megabytes * 2**17)
        return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

    def status_kb(name: str) -> int:
        (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(f"{name}:"))
        return int(line.split()[1])

    with machine.locked_memory(wanted=True):
        if not status_kb("VmLck"):
            pytest.skip("not permitted")
        assert new_pages(6) < 100
        flown_kb = status_kb("RssAnon")
    assert flown_kb - status_kb("RssAnon") > 0.9 * SPARE_KB  # given back, whatever else this process has free
