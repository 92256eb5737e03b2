from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from log_samples import Truth, tick_record

from flightstack.types import InputError
from flightstack_logs import threaded
from flightstack_logs.reader import read
from flightstack_logs.threaded import ThreadedLog
from flightstack_logs.writer import FlightLog, Recorder

PYTHONPATH = os.pathsep.join([str(Path(__file__).parent), *sys.path])


def run(code: str, path: Path) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own; PATH in it is where its log goes."""
    environment = {**os.environ, "PYTHONPATH": PYTHONPATH}
    source = f"PATH = {str(path)!r}\n" + code
    return subprocess.run([sys.executable, "-c", source], env=environment, capture_output=True, text=True, check=False)


KILLED = """
import os, signal
from log_samples import Truth, tick_record
from flightstack_logs.writer import FlightLog
log = FlightLog.open(PATH, metadata={"run": {"seed": "7"}})
for k in range(MESSAGES // 3):
    log.mavlink("rx", k * 4000, bytes(60))
    log.write("/vehicle/imu", k * 4000, (k, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))
    log.truth(k * 4000, Truth(k, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("messages", [3000, 12_000])
def test_a_killed_process_leaves_a_log_with_nearly_everything(tmp_path: Path, messages: int) -> None:
    """At most what came in the last 0.2 s is missing: 50 of 1000 or 4000 ticks."""
    done = run(KILLED.replace("MESSAGES", str(messages)), tmp_path / "a.mcap")
    assert done.returncode == -signal.SIGKILL, done.stderr
    log = read(tmp_path / "a.mcap")
    assert not log.complete
    assert log.metadata["run"] == {"seed": "7"}
    found = sum(len(topic) for topic in (log.messages["/mavlink/rx"], log.tables["/vehicle/imu"], log.tables["/truth"]))
    assert 0.95 * messages <= found <= messages
    assert log.tables["/vehicle/imu"]["t_us"].tolist() == list(range(len(log.tables["/vehicle/imu"])))


FILE_TOO_LARGE = """
import resource
from flightstack_logs.writer import FlightLog
log = FlightLog.open(PATH, metadata={"run": {"seed": "7"}})
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
import random
rng = random.Random(0)
for k in range(8000):
    log.mavlink("rx", k * 4000, rng.randbytes(100))
log.close()
assert log.failed is not None
print(log.failed)
"""


def test_a_file_that_may_not_grow_ends_with_its_last_whole_chunk_and_the_program_goes_on(tmp_path: Path) -> None:
    done = run(FILE_TOO_LARGE, tmp_path / "a.mcap")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "File too large" in done.stdout
    assert done.stdout.count("\n") == 1
    log = read(tmp_path / "a.mcap")
    assert log.notes == ("cut off: the log was not closed; it ends with the last chunk written",)
    assert len(log.messages["/mavlink/rx"]) * 100 > 100_000


INTERRUPTED = """
import signal
from flightstack_logs.writer import FlightLog
log = FlightLog.open(PATH, metadata={})
written = 0
interrupts = 0
def interrupt(_, frame):
    global interrupts
    if frame.f_code.co_filename.endswith("writer.py"):  # not in the loop below, which has to go on
        interrupts += 1
        raise KeyboardInterrupt
signal.signal(signal.SIGALRM, interrupt)
signal.setitimer(signal.ITIMER_REAL, 0.0005, 0.0005)
while written < 20_000 or interrupts < 20:
    try:
        log.mavlink("rx", written * 4000, bytes(100))
        written += 1
    except KeyboardInterrupt:
        pass
signal.signal(signal.SIGALRM, signal.SIG_IGN)
log.close()
assert log.failed is None, log.failed
print(written)
"""


def test_ctrl_c_in_the_middle_of_writing_leaves_a_whole_log(tmp_path: Path) -> None:
    done = run(INTERRUPTED, tmp_path / "a.mcap")
    assert done.returncode == 0, done.stderr
    log = read(tmp_path / "a.mcap")
    assert log.complete
    assert len(log.messages["/mavlink/rx"]) >= int(done.stdout)


def test_both_logs_are_recorders(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    recorders: list[Recorder] = [log, ThreadedLog(log, start=False)]
    wanted = {name for name in vars(Recorder) if not name.startswith("_")}
    assert all(hasattr(recorder, name) for recorder in recorders for name in wanted)
    recorders[1].close()


def test_the_thread_writes_the_same_file_as_the_direct_log(tmp_path: Path) -> None:
    logs: list[Recorder] = [
        FlightLog.open(tmp_path / "a.mcap", metadata={}),
        ThreadedLog(FlightLog.open(tmp_path / "b.mcap", metadata={}), start=False),
    ]
    for log in logs:
        for k in range(50):
            log.mavlink("tx", k * 4000, bytes(k))
            log.tick(tick_record(k * 4000))
            log.truth(k * 4000, Truth(k, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
        log.event(200_000, "phase", "done")
        log.statustext(200_000, 6, "hello")
        log.location(200_000, 47.0, 8.0, 400.0)
        log.write("/timing", 200_000, (1.0, 2.0, 0))
        log.close()
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_running_thread_has_written_everything_when_close_returns(tmp_path: Path) -> None:
    log = ThreadedLog(FlightLog.open(tmp_path / "a.mcap", metadata={}))
    for k in range(5000):
        log.mavlink("rx", k * 4000, bytes(10))
    log.close()
    log.close()
    log.mavlink("rx", 1, b"late")
    assert log.failed is None
    assert len(read(tmp_path / "a.mcap").messages["/mavlink/rx"]) == 5000


def test_the_thread_is_woken_once_there_is_something_worth_it(tmp_path: Path) -> None:
    """A thread that never looks by itself: a few calls wait, some four ticks' worth is written in its sleep."""
    log = ThreadedLog(FlightLog.open(tmp_path / "a.mcap", metadata={}), poll_s=3600.0)
    written, direct = threading.Event(), log.log.mavlink

    def mavlink(direction: str, t_us: int, data: bytes) -> None:
        direct(direction, t_us, data)
        if t_us == 39:
            written.set()

    log.log.mavlink = mavlink  # type: ignore[method-assign]
    for k in range(40):
        log.mavlink("rx", k, bytes(10))
        if k == 5:
            log.meanwhile(time.monotonic_ns() // 1000 + 60_000_000)
            assert log._wake.locked(), "it sleeps on"
    log.meanwhile(time.monotonic_ns() // 1000 + 60_000_000)
    assert written.wait(30.0)
    log._stop.set()
    log._wake.release()
    log.close()
    assert log.failed is None
    assert len(read(tmp_path / "a.mcap").messages["/mavlink/rx"]) == 40


def test_a_full_queue_drops_and_counts_and_the_log_says_how_many(tmp_path: Path) -> None:
    log = ThreadedLog(FlightLog.open(tmp_path / "a.mcap", metadata={}), capacity=100, start=False)
    for k in range(250):
        log.mavlink("rx", k, bytes(10))
    assert log.dropped == 150
    log.close()
    assert log.failed is not None
    assert "150 lines are not in the log" in log.failed
    found = read(tmp_path / "a.mcap")
    assert found.messages["/mavlink/rx"].t_us.tolist() == list(range(100))
    assert "150 lines are missing" in found.tables["/events"]["text"][0]


def test_datagrams_that_the_log_does_not_keep_take_no_room_in_the_queue(tmp_path: Path) -> None:
    kept = FlightLog.open(tmp_path / "a.mcap", metadata={}, wire=False)
    log = ThreadedLog(kept, capacity=10, start=False)
    for k in range(250):
        log.mavlink("rx", k, bytes(10))
    log.event(250, "phase", "done")
    assert log.dropped == 0
    log.close()
    assert read(tmp_path / "a.mcap").tables["/events"]["text"] == ["done"]


class _HangingLog:
    """Stands in for a log whose disk hangs until it is let go."""

    path = Path("hanging.mcap")
    failed = None
    keeps_wire = True

    def __init__(self) -> None:
        self.entered = threading.Event()
        self.go_on = threading.Event()

    def mavlink(self, direction: str, t_us: int, data: bytes) -> None:
        self.entered.set()
        self.go_on.wait()

    def event(self, *_: object) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_hanging_disk_holds_up_neither_the_loop_nor_the_landing(tmp_path: Path) -> None:
    disk = _HangingLog()
    log = ThreadedLog(disk, capacity=10)  # type: ignore[arg-type]
    log.mavlink("rx", 0, b"")
    disk.entered.wait()
    for k in range(30):
        log.mavlink("rx", k, b"")
    assert log.dropped == 20
    log.close(timeout_s=0.01)
    assert log.failed == "log hanging.mcap: the disk took too long; 10 lines are not in the log"
    disk.go_on.set()


def test_a_folder_without_permission_or_space_is_found_before_the_flight(tmp_path: Path) -> None:
    code = """
import resource
from flightstack.types import InputError
from flightstack_logs.writer import FlightLog
resource.setrlimit(resource.RLIMIT_FSIZE, (50, 50))
try:
    FlightLog.open(PATH, metadata={"run": {"seed": "7" * 200}})
except InputError as error:
    print(error)
"""
    done = run(code, tmp_path / "a.mcap")
    assert "File too large" in done.stdout, done.stderr
    assert not (tmp_path / "a.mcap").exists()
    assert issubclass(InputError, ValueError)


class _CountingLog(_HangingLog):
    """Stands in for a log; what it closes a chunk of waits before each piece, as `FlightLog` does."""

    def __init__(self) -> None:
        super().__init__()
        self.written: list[int] = []
        self.chunks = 0

    def event(self, t_us: int, *_: object) -> None:
        self.written.append(t_us)

    def flush(self) -> None:
        self.between_pieces()
        self.chunks += 1

    between_pieces: Callable[[], None]


def _soon(happened: Callable[[], bool], within_s: float = 5.0) -> bool:
    until_s = time.monotonic() + within_s
    while not happened() and time.monotonic() < until_s:
        time.sleep(0.001)
    return happened()


def test_nothing_is_written_while_the_loop_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both want the interpreter then, and handing it to and fro cost ticks of 12 to 20 ms."""
    monkeypatch.setattr(threaded, "_GONE_US", 10**12)
    monkeypatch.setattr(threaded, "FLUSH_S", 0.0)
    disk = _CountingLog()
    log = ThreadedLog(disk)  # type: ignore[arg-type]
    log.meanwhile(time.monotonic_ns() // 1000)  # no sleep at all: the loop is late
    time.sleep(0.02)
    chunks = disk.chunks
    log.event(1, "", "")
    time.sleep(0.05)
    assert disk.written == []
    assert disk.chunks == chunks
    log.meanwhile(time.monotonic_ns() // 1000 + 10**9)  # it sleeps
    assert _soon(lambda: disk.written == [1] and disk.chunks > chunks)
    log.close()


def test_a_loop_that_never_sleeps_or_is_gone_still_has_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threaded, "BACKLOG", 10)
    monkeypatch.setattr(threaded, "_GONE_US", 10**12)
    disk = _CountingLog()
    log = ThreadedLog(disk)  # type: ignore[arg-type]
    log.meanwhile(time.monotonic_ns() // 1000)
    for k in range(15):
        log.event(k, "", "")
    assert _soon(lambda: len(disk.written) == 5)
    monkeypatch.setattr(threaded, "_GONE_US", 0)
    assert _soon(lambda: len(disk.written) == 15)
    log.close()
