"""Certificates of a flight in lockstep: the same log to the last byte whoever makes them, and no process is left."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from flightstack.cli import certifier_process, workshop
from flightstack.cli.certifier_process import CertifierProcess
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.replay import replay
from flightstack_logs.reader import read
from tests.alone import require_one_thread
from tests.thorough import thorough

FLIGHT: dict[str, Any] = {"scenario": "paper-barrier", "seed": 2, "duration_s": 8.0}


@pytest.fixture(autouse=True)
def forking() -> None:
    require_one_thread()


class Seen:
    """What became of the orders."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, word: int = 0) -> None:
        """`word`: a signal for the process, once the third order is placed."""
        self.made = self.placed = 0
        self.pids: set[int] = set()

        def made(message: bytes) -> Any:
            self.made += 1
            return certifier_process.made(message)

        def place(process: CertifierProcess, message: bytes) -> None:
            self.placed += 1
            if not process.lost:
                assert process.pid is not None
                self.pids.add(process.pid)
                if word and self.placed == 3:
                    os.kill(process.pid, word)
            placing(process, message)

        placing = CertifierProcess.place
        monkeypatch.setattr(workshop, "made", made)
        monkeypatch.setattr(CertifierProcess, "place", place)


def flown(folder: Path, **options: Any) -> bytes:
    result = fly(FlyOptions(out=folder, **FLIGHT, **options), report_wanted=lambda result: False)
    assert result.completed, result.reason
    return (folder / "flight.mcap").read_bytes()


@pytest.fixture(scope="module")
def inline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight that begins no process."""
    with pytest.MonkeyPatch.context() as patch:
        seen = Seen(patch)
        flown(folder := tmp_path_factory.mktemp("inline"), beside=False)
    assert seen.made > 3
    assert not seen.pids
    return folder / "flight.mcap"


def test_its_log_is_the_same_where_a_process_makes_them_and_replays(
    inline: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = Seen(monkeypatch)
    assert flown(tmp_path) == inline.read_bytes()
    assert seen.placed > 3
    assert seen.made == 0
    (pid,) = seen.pids
    assert not Path(f"/proc/{pid}").exists()
    assert any("certificate" in text for text in read(inline).tables["/events"]["text"].tolist())
    again = replay(tmp_path / "flight.mcap")
    assert again.lines == [f"{again.ticks} ticks: the same, bit for bit"]


@pytest.mark.parametrize("word", [signal.SIGKILL, signal.SIGSTOP])
def test_a_process_that_dies_or_is_stuck_changes_nothing(
    inline: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, word: int
) -> None:
    monkeypatch.setattr(workshop, "_WAIT_S", 0.3)
    seen = Seen(monkeypatch, word)
    assert flown(tmp_path) == inline.read_bytes()
    assert seen.made > 3
    assert seen.placed == 3
    (pid,) = seen.pids
    assert not Path(f"/proc/{pid}").exists()


def test_none_where_none_can_be_begun(inline: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: object) -> None:
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("multiprocessing.context.ForkProcess.start", refused)
    assert flown(tmp_path) == inline.read_bytes()


_BEGUN = """
import select, sys
from flightstack.cli.workshop import Appointed
with Appointed() as appointed:
    print(appointed.process.pid, flush=True)
    while not select.select([sys.stdin], [], [], 0.1)[0]:  # an interrupt just before a read that has no end is lost
        pass
"""


@pytest.mark.parametrize("word", [signal.SIGKILL, thorough(signal.SIGTERM), signal.SIGINT, None])
def test_it_ends_with_the_flight_however_that_ends(word: int | None) -> None:
    """Killed, interrupted as a terminal does (both processes), or over."""
    with subprocess.Popen(
        [sys.executable, "-c", _BEGUN], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        text=True, start_new_session=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    ) as flight:  # fmt: skip
        assert flight.stdout is not None
        assert flight.stdin is not None
        handle = os.pidfd_open(int(flight.stdout.readline()))
        try:
            if word == signal.SIGINT:
                os.killpg(flight.pid, word)
            elif word is not None:
                flight.send_signal(word)
            else:
                flight.stdin.close()
            assert select.select([handle], [], [], 10.0)[0]
        finally:
            os.close(handle)
            flight.kill()
