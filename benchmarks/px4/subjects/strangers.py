"""What nobody had tried on a flight: radios that sleep, delays that wander, another system id, missions, lists."""

from __future__ import annotations

import time
from collections.abc import Callable

from pymavlink import mavutil

from benchmarks.px4.companion import start
from benchmarks.px4.deeds import Attack, flown
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner
from benchmarks.px4.scene import TRACK_S, Scene
from benchmarks.px4.subjects.attacks import ASKED as ASKED
from benchmarks.px4.subjects.interference import linked

RUNS = 1
_FENCE, _MISSION = 1, 0
PLACE = 47.3977420, 8.5455940
"""SIH's home."""


def run(bench: Bench, runs: int) -> list[Row]:
    """Every one `runs` times; `ATTACKS` in the environment names those to fly."""
    return flown(bench, runs, ATTACKS)


def _station(deed: Callable[[Scene], None]) -> Callable[[Scene], None]:
    """A ground station does something in flight."""

    def whole(scene: Scene) -> None:
        scene.begin()
        scene.began_s = time.monotonic()
        deed(scene)
        scene.wait(lambda: scene.ended, 60.0)

    return whole


def _lists(scene: Scene) -> None:
    for _ in range(20):
        scene.px4.link.mav.param_request_list_send(scene.px4.instance + 1, 1)
        time.sleep(0.3)


def _uploads(kind: int, command: int, *params: float) -> Callable[[Scene], None]:
    """Three items of a mission or of a fence far around, blindly one after the other; cleared again at the end."""

    def deed(scene: Scene) -> None:
        mav, system = scene.px4.link.mav, scene.px4.instance + 1
        mav.mission_count_send(system, 1, 3, kind)
        for number, (north, east) in enumerate(((0.01, 0.0), (-0.01, 0.01), (-0.01, -0.01))):
            time.sleep(0.3)
            place = int(1e7 * (PLACE[0] + north)), int(1e7 * (PLACE[1] + east)), 20.0
            mav.mission_item_int_send(system, 1, number, 3, command, 0, 1, *params, *place, kind)
        time.sleep(3.0)
        mav.mission_clear_all_send(system, 1, kind)

    return deed


def _fast_streams(scene: Scene) -> None:
    """Everything that PX4 has, as fast as it goes, on the station's link."""
    for number in (30, 31, 32, 33, 36, 74, 83, 85, 105, 147, 230, 331):
        scene.px4.command(mavutil.mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, float(number), 2_000.0)
        time.sleep(0.02)


def _wrong_start(*more: str) -> Callable[[Scene], None]:
    def deed(scene: Scene) -> None:
        scene.began_s = time.monotonic()
        scene.process = start(scene.px4, scene.folder, "figure8", "--duration", f"{TRACK_S:g}", *more)
        scene.wait(lambda: scene.ended, 60.0)

    return deed


_WANDERS = tuple((Manner(up_s=0.001 * ms, down_s=0.001 * ms), 2.0) for ms in (2, 4, 6, 8, 10, 12, 10, 8, 6, 4, 2, 0))
ATTACKS: dict[str, Attack] = {
    "a radio that sleeps for 20 ms": Attack(linked(Manner(), (Manner(burst_s=0.02), 30.0)), codes=(0, 1)),
    "a radio that sleeps for 40 ms": Attack(linked(Manner(), (Manner(burst_s=0.04), 30.0)), codes=(0, 1)),
    "a radio that sleeps for 100 ms": Attack(linked(Manner(), (Manner(burst_s=0.1), 30.0)), codes=(0, 1)),
    "a delay that wanders to 12 ms each way and back": Attack(linked(Manner(), *_WANDERS), codes=(0, 1)),
    "a delay that jumps to 15 ms each way": Attack(
        linked(Manner(), (Manner(up_s=0.015, down_s=0.015), 30.0)), codes=(0, 1)
    ),
    "15 ms each way from the start": Attack(linked(Manner(up_s=0.015, down_s=0.015)), codes=(0, 1)),
    "10 ms each way from the start": Attack(linked(Manner(up_s=0.01, down_s=0.01)), codes=(0, 1)),
    "system id 3": Attack(_station(lambda scene: None), codes=(0,), params=(("MAV_SYS_ID", 3.0),)),
    "parameters listed again and again": Attack(_station(_lists), codes=(0,)),
    "a mission uploaded and cleared in flight": Attack(
        _station(_uploads(_MISSION, 16, 0.0, 2.0, 0.0, 0.0)), codes=(0,)
    ),
    "a fence uploaded and cleared in flight": Attack(_station(_uploads(_FENCE, 5001, 3.0, 0.0, 0.0, 0.0)), codes=(0,)),
    "every stream at 500 Hz for the station": Attack(_station(_fast_streams), codes=(0, 1)),
    "a file of parameters that is missing": Attack(_wrong_start("--set-params", "missing.params"), codes=(2,)),
    "a site that is missing": Attack(_wrong_start("--site", "missing.toml"), codes=(2,)),
}
