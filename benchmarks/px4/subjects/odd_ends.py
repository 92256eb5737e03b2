"""Ends of the companion at odd moments: in the climb, landing, both processes at once, its clock, its terminal."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.px4.companion import command, start
from benchmarks.px4.deeds import Attack, flown
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner, Relay
from benchmarks.px4.scene import LIMIT_S, OFFBOARD, Scene
from benchmarks.px4.station import OFFBOARD_PORT
from benchmarks.px4.subjects.attacks import ASKED as ASKED
from benchmarks.px4.subjects.attacks import dead_men

RUNS = 1
_POSITION = (3.0, 0.0)
_STICK_S = 0.04
_KILLED = -signal.SIGKILL
_OTHER_TIME = """
import runpy, sys, time
file, utc_s, utc_ns = sys.argv.pop(1), time.time, time.time_ns
def offset():
    with open(file) as opened:
        return float(opened.read() or 0)
time.time, time.time_ns = lambda: utc_s() + offset(), lambda: utc_ns() + int(1e9 * offset())
runpy.run_module("flightstack", run_name="__main__", alter_sys=True)
"""
_NOISE, _PROFILE = "EKF2_GYR_NOISE", "px4-sih-ekf"


def run(bench: Bench, runs: int) -> list[Row]:
    """Every one `runs` times."""
    return flown(bench, runs, ATTACKS)


def _killed_at(height_m: float, after_s: float = 0.0, watched_s: float = 8.0) -> Callable[[Scene], None]:
    """SIGKILL on the way up."""

    def deed(scene: Scene) -> None:
        _up_to(scene, height_m, "figure8")
        time.sleep(after_s)
        _kill(scene)
        time.sleep(watched_s)

    return deed


def _up_to(scene: Scene, height_m: float, scenario: str, *more: str) -> None:
    scene.process = start(scene.px4, scene.folder, scenario, *more)
    if not scene.wait(lambda: scene.px4.height_m > height_m or scene.ended, LIMIT_S):
        scene.notes.append("did not take off")


def _kill(scene: Scene) -> None:
    assert scene.process is not None
    scene.began_s = time.monotonic()
    scene.process.send_signal(signal.SIGKILL)


def _killed_while_landing(after_s: float) -> Callable[[Scene], None]:
    """The companion is asked to land, and killed."""

    def deed(scene: Scene) -> None:
        scene.begin()
        assert scene.process is not None
        scene.process.send_signal(signal.SIGTERM)
        time.sleep(after_s)
        _kill(scene)
        scene.wait(lambda: not scene.px4.armed, 30.0)
        if scene.px4.armed and after_s > 1.0:
            scene.notes.append("did not land")

    return deed


def _both_killed(*signals: tuple[str, int], watched_s: float = 8.0) -> Callable[[Scene], None]:
    """Companion and dead-man, one right after the other."""

    def deed(scene: Scene) -> None:
        scene.begin()
        assert scene.process is not None
        pids = {"companion": [scene.process.pid], "dead-man": dead_men(scene.process.pid)}
        if not pids["dead-man"]:
            scene.notes.append("no dead-man")
        scene.began_s = time.monotonic()
        for who, number in signals:
            for pid in pids[who]:
                os.kill(pid, number)
        time.sleep(watched_s)
        for pid in pids["dead-man"]:
            if Path(f"/proc/{pid}").exists():
                os.kill(pid, signal.SIGKILL)

    return deed


def _no_dead_man(scene: Scene) -> None:
    scene.began_s = time.monotonic()
    scene.process = start(scene.px4, scene.folder, "hover", "--no-dead-man")
    scene.wait(lambda: scene.ended, LIMIT_S)
    if scene.px4.armed:
        scene.notes.append("armed")


def _started_again(scene: Scene) -> None:
    """Killed; while the vehicle holds, the same command is given again."""
    scene.begin()
    _kill(scene)
    time.sleep(2.0)
    code = scene.beside("again").wait(LIMIT_S)
    if code != 1:
        scene.notes.append(f"the second one ended with {code}")


def _taken_by_sticks(number: int, wait_s: float, back_s: float = 0.0) -> Callable[[Scene], None]:
    """The pilot takes Position by sticks while the dead-man's Hold is on; `back_s`: the companion goes on then."""

    def deed(scene: Scene) -> None:
        scene.begin()
        assert scene.process is not None
        scene.began_s = time.monotonic()
        scene.process.send_signal(number)
        went_on = not back_s
        for count in range(round(6.0 / _STICK_S)):
            scene.px4.link.mav.manual_control_send(scene.px4.instance + 1, 0, 0, 500, 0, 0)
            if count in (round(wait_s / _STICK_S), round(wait_s / _STICK_S) + 5):
                scene.mode(*_POSITION)
            time.sleep(_STICK_S)
            if not went_on and time.monotonic() - scene.began_s > back_s:
                went_on = True
                scene.process.send_signal(signal.SIGCONT)
        if scene.px4.mode >> 16 & 0xFF != _POSITION[0]:
            scene.notes.append("Position was not kept")

    return deed


