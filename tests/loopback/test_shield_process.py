"""The verb `shield` as a process between the simulator and a stranger's program, in real time: what a kill, a stall and
its own end leave of the vehicle, by the simulator's truth."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from simulator import ENVIRONMENT, HOST, free_ports, simulator

from flightstack_logs.reader import read

SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 6.0
inside = [[-30.0, -20.0], [30.0, -20.0], [30.0, 20.0], [-30.0, 20.0]]
"""
PROGRAM = Path(__file__).parents[1] / "client" / "shielded_program.py"
TILT_MAX_DEG, LOST_MAX_M, HEIGHT_M = 35.0, 0.8, 2.5
STALL_S, AFTER_S = 0.3, 3.0


def _wait(seconds: float) -> None:
    select.select([], [], [], seconds)


def _until_said(process: subprocess.Popen[str], word: str) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if word in line:
            return
    raise AssertionError(f"the program ended before it said {word}")


@contextmanager
def flying(folder: Path) -> Iterator[tuple[subprocess.Popen[str], subprocess.Popen[str], Path]]:
    """Program, shield and truth's log, once the vehicle races north."""
    (port, gcs_port), (served, _) = free_ports(), free_ports()
    site, truth = folder / "field.toml", folder / "truth.mcap"
    site.write_text(SITE)
    words = [sys.executable, "-m", "flightstack", "shield", "--connect", f"udpin:{HOST}:{port}"]
    words += ["--serve", f"udpout:{HOST}:{served}", "--site", str(site), "--json", str(folder / "shield.json")]
    command = [sys.executable, str(PROGRAM), f"udpin:{HOST}:{served}"]
    with (
        simulator(port, gcs_port, "--log", str(truth), speed=1.0),
        subprocess.Popen(words, env=ENVIRONMENT, stdout=subprocess.DEVNULL, text=True) as shield,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program,
    ):
        try:
            _until_said(program, "north")
            yield program, shield, truth
        finally:
            program.kill()
            shield.kill()


def judge(truth_log: Path, last_s: float) -> None:
    """Nothing bad in the truth's last seconds, and at their end the vehicle stands in the air."""
    truth = read(truth_log).tables["/truth"]
    t_s = 1e-6 * np.asarray(truth.t_us)
    height = -np.asarray(truth["pos_ned_m"])[:, 2]
    q = np.asarray(truth["q_ned_frd"])
    tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0)))
    since = t_s > t_s[-1] - last_s
    assert height[since].min() > HEIGHT_M - LOST_MAX_M
    assert tilt[since].max() <= TILT_MAX_DEG
    assert np.linalg.norm(np.asarray(truth["vel_ned_mps"])[-1]) < 0.5


def test_a_shield_that_is_killed_at_speed_leaves_the_vehicle_in_hold(tmp_path: Path) -> None:
    with flying(tmp_path) as (_, shield, truth):
        shield.kill()
        _wait(AFTER_S)
    judge(truth, AFTER_S)


def test_a_shield_that_stood_still_takes_the_vehicle_back_and_hands_it_over_before_it_ends(tmp_path: Path) -> None:
    with flying(tmp_path) as (program, shield, truth):
        os.kill(shield.pid, signal.SIGSTOP)
        _wait(STALL_S)
        os.kill(shield.pid, signal.SIGCONT)
        _until_said(program, "south")  # the program's word counts again
        shield.send_signal(signal.SIGTERM)
        assert shield.wait(10.0) == 130
        _wait(AFTER_S)
    result = json.loads((tmp_path / "shield.json").read_text())
    assert result["handed_over"] is True
    assert result["dead_man"]["acted"] >= 1  # a busy machine may stall it once more, which is not taken back
    assert result["dead_man"]["taken_back"] == 1
    judge(truth, AFTER_S)
