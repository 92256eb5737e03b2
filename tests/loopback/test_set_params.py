"""`offboard --set-params`: set before the flight, put back after it and after Ctrl-C; after kill -9 by the next run."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pymavlink import mavutil
from simulator import HOST, free_ports, simulator

from flightstack.cli import main as cli

GIVE_UP_S = 60.0
FILE = 'schema = "flightstack.params/1"\n[set]\nCOM_OF_LOSS_T = 0.3\nCOM_RC_IN_MODE = 4\n'
AT_FIRST = {"COM_OF_LOSS_T": 1.0, "COM_RC_IN_MODE": 1.0}
"""PX4's defaults."""
CHANGED = {"COM_OF_LOSS_T": pytest.approx(0.3), "COM_RC_IN_MODE": 4.0}


class Station:
    """Reads the simulator's parameters over its ground station's link, with pymavlink as the codec."""

    def __init__(self, port: int) -> None:
        self.link = mavutil.mavlink_connection(f"udpin:{HOST}:{port}", source_system=255)
        assert self.link.wait_heartbeat(timeout=GIVE_UP_S) is not None

    def read(self, name: str) -> float:
        while self.link.recv_match(blocking=False) is not None:
            pass  # what was told earlier, to others too
        for _ in range(50):
            self.link.mav.param_request_read_send(1, 1, name.encode(), -1)
            deadline = time.monotonic() + 0.5
            while time.monotonic() < deadline:
                message = self.link.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.1)
                if message is not None and message.param_id == name:
                    value = message.param_value
                    return float(struct.unpack("<i", struct.pack("<f", value))[0]) if message.param_type == 6 else value
        raise AssertionError(f"{name} was not told")

    def set(self, name: str, value: float) -> None:
        for _ in range(50):
            self.link.mav.param_set_send(1, 1, name.encode(), value, mavutil.mavlink.MAV_PARAM_TYPE_REAL32)
            if self.read(name) == pytest.approx(value):
                return
        raise AssertionError(f"{name} was not taken")

    def values(self) -> dict[str, float]:
        return {name: self.read(name) for name in AT_FIRST}


class Bench:
    def __init__(self, folder: Path, port: int, station: Station) -> None:
        self.folder, self.port, self.station = folder, port, station
        self.journals = folder / "flightstack" / "parameters"
        self.file = folder / "mine.toml"
        self.file.write_text(FILE)

    @property
    def words(self) -> list[str]:
        return ["offboard", "--connect", f"udpin:{HOST}:{self.port}", "--out", str(self.folder / "out")]

    def start(self, *more: str) -> subprocess.Popen[str]:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "XDG_STATE_HOME": str(self.folder)}
        return subprocess.Popen(
            [sys.executable, "-m", "flightstack", *self.words, *more],
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=self.folder,
        )  # fmt: skip

    def wait(self, wanted: Callable[[], bool]) -> None:
        deadline = time.monotonic() + GIVE_UP_S
        while not wanted():
            assert time.monotonic() < deadline
            time.sleep(0.05)


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """Exit code and what went to stderr, in this process."""
    with pytest.raises(SystemExit) as stop:
        cli.main(list(words))
    return int(stop.value.code or 0), capsys.readouterr().err


@pytest.fixture(scope="module")
def running() -> Iterator[tuple[int, Station]]:
    port, gcs_port = free_ports()
    with simulator(port, gcs_port, speed=1.0):
        station = Station(gcs_port)
        yield port, station
        station.link.close()


@pytest.fixture
def bench(tmp_path: Path, running: tuple[int, Station]) -> Bench:
    return Bench(tmp_path, *running)