def _parameters_left(scene: Scene) -> None:
    """Killed with parameters set for the flight; the next run puts them back."""
    stood = scene.px4.param(_NOISE)
    scene.begin("--set-params", _PROFILE)
    during = scene.px4.param(_NOISE)
    _kill(scene)
    time.sleep(2.0)
    scene.mode(4.0, 6.0)
    scene.wait(lambda: not scene.px4.armed, 40.0)
    code = scene.beside("again", "--duration", "3").wait(LIMIT_S)
    if code or during == stood or scene.px4.param(_NOISE) != stood:
        scene.notes.append(f"{_NOISE} {stood:g}, {during:g}, then {scene.px4.param(_NOISE):g}; exit {code}")
    scene.began_s = time.monotonic() + 60.0  # arming again was meant


def _clock_jumps(seconds: float) -> Callable[[Scene], None]:
    """The companion's UTC jumps in flight."""

    def deed(scene: Scene) -> None:
        offset = scene.folder / "offset"
        offset.write_text("0")
        words = command(scene.px4, scene.folder, "figure8", "--duration", "20")
        at = words.index("-m")
        words[at : at + 2] = ["-c", _OTHER_TIME, str(offset)]
        said = (scene.folder / "companion.txt").open("wb")
        scene.process = subprocess.Popen(words, stdout=said, stderr=subprocess.STDOUT)
        scene.wait(lambda: scene.px4.height_m > 1.5 or scene.ended, LIMIT_S)
        time.sleep(5.0)
        scene.began_s = time.monotonic()
        offset.write_text(f"{seconds:g}")
        scene.wait(lambda: scene.ended, LIMIT_S)

    return deed


def _terminal_gone(scene: Scene) -> None:
    """Whoever reads what the companion says closes the pipe in flight."""
    words = command(scene.px4, scene.folder, "figure8", "--duration", "20")
    scene.process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    scene.wait(lambda: scene.px4.height_m > 1.5 or scene.ended, LIMIT_S)
    time.sleep(3.0)
    scene.began_s = time.monotonic()
    assert scene.process.stdout is not None
    scene.process.stdout.close()
    scene.wait(lambda: scene.ended, LIMIT_S)


def _folder_removed(scene: Scene) -> None:
    """The folder of log and report is removed in flight."""
    folder = scene.folder / "gone"
    folder.mkdir()
    scene.begin("--out", str(folder), "--json", str(folder / "flight.json"))
    scene.began_s = time.monotonic()
    shutil.rmtree(folder)
    scene.wait(lambda: scene.ended, LIMIT_S)


def _deaf_then_killed(scene: Scene) -> None:
    """Nothing comes from PX4 any more, 0.1 s later the companion is killed: the dead-man gets no answer."""
    with Relay(OFFBOARD_PORT + scene.px4.instance, Manner()) as relay:
        scene.begin("--connect", f"udpin:127.0.0.1:{relay.port}")
        relay.manner = Manner(down_cut=True)
        time.sleep(0.1)
        _kill(scene)
        time.sleep(8.0)


