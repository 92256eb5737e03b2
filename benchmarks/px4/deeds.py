"""What outsiders do to a flight, as makers of deeds; an `Attack` says what may follow, `row` flies it."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

from benchmarks.px4.companion import command
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.scene import AIRBORNE_M, OFFBOARD, Scene, end, judge
from benchmarks.px4.station import Px4, log_folder

ARM = 400
HOLD, RETURN, LAND, TAKEOFF = (4.0, 3.0), (4.0, 5.0), (4.0, 6.0), (4.0, 2.0)


class Attack(NamedTuple):
    """What is done, and what is allowed to follow."""

    deed: Callable[[Scene], None]
    codes: tuple[int, ...] = (1,)
    """Exit codes that are right."""
    keeps: bool = True
    """PX4 may not be in OFFBOARD at the end of the deed's time, nor armed again."""
    soft: bool = True
    """The ground is to be met gently."""
    params: tuple[tuple[str, float], ...] = ()
    kind: str = "sih"
    """Of PX4: `hil` has our plant behind it, whose sensors can fail."""
    env: tuple[tuple[str, str], ...] = ()
    """Of PX4's process besides: its place, its pace, its airframe."""


def flown(bench: Bench, runs: int, attacks: Mapping[str, Attack]) -> list[Row]:
    """Every attack `runs` times; `ATTACKS` in the environment names those to fly."""
    wanted = os.environ.get("ATTACKS", "").split(",")
    return [_row(bench, name, attack, runs) for name, attack in attacks.items() if any(word in name for word in wanted)]


def _row(bench: Bench, name: str, attack: Attack, runs: int) -> Row:
    notes, seen = [], ""
    for number in range(runs):
        folder = log_folder(bench, "attack-" + "-".join(name.replace("/", " ").split()))
        with Px4(bench, attack.kind, params=dict(attack.params), env=dict(attack.env)) as px4:
            scene = Scene(bench, px4, folder)
            try:
                attack.deed(scene)
                wrong, seen = judge(scene, attack.codes, keeps=attack.keeps, soft=attack.soft)
            finally:
                end(scene)
        print(f"{name}: {'; '.join(wrong) or 'good'} | {seen}", flush=True)
        notes += [f"run {number}: {'; '.join(wrong)}; {seen}"] if wrong else []
    return Row(name, seen, not notes, runs, notes)


def chosen(*modes: tuple[float, float], apart_s: float = 0.2, watched_s: float = 5.0) -> Callable[[Scene], None]:
    """A ground station chooses modes one after the other."""

    def deed(scene: Scene) -> None:
        scene.begin()
        scene.began_s = time.monotonic()
        for main, sub in modes:
            scene.mode(main, sub)
            time.sleep(apart_s)
        time.sleep(watched_s)

    return deed


def commanded(*commands: tuple[float, ...], apart_s: float = 0.5) -> Callable[[Scene], None]:
    """Commands of a ground station one after the other."""

    def deed(scene: Scene) -> None:
        scene.begin()
        scene.began_s = time.monotonic()
        for number, *params in commands:
            scene.px4.command(int(number), *params)
            time.sleep(apart_s)

    return deed


def parameters_set(*params: tuple[str, float], watched_s: float = 60.0) -> Callable[[Scene], None]:
    """Parameters set in flight."""

    def deed(scene: Scene) -> None:
        scene.begin()
        scene.began_s = time.monotonic()
        for name, value in params:
            scene.px4.set_param(name, value)
        scene.wait(lambda: scene.ended, watched_s)

    return deed


def signalled(*signals: tuple[int, float]) -> Callable[[Scene], None]:
    """Signals to the companion, each followed by a wait."""

    def deed(scene: Scene) -> None:
        scene.begin()
        scene.began_s = time.monotonic()
        for number, wait_s in signals:
            assert scene.process is not None
            scene.process.send_signal(number)
            time.sleep(wait_s)

    return deed


def px4_signalled(*signals: tuple[int, float], anew: bool = False, arm: bool = True) -> Callable[[Scene], None]:
    """Signals to PX4's process; `anew`: started again after it; without `arm`, while the companion waits."""

    def deed(scene: Scene) -> None:
        if arm:
            scene.begin()
        else:
            wait_for_pilot(scene)
        scene.began_s = time.monotonic()
        for number, wait_s in signals:
            scene.px4.signal(number)
            time.sleep(wait_s)
        if anew:
            scene.px4.restart()
            if not arm:
                pilot_takes_off(scene)
        scene.wait(lambda: scene.ended, 30.0)

    return deed


def wait_for_pilot(scene: Scene, seconds: float = 8.0) -> None:
    """A companion that waits for the pilot to arm."""
    words = command(scene.px4, scene.folder, "hover", arm=False)
    scene.process = subprocess.Popen(
        words, stdout=(scene.folder / "companion.txt").open("wb"), stderr=subprocess.STDOUT
    )
    time.sleep(seconds)


def pilot_takes_off(scene: Scene) -> None:
    """OFFBOARD and arming by the pilot."""
    for _ in range(20):
        scene.mode(float(OFFBOARD))
        time.sleep(0.2)
        scene.px4.command(ARM, 1.0, 0.0)
        if scene.wait(lambda: scene.px4.armed, 1.0):
            break


def while_waiting(deed: Callable[[Scene], None]) -> Callable[[Scene], None]:
    """Something happens while the companion waits; then the pilot takes off."""

    def whole(scene: Scene) -> None:
        wait_for_pilot(scene)
        scene.began_s = time.monotonic()
        deed(scene)
        time.sleep(0.5)
        if not scene.ended:
            pilot_takes_off(scene)
        scene.wait(lambda: scene.ended, 60.0)

    return whole


def already_flying(*modes: tuple[float, float], arm: bool, offboard_after_s: float = 0.0) -> Callable[[Scene], None]:
    """The pilot flies before the companion is started, perhaps gives it the vehicle later."""

    def deed(scene: Scene) -> None:
        scene.mode(*TAKEOFF)
        time.sleep(0.3)
        scene.px4.command(ARM, 1.0, 0.0)
        if not scene.wait(lambda: scene.px4.height_m > AIRBORNE_M, 30.0):
            scene.notes.append("the pilot did not take off")
        time.sleep(4.0)
        for main, sub in modes:
            scene.mode(main, sub)
            time.sleep(0.3)
        scene.began_s = time.monotonic()
        words = command(scene.px4, scene.folder, "hover", arm=arm)
        scene.process = subprocess.Popen(
            words, stdout=(scene.folder / "companion.txt").open("wb"), stderr=subprocess.STDOUT
        )
        scene.wait(lambda: scene.ended, offboard_after_s or 10.0)
        if offboard_after_s:
            scene.began_s = time.monotonic() + 60.0  # what the modes did until then was meant
            scene.mode(float(OFFBOARD))
            scene.wait(lambda: scene.ended, 60.0)
        elif not scene.ended:
            scene.process.send_signal(signal.SIGINT)

    return deed