def test_what_somebody_else_has_set_meanwhile_is_left_as_it_is(bench: Bench) -> None:
    """A ground station's later word counts: only what is still as this flight set it is put back."""
    with bench.start("--set-params", str(bench.file), "--json", str(bench.folder / "r.json")) as companion:
        bench.wait(lambda: bench.station.values() == CHANGED)
        bench.station.set("COM_OF_LOSS_T", 0.4)
        companion.send_signal(signal.SIGINT)
        _, errors = companion.communicate(timeout=GIVE_UP_S)
    told = json.loads((bench.folder / "r.json").read_text())["parameters_set"]
    assert bench.station.values() == {**AT_FIRST, "COM_OF_LOSS_T": pytest.approx(0.4)}
    bench.station.set("COM_OF_LOSS_T", AT_FIRST["COM_OF_LOSS_T"])
    assert "left as somebody else set it: COM_OF_LOSS_T 0.4" in errors
    assert {each["name"]: each["restored"] for each in told} == {"COM_OF_LOSS_T": False, "COM_RC_IN_MODE": True}
    assert not list(bench.journals.iterdir())


def test_ctrl_c_puts_back_and_kill_9_leaves_a_journal_that_the_next_run_follows(bench: Bench) -> None:
    """Without --arm the companion waits for the pilot: so long the parameters stand as the file says."""
    assert bench.station.values() == AT_FIRST
    with bench.start("--set-params", str(bench.file), "--json", str(bench.folder / "r.json")) as companion:
        bench.wait(lambda: bench.station.values() == CHANGED)
        assert len(list(bench.journals.iterdir())) == 1
        companion.send_signal(signal.SIGINT)
        _, errors = companion.communicate(timeout=GIVE_UP_S)
    assert companion.returncode == 130
    assert "COM_OF_LOSS_T 1 -> 0.3" in errors
    assert "put back" in errors
    assert bench.station.values() == AT_FIRST
    assert not list(bench.journals.iterdir())
    told = json.loads((bench.folder / "r.json").read_text())["parameters_set"]
    assert [(row["name"], row["before"], row["set"], row["restored"]) for row in told] == [
        ("COM_OF_LOSS_T", 1.0, 0.3, True), ("COM_RC_IN_MODE", 1.0, 4.0, True),
    ]  # fmt: skip

    with bench.start("--set-params", str(bench.file)) as companion:
        bench.wait(lambda: bench.station.values() == CHANGED)
        companion.kill()
    assert bench.station.values() == CHANGED
    assert len(list(bench.journals.iterdir())) == 1
    with bench.start("--dry-run") as next_one:
        _, errors = next_one.communicate(timeout=GIVE_UP_S)
    assert next_one.returncode == 0, errors
    assert "put back" in errors
    assert bench.station.values() == AT_FIRST
    assert not list(bench.journals.iterdir())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (FILE + "NO_SUCH_PARAM = 1\n", "NO_SUCH_PARAM"),
        (FILE.replace("= 4", "= 4.5"), "integer"),
        (FILE.replace("0.3", "5"), "COM_OF_LOSS_T is 5 s"),  # taken, judged like any other value, put back
    ],
)
def test_what_can_not_be_set_or_flown_with_is_one_line_and_nothing_stays_changed(
    bench: Bench, text: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.file.write_text(text)
    monkeypatch.setenv("XDG_STATE_HOME", str(bench.folder))
    code, errors = run(capsys, *bench.words, "--set-params", str(bench.file), "--arm")
    assert code in (1, 2)
    assert sum(line.startswith("error: ") for line in errors.splitlines()) == 1, errors
    assert said in errors
    assert "Traceback" not in errors
    assert bench.station.values() == AT_FIRST
    assert not bench.journals.exists() or not list(bench.journals.iterdir())


def test_without_a_vehicle_nothing_is_set_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    words = ["offboard", "--connect", f"udpin:{HOST}:{free_ports()[0]}", "--timeout", "0.3", "--out", str(tmp_path)]
    code, errors = run(capsys, *words, "--set-params", "px4-sih-ekf")
    assert code == 2
    assert errors.startswith("error: no vehicle answered")
