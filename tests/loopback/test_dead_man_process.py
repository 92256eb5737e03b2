"""The real thing: `sim` and `offboard` as processes in real time, the companion stopped, then killed in a figure of
eight; judged by the simulator's truth."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from simulator import ENVIRONMENT, HOST, bare_loop, free_ports, simulator, skip_where_too_busy

from flightstack.cli.replay import replay
from flightstack_logs.reader import read

TILT_MAX_DEG, LOST_MAX_M = 35.0, 0.8
LIMIT_S = 120.0
STALL_S, AFTER_STALL_S, AFTER_KILL_S = 0.2, 3.0, 2.0


def _offboard(port: int, out: Path, *more: str) -> list[str]:
    words = [sys.executable, "-m", "flightstack", "offboard", "--connect", f"udpin:{HOST}:{port}"]
    return [*words, "--arm", "--no-learning", "--out", str(out), "--json", str(out / "flight.json"), *more]


def _wait(seconds: float) -> None:
    select.select([], [], [], seconds)


def _until_said(process: subprocess.Popen[str], words: str) -> None:
    """Return once it was said; on a machine that is too busy to fly in real time at all nothing can be tested."""
    deadline = time.monotonic() + LIMIT_S
    said = ""
    assert process.stdout is not None
    with bare_loop() as bare_s:
        for line in process.stdout:
            said += line
            if words in line:
                return
            assert time.monotonic() < deadline, said
    skip_where_too_busy(said, bare_s)
    raise AssertionError(said)


def test_a_companion_stopped_and_then_killed_in_a_figure_of_eight_ends_in_hold(tmp_path: Path) -> None:
    port, gcs_port = free_ports()
    truth_log = tmp_path / "truth.mcap"
    with simulator(port, gcs_port, "--log", str(truth_log), speed=1.0):
        command = _offboard(port, tmp_path, "--scenario", "figure8")
        with subprocess.Popen(
            command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as companion:
            _until_said(companion, "track")
            _wait(1.0)
            os.kill(companion.pid, signal.SIGSTOP)
            _wait(STALL_S)
            os.kill(companion.pid, signal.SIGCONT)
            _wait(AFTER_STALL_S)
            os.kill(companion.pid, signal.SIGKILL)
            _wait(AFTER_KILL_S)
    told = [str(text) for text in read(tmp_path / "flight.mcap").tables["/events"]["text"]]
    stalls = [text for text in told if text.startswith("stall: ")]
    longest_ms = max(float(text.split()[1]) for text in stalls)
    assert longest_ms >= 1e3 * STALL_S - 1.0  # counted as what it was
    assert any(text.startswith("stalled: no setpoint for") for text in told)
    again = replay(tmp_path / "flight.mcap")  # in real time, over a stall and OFFBOARD taken back, cut off by the kill
    assert again.same, again.lines
    assert again.until_s is not None
    assert again.ticks > 1000
    truth = read(truth_log).tables["/truth"]
    t_s = 1e-6 * np.asarray(truth.t_us)
    height = -np.asarray(truth["pos_ned_m"])[:, 2]
    q = np.asarray(truth["q_ned_frd"])
    tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0)))
    since_stop = t_s > t_s[-1] - (STALL_S + AFTER_STALL_S + AFTER_KILL_S)
    assert height[since_stop].min() > 2.0 - LOST_MAX_M
    assert tilt[since_stop].max() <= TILT_MAX_DEG
    at_the_end = t_s > t_s[-1] - 0.5
    assert tilt[at_the_end].max() < 10.0  # PX4's Hold has it


@pytest.mark.parametrize("switch", ["--no-dead-man"])
def test_without_the_dead_man_a_stock_px4_is_refused_in_one_line(tmp_path: Path, switch: str) -> None:
    port, gcs_port = free_ports()
    with simulator(port, gcs_port):
        done = subprocess.run(
            _offboard(port, tmp_path, "--scenario", "hover", switch),
            env=ENVIRONMENT, capture_output=True, text=True, timeout=LIMIT_S, check=False,
        )  # fmt: skip
    assert done.returncode == 2, done.stdout + done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert "COM_OF_LOSS_T is 1 s and no dead-man runs" in errors[0]
    assert json.loads((tmp_path / "flight.json").read_text())["loop"]["dead_man"]["running"] is False
