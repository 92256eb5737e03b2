"""What stalled a tick is counted as such and named: by the system's own accounts."""

from __future__ import annotations

import gc
import os
import select
import subprocess
import sys
import threading
import time

import pytest

from flightstack.cli.result import LoopTiming
from mavlink_bridge.transport import stall_watch
from mavlink_bridge.transport.stall_watch import Stall, StallWatch

PERIOD_US, TOLD_US = 4_000, 8_000


def _stalled(watch: StallWatch) -> Stall:
    stall = watch.tick("receiving")
    assert stall is not None
    return stall


def _spin(seconds: float) -> None:
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_a_stall_is_the_time_between_two_ticks() -> None:
    timing = LoopTiming(250)
    for between_us in (0, 4_000, 4_100, 315_000, 3_900):
        timing.tick(between_us, PERIOD_US)
    late = timing.summary()["lateness_us"]
    assert late["max"] == 311_000.0
    assert late["p50"] == 0.0
    assert timing.missed == 77  # ticks that there was time for


def test_the_longest_stalls_are_kept_the_longest_first() -> None:
    timing = LoopTiming(250)
    for k in range(50):
        timing.stall(20_000 + 1_000 * ((7 * k) % 50), f"{k}")
    kept = [stall["s"] for stall in timing.stalls]
    assert len(kept) == 20
    assert kept == sorted(kept, reverse=True)
    assert round(1e6 * kept[0]) == 69_000


def test_a_punctual_tick_is_no_stall() -> None:
    with StallWatch(PERIOD_US, told_from_us=10_000_000) as watch:
        assert watch.tick("receiving") is None
        assert watch.tick("receiving") is None
        assert 0 <= watch.between_us < 1_000_000


def test_our_own_code_is_named_with_its_part() -> None:
    with StallWatch(PERIOD_US, told_from_us=TOLD_US) as watch:
        watch.tick("receiving")
        watch.mark("deciding and flying")
        _spin(0.05)
        watch.mark("sending and logging")
        stall = _stalled(watch)
    assert stall.between_us >= 50_000
    assert "of it while deciding and flying" in stall.words
    if stall.between_us < 90_000:  # else another program had the processor for most of it
        assert "our own code, deciding and flying" in stall.words


def test_a_process_that_is_not_woken_is_named() -> None:
    with StallWatch(PERIOD_US, told_from_us=TOLD_US) as watch:
        watch.tick("receiving")
        watch.mark("waiting for the deadline")
        select.select([], [], [], 0.05)
        stall = _stalled(watch)
    assert "while waiting for the deadline" in stall.words
    assert "stopped or not woken" in stall.words or "other programs" in stall.words


@pytest.mark.skipif(not os.path.exists("/proc/thread-self/schedstat"), reason="the system does not tell")
@pytest.mark.parametrize(
    ("tells", "held_back_us", "cause"),
    [
        (True, 100.0, "the process was stopped or not woken"),
        (True, 1.2e6, "other programs had the processor"),
        (False, 100.0, "other programs had the processor"),
    ],
)
def test_a_stopped_process_that_others_interrupted_besides_is_no_matter_of_theirs(
    monkeypatch: pytest.MonkeyPatch, tells: bool, held_back_us: float, cause: str
) -> None:
    """SIGSTOP for 2.7 s: two involuntary switches, and not let for 0.1 ms of it by the system's own account."""
    watch = StallWatch(PERIOD_US, told_from_us=TOLD_US)
    nothing = stall_watch._read(-1)
    if not tells:
        watch._schedstat = -1
    interrupted = nothing._replace(
        involuntary=nothing.involuntary + 2, held_back_us=nothing.held_back_us + held_back_us
    )
    interrupted = interrupted._replace(thread_us=nothing.thread_us + 0.2 * 2.7e6)
    monkeypatch.setattr(stall_watch, "_read", lambda schedstat: interrupted)
    clock = iter((1_000_000, 1_004_000, 3_737_000))
    monkeypatch.setattr(stall_watch, "monotonic_us", lambda: next(clock))
    watch._before = interrupted
    watch.tick("receiving")
    watch.mark("waiting for the deadline")
    watch._before = nothing
    assert f"ms between two ticks: {cause};" in _stalled(watch).words


@pytest.mark.skipif(not os.path.exists("/proc/thread-self/schedstat"), reason="the system does not tell")
def test_what_could_run_and_was_not_let_is_told_apart() -> None:
    """Beside a program on the same processor: whoever never waits either runs or is held back."""
    before, one = os.sched_getaffinity(0), {min(os.sched_getaffinity(0))}
    os.sched_setaffinity(0, one)
    with subprocess.Popen(
        [sys.executable, "-c", "print(flush=True)\nwhile True: pass"], stdout=subprocess.PIPE
    ) as other:
        try:
            assert other.stdout is not None
            other.stdout.readline()
            with StallWatch(PERIOD_US, told_from_us=TOLD_US) as watch:
                watch.tick("receiving")
                _spin(0.1)
                stall = _stalled(watch)
        finally:
            other.kill()
            os.sched_setaffinity(0, before)
    held_back_ms = float(stall.words.partition("not let for ")[2].partition(" ms")[0])
    ran_ms = float(stall.words.partition("processor ")[2].partition(" ms")[0])
    assert held_back_ms > 10.0
    assert abs(1e-3 * stall.between_us - ran_ms - held_back_ms) < 10.0


def test_garbage_collection_is_named() -> None:
    heap = [[[]] for _ in range(400_000)]
    with StallWatch(PERIOD_US, told_from_us=TOLD_US) as watch:
        watch.tick("receiving")
        gc.collect()
        stall = watch.tick("receiving")
    assert len(heap)
    assert stall is not None
    assert "garbage collection" in stall.words


def test_another_thread_of_ours_is_named() -> None:
    """A thread that holds the interpreter, as a log that compresses may."""
    ready, stop = threading.Event(), threading.Event()

    def busy() -> None:
        ready.set()
        end = time.thread_time() + 0.1
        while time.thread_time() < end and not stop.is_set():
            pass

    thread = threading.Thread(target=busy)
    with StallWatch(PERIOD_US, told_from_us=TOLD_US) as watch:
        watch.tick("receiving")
        thread.start()
        ready.wait()
        thread.join()
        stall = _stalled(watch)
    if stall.between_us < 180_000:  # else it had to wait for a processor itself
        assert "another thread of ours" in stall.words
    assert float(stall.words.partition("all threads ")[2].partition(")")[0]) >= 99.0


def test_the_collectors_callback_is_taken_back() -> None:
    before = list(gc.callbacks)
    with StallWatch(PERIOD_US, told_from_us=TOLD_US):
        assert len(gc.callbacks) == len(before) + 1
    assert gc.callbacks == before