def _all_frozen(seconds: float) -> Callable[[Scene], None]:
    """Companion and dead-man stand still, as on a machine that is suspended."""

    def deed(scene: Scene) -> None:
        scene.begin()
        assert scene.process is not None
        pids = [scene.process.pid, *dead_men(scene.process.pid)]
        scene.began_s = time.monotonic()
        for number in (signal.SIGSTOP, signal.SIGCONT):
            for pid in pids:
                os.kill(pid, number)
            time.sleep(seconds if number == signal.SIGSTOP else 0.0)
        scene.wait(lambda: scene.ended, 60.0)

    return deed


def _given_back(scene: Scene) -> None:
    """Killed; the pilot gives OFFBOARD to nobody: PX4 refuses it, or leaves it within a second."""
    scene.begin()
    _kill(scene)
    time.sleep(2.0)
    scene.mode(float(OFFBOARD))
    time.sleep(5.0)


ATTACKS: dict[str, Attack] = {
    "killed in the climb, at 0.3 m": Attack(_killed_at(0.3), codes=(_KILLED,)),
    "killed in the climb, at 1 m": Attack(_killed_at(1.0), codes=(_KILLED,)),
    "killed in the first hover": Attack(_killed_at(1.2, 1.0), codes=(_KILLED,)),
    "killed 0.05 s after it was asked to land": Attack(_killed_while_landing(0.05), codes=(_KILLED,)),
    "killed while it lands": Attack(_killed_while_landing(3.0), codes=(_KILLED,)),
    "companion and dead-man killed": Attack(
        _both_killed(("dead-man", signal.SIGKILL), ("companion", signal.SIGKILL)), codes=(_KILLED,), soft=False
    ),
    "companion and dead-man killed, COM_OF_LOSS_T 0.2": Attack(
        _both_killed(("dead-man", signal.SIGKILL), ("companion", signal.SIGKILL)), codes=(_KILLED,),
        params=(("COM_OF_LOSS_T", 0.2), ("COM_OBL_RC_ACT", 5.0)),
    ),
    "the dead-man stopped, the companion killed": Attack(
        _both_killed(("dead-man", signal.SIGSTOP), ("companion", signal.SIGKILL)), codes=(_KILLED,), soft=False
    ),
    "COM_OF_LOSS_T 5, --no-dead-man": Attack(_no_dead_man, codes=(2,), params=(("COM_OF_LOSS_T", 5.0),)),
    "killed, started again while the vehicle holds": Attack(_started_again, codes=(_KILLED,)),
    "killed, the pilot takes Position by sticks 0.3 s later": Attack(
        _taken_by_sticks(signal.SIGKILL, 0.3), codes=(_KILLED,)
    ),
    "stopped for 0.4 s, the pilot takes Position by sticks within it": Attack(
        _taken_by_sticks(signal.SIGSTOP, 0.2, back_s=0.4)
    ),
    "killed, OFFBOARD chosen 2 s later": Attack(_given_back, codes=(_KILLED,), keeps=False),
    "killed with --set-params, the next run puts back": Attack(_parameters_left, codes=(_KILLED,)),
    "UTC jumps by an hour": Attack(_clock_jumps(3600.0), codes=(0,)),
    "UTC jumps back by a day": Attack(_clock_jumps(-86400.0), codes=(0,)),
    "nobody reads what it says any more": Attack(_terminal_gone, codes=(0,)),
    "the folder of the log removed": Attack(_folder_removed, codes=(0, 1)),
    "PX4 not heard, 0.1 s later killed": Attack(_deaf_then_killed, codes=(_KILLED,)),
    "both frozen for 0.3 s": Attack(_all_frozen(0.3), codes=(0, 1)),
    "both frozen for 3 s": Attack(_all_frozen(3.0), soft=False),
}  # fmt: skip
