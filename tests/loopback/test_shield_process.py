"""The verb `shield` as a process between the simulator and a stranger's program, in real time: what a kill, a stall and
its own end leave of the vehicle, by the simulator's truth."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import mavutil
from simulator import ENVIRONMENT, HOST, free_ports, simulator

from flightstack_logs.reader import read

SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 6.0
inside = [[-30.0, -20.0], [30.0, -20.0], [30.0, 20.0], [-30.0, 20.0]]
"""
TILT_MAX_DEG, LOST_MAX_M, LIMIT_S = 35.0, 0.8, 60.0
HOLD, OFFBOARD = (4, 3), (6, 0)
POSITION, VELOCITY = 0b1001_1111_1000, 0b1001_1100_0111
Wish = tuple[int, tuple[float, float, float]]


class Program:
    """Anybody's: pymavlink, one thread, a setpoint every 20 ms."""

    def __init__(self, port: int) -> None:
        self.link: Any = mavutil.mavlink_connection(f"udpin:{HOST}:{port}", source_system=245, source_component=190)
        self.wish: Wish = (POSITION, (0.0, 0.0, -2.5))
        self.pos_ned_m, self.vel_ned_mps = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        self.mode, self.armed = (0, 0), False
        self._due_s = 0.0

    def until(self, there: Callable[[], bool], within_s: float = LIMIT_S) -> None:
        """Speak and listen until it is so."""
        ends_s = time.monotonic() + within_s
        while not there():
            assert time.monotonic() < ends_s, (self.mode, self.pos_ned_m, self.vel_ned_mps)
            self._turn()

    def wait(self, seconds: float) -> None:
        """Speak and listen so long."""
        ends_s = time.monotonic() + seconds
        while time.monotonic() < ends_s:
            self._turn()

    def set_mode(self, mode: tuple[int, int]) -> None:
        self._command(mavutil.mavlink.MAV_CMD_DO_SET_MODE, 1.0, float(mode[0]), float(mode[1]))

    def arm(self) -> None:
        self._command(mavutil.mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def _command(self, number: int, *params: float) -> None:
        self.link.mav.command_long_send(1, 1, number, 0, *params, *(0.0,) * (7 - len(params)))

    def _turn(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._due_s:
            self._due_s = now_s + 0.02
            mask, (x, y, z) = self.wish
            self.link.mav.set_position_target_local_ned_send(0, 1, 1, 1, mask, x, y, z, x, y, z, 0, 0, 0, 0, 0)
        message = self.link.recv_match(blocking=True, timeout=0.005)
        if message is None or message.get_srcSystem() != 1:
            return
        if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == 1:
            self.mode = (message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF)
            self.armed = bool(message.base_mode & mavutil.mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        elif message.get_type() == "LOCAL_POSITION_NED":
            self.pos_ned_m, self.vel_ned_mps = (message.x, message.y, message.z), (message.vx, message.vy, message.vz)

    def take_off(self) -> None:
        self.link.wait_heartbeat(timeout=LIMIT_S)
        self.wait(2.0)
        while not (self.mode == OFFBOARD and self.armed):
            self.set_mode(OFFBOARD) if self.mode != OFFBOARD else self.arm()
            self.wait(0.5)
        self.until(lambda: self.pos_ned_m[2] < -2.2)


@contextmanager
def flying(folder: Path, json_file: Path) -> Iterator[tuple[Program, subprocess.Popen[str], Path]]:
    """At 4 m/s behind the shield."""
    port, gcs_port = free_ports()
    served, _ = free_ports()
    site, truth = folder / "field.toml", folder / "truth.mcap"
    site.write_text(SITE)
    words = [sys.executable, "-m", "flightstack.cli.main", "shield", "--connect", f"udpin:{HOST}:{port}"]
    words += ["--serve", f"udpout:{HOST}:{served}", "--site", str(site), "--json", str(json_file)]
    with simulator(port, gcs_port, "--log", str(truth), speed=1.0):
        router = subprocess.Popen(words, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        program = Program(served)
        try:
            program.take_off()
            program.wish = VELOCITY, (4.0, 0.0, 0.0)
            program.until(lambda: program.vel_ned_mps[0] > 3.0)
            yield program, router, truth
        finally:
            program.link.close()
            if router.poll() is None:
                router.kill()
            router.communicate()


def judged(truth_log: Path, last_s: float) -> None:
    """Nothing bad in the truth's last seconds, and Hold has it at their end."""
    truth = read(truth_log).tables["/truth"]
    t_s = 1e-6 * np.asarray(truth.t_us)
    height = -np.asarray(truth["pos_ned_m"])[:, 2]
    q = np.asarray(truth["q_ned_frd"])
    tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0)))
    since = t_s > t_s[-1] - last_s
    assert height[since].min() > 2.5 - LOST_MAX_M
    assert tilt[since].max() <= TILT_MAX_DEG
    assert np.linalg.norm(np.asarray(truth["vel_ned_mps"])[-1]) < 0.5


def test_a_shield_that_is_killed_at_speed_leaves_the_vehicle_in_hold(tmp_path: Path) -> None:
    with flying(tmp_path, tmp_path / "shield.json") as (program, router, truth):
        router.kill()
        router.wait()
        program.wait(4.0)
    judged(truth, 4.0)


def test_a_shield_that_stood_still_takes_the_vehicle_back_and_hands_it_over_before_it_ends(tmp_path: Path) -> None:
    with flying(tmp_path, tmp_path / "shield.json") as (program, router, truth):
        os.kill(router.pid, signal.SIGSTOP)
        program.wish = VELOCITY, (-3.0, 0.0, 0.0)
        program.wait(0.3)
        os.kill(router.pid, signal.SIGCONT)
        program.until(lambda: program.vel_ned_mps[0] < -2.5, 10.0)  # the program's word counts again
        assert program.mode == OFFBOARD
        router.send_signal(signal.SIGTERM)
        router.wait(10.0)
        program.wait(3.0)
        result = json.loads((tmp_path / "shield.json").read_text())
        assert result["handed_over"] is True
        assert (result["dead_man"]["acted"], result["dead_man"]["taken_back"]) == (1, 1)
    judged(truth, 5.0)
