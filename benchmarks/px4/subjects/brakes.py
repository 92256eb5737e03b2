"""The guard's own brake over a late link, by ground truth: the path leaves the envelope at speed, or a blow tips it."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from typing import NamedTuple

from benchmarks.px4.companion import start
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner, Relay
from benchmarks.px4.scene import SOFT_MPS, Scene, end, judge
from benchmarks.px4.station import OFFBOARD_PORT, Px4, Truth, log_folder

ASKED = (
    "A path leaves the guard's envelope (5 m across, or 5 m up) at speed, or roll torque acts the wrong way for a "
    "while, on a link that takes longer, each way by so much: the guard brakes, the flight is handed back (exit 1) "
    "and lands; tilt at most 45 degrees and at rest within 3 s (but for the blow), the ground met at 1.5 m/s at most.  "
    "`BRAKES` names some."
)
RUNS = 2
TILT_MAX_DEG, REST_MPS, REST_S = 45.0, 0.7, 3.0
LIMIT_S = 100.0
_REAL32 = 9
_PATH = """schema = "flightstack.scenario/1"
name = "leaves"
description = "leaves its envelope"
duration_s = 30.0

[trajectory]
{trajectory}

[limits]
radius_m = {radius_m:g}
height_m = {height_m:g}
"""
_EIGHT = 'kind = "figure8"\nlength_m = 8.0\nwidth_m = 4.0\nperiod_s = 13.0\nheight_m = 5.0'
_ACROSS = _PATH.format(trajectory=_EIGHT, radius_m=5.0, height_m=20.0)
_UP = _PATH.format(trajectory='kind = "hover"\nposition_m = [0.0, 0.0, -20.0]', radius_m=20.0, height_m=5.0)
_INSIDE = _PATH.format(trajectory=_EIGHT, radius_m=50.0, height_m=50.0)


class Way(NamedTuple):
    """How the brake is met."""

    path: str
    link: Manner
    crosses: Callable[[Truth], bool]
    """From here on it is looked at."""
    then: Manner | None = None
    """The link's manner just before."""
    blow_s: float = 0.0
    """For so long roll torque acts the wrong way."""


def _each(ms: float) -> Manner:
    return Manner(up_s=1e-3 * ms, down_s=1e-3 * ms)


def _across(sample: Truth) -> bool:
    return math.hypot(sample.north_m, sample.east_m) > 5.0


def _up(sample: Truth) -> bool:
    return sample.up_m > 5.0


def _under_way(sample: Truth) -> bool:
    return sample.up_m > 4.0 and math.hypot(sample.vel_n_mps, sample.vel_e_mps) > 2.5


WAYS: dict[str, Way] = {
    **{f"{ms:g}/{ms:g} ms, across": Way(_ACROSS, _each(ms), _across) for ms in (0, 15, 20)},
    "15/15 ms, 25/25 just before, across": Way(_ACROSS, _each(15), _across, _each(25)),
    **{f"{ms:g}/{ms:g} ms, up": Way(_UP, _each(ms), _up) for ms in (0, 15)},
    "15/15 ms, 25/25 just before, up": Way(_UP, _each(15), _up, _each(25)),
    **{f"{ms:g}/{ms:g} ms, a blow of {s:g} s": Way(_INSIDE, _each(ms), _under_way, blow_s=s)
       for ms in (0, 15) for s in (0.2, 0.5)},
    "15/15 ms, 25/25 just before, a blow of 0.5 s": Way(_INSIDE, _each(15), _under_way, _each(25), 0.5),
}  # fmt: skip


def run(bench: Bench, runs: int) -> list[Row]:
    """Every way `runs` times, each on a PX4 of its own."""
    wanted = os.environ.get("BRAKES", "").split(",")
    return [_row(bench, name, way, runs) for name, way in WAYS.items() if any(word in name for word in wanted)]


def _row(bench: Bench, name: str, way: Way, runs: int) -> Row:
    notes, told = [], []
    for number in range(runs):
        folder = log_folder(bench, "brake-" + "-".join(name.replace("/", " ").replace(",", "").split()))
        with Px4(bench) as px4, Relay(OFFBOARD_PORT + px4.instance, way.link) as relay:
            scene = Scene(bench, px4, folder)
            try:
                _fly(scene, relay, way)
                codes = (0, 1) if way.blow_s else (1,)  # a short blow is flown out
                wrong, seen = judge(scene, codes, keeps=True, soft=True)
                more, words = _brake(scene.began_s, px4.truth, blow=way.blow_s > 0.0)
            finally:
                end(scene)
        wrong += more
        told.append(f"{words}; {seen}")
        print(f"{name}: {'; '.join(wrong) or 'good'} | {told[-1]}", flush=True)
        notes += [f"run {number}: {'; '.join(wrong)}; {told[-1]}"] if wrong else []
    return Row(name, " / ".join(told), not notes, runs, notes)


def _fly(scene: Scene, relay: Relay, way: Way) -> None:
    file = scene.folder / "leaves.toml"
    file.write_text(way.path)
    scene.process = start(scene.px4, scene.folder, str(file), "--connect", f"udpin:127.0.0.1:{relay.port}")
    near = _nearly(way.crosses)
    scene.wait(lambda: scene.ended or near(scene.px4.truth[-1]), LIMIT_S)
    relay.manner = way.then or relay.manner
    if not scene.wait(lambda: scene.ended or way.crosses(scene.px4.truth[-1]), LIMIT_S) or scene.ended:
        scene.notes.append("never got there")
    scene.began_s = time.monotonic()
    if way.blow_s:
        blow(scene, way.blow_s)
    scene.wait(lambda: scene.ended, LIMIT_S)


def blow(scene: Scene, seconds: float) -> None:
    """Roll torque acts the wrong way for so long; not for 0.3 s, when PX4 writes its parameters to its disk and would
    stand still if one changed meanwhile."""
    for arm_m in (-0.2, 0.2):
        scene.px4.link.mav.param_set_send(scene.px4.instance + 1, 1, b"SIH_L_ROLL", arm_m, _REAL32)
        time.sleep(seconds)
    scene.px4.set_param("SIH_L_ROLL", 0.2)


def _nearly(crosses: Callable[[Truth], bool]) -> Callable[[Truth], bool]:
    """Where it would cross a quarter of a second later."""

    def near(t: Truth) -> bool:
        s = 0.25
        north_m, east_m = t.north_m + s * t.vel_n_mps, t.east_m + s * t.vel_e_mps
        return crosses(t._replace(north_m=north_m, east_m=east_m, up_m=t.up_m - s * t.vel_d_mps))

    return near


def _brake(began_s: float, truth: list[Truth], *, blow: bool) -> tuple[list[str], str]:
    """What was wrong with it, and its figures."""
    after = [each for each in truth if each.at_s >= began_s]
    if not after:
        return ["nothing seen"], ""
    first = after[0]
    speed = [(each.at_s - began_s, math.hypot(each.vel_n_mps, each.vel_e_mps)) for each in after]
    rest_s = next((at for at, mps in speed if mps < REST_MPS), math.inf)
    tilt_deg = max(math.degrees(each.tilt_rad) for each in after if each.at_s < began_s + REST_S)
    braked = [each for each in after if each.at_s < began_s + 1.5]  # later PX4's Land drifts with its estimate
    past_m = max(math.hypot(each.north_m - first.north_m, each.east_m - first.east_m) for each in braked)
    lost_m = first.up_m - min(each.up_m for each in braked)
    touch_mps = max((each.vel_d_mps for each in after if each.up_m < 0.1), default=0.0)
    words = (
        f"at {speed[0][1]:.1f} m/s, tilt {tilt_deg:.0f} ({math.degrees(first.tilt_rad):.0f} before), {past_m:.1f} m "
        f"on and {lost_m:.1f} m lost in 1.5 s, up to {max(each.up_m for each in after):.1f} m, slow after {rest_s:.1f} "
        f"s, touched at {touch_mps:.1f} m/s"
    )
    wrong = [] if blow or tilt_deg <= TILT_MAX_DEG else ["tilt"]
    wrong += [] if blow or rest_s <= REST_S else ["did not come to rest"]
    wrong += [] if touch_mps <= SOFT_MPS else ["hard ground"]
    return wrong, words
