"""The companion's death and stalls about lift-off: at random moments from the first turn of the motors to 2 m."""

from __future__ import annotations

import json
import math
import os
import random
import signal
import subprocess
import time
from typing import NamedTuple

import numpy as np

from benchmarks.px4.companion import start
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4, Truth, log_folder
from benchmarks.px4.subjects.kills import OFFBOARD_MAIN, bring_down

ASKED = (
    "figure8 at default parameters, the companion killed (SIGKILL) or stopped for 0.1 to 1 s (SIGSTOP) in the climb to "
    "2 m: half of the moments within 4 s of the motors' first turn, half in 0.2 to 1.4 s, where the vehicle leaves the "
    "ground.  Until it is told to land no ground contact harder than 0.5 m/s, tilt at most 35 degrees."
)
RUNS = 12
TILT_MAX_DEG, CONTACT_MAX_MPS = 35.0, 0.5
SHORT_S = 0.4
"""Stalls below are taken back (the rule's 0.5 s, less what noticing takes)."""
STALL_S = (0.1, 1.0)
CLIMB_S, LEAVES_S = (0.0, 4.0), (0.2, 1.4)
"""Seconds after the first motor turns."""
_WATCH_S = 5.0
_NEAR_M = 0.1
_READY_LIMIT_S = 60.0
_RESULT = "seen.json"


class Seen(NamedTuple):
    """Ground truth from a moment on."""

    moment_s: float
    """After the first motor turned."""
    stall_s: float
    """Infinite: killed."""
    height_m: float
    """At the moment."""
    climb_mps: float
    tilt_deg: float
    """Greatest until told to land, and that of the landing."""
    landing_tilt_deg: float
    contact_mps: float
    """Fastest sink rate near the ground until told to land."""
    highest_m: float
    mode: int
    """PX4's main mode before it is told to land."""
    said: str


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` kills and `runs` stalls by turns on one PX4; those that a folder holds already are not flown again."""
    seen = [Seen(**json.loads(file.read_text())) for file in sorted(bench.out.glob(f"lift-off-*/{_RESULT}"))]
    draw = random.Random(len(seen))
    with Px4(bench) as px4:
        while len(seen) < 2 * runs:
            stall_s = math.inf if len(seen) % 2 == 0 else draw.uniform(*STALL_S)
            span = CLIMB_S if len(seen) % 4 < 2 else LEAVES_S
            seen.append(_trial(bench, px4, draw.uniform(*span), stall_s))
            print(seen[-1], flush=True)
    short = [each for each in seen if each.stall_s < SHORT_S]
    back = sum(each.mode == OFFBOARD_MAIN for each in short)
    return [
        _row("killed (SIGKILL)", [each for each in seen if math.isinf(each.stall_s)]),
        _row("stopped for 0.1 to 1 s (SIGSTOP)", [each for each in seen if math.isfinite(each.stall_s)]),
        Row(
            f"stalls below {SHORT_S:g} s, in OFFBOARD {_WATCH_S:g} s later", f"{back} of {len(short)}", None, len(short)
        ),
    ]


def _row(what: str, trials: list[Seen]) -> Row:
    tilt, contact = (np.array([getattr(seen, name) for seen in trials]) for name in ("tilt_deg", "contact_mps"))
    heights = sorted(seen.height_m for seen in trials)
    measured = (
        f"at {heights[0]:.2f} to {heights[-1]:.2f} m (median {np.median(heights):.2f}); hardest contact "
        f"{contact.max():.2f} m/s; tilt median {np.median(tilt):.0f}, worst {tilt.max():.0f} degrees, landing "
        f"{max(seen.landing_tilt_deg for seen in trials):.0f}"
    )
    notes = [f"run {number}: {seen}" for number, seen in enumerate(trials) if not _is_good(seen)]
    return Row(what, measured, not notes, len(trials), notes)


def _is_good(seen: Seen) -> bool:
    return max(seen.tilt_deg, seen.landing_tilt_deg) <= TILT_MAX_DEG and seen.contact_mps <= CONTACT_MAX_MPS


def _trial(bench: Bench, px4: Px4, moment_s: float, stall_s: float) -> Seen:
    folder = log_folder(bench, "lift-off")
    process = start(px4, folder, "figure8")
    try:
        if not px4.wait(lambda: px4.spins or process.poll() is not None, _READY_LIMIT_S) or process.poll() is not None:
            raise RuntimeError(f"the flight did not begin: see {folder}/companion.txt")
        time.sleep(moment_s)
        began_s = time.monotonic()
        os.kill(process.pid, signal.SIGKILL if math.isinf(stall_s) else signal.SIGSTOP)
        if math.isfinite(stall_s):
            time.sleep(stall_s)
            os.kill(process.pid, signal.SIGCONT)
        time.sleep(_WATCH_S)
        told_s, mode = time.monotonic(), px4.mode >> 16 & 0xFF
    finally:
        _let_go(process)
        bring_down(px4, process)
    said = " ".join((folder / "companion.txt").read_text().split())[-200:]
    seen = _judge(list(px4.truth), (began_s, told_s), moment_s, stall_s)._replace(mode=mode, said=said)
    (folder / _RESULT).write_text(json.dumps(seen._asdict()))
    return seen


def _let_go(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGCONT)


def _judge(truth: list[Truth], watched: tuple[float, float], moment_s: float, stall_s: float) -> Seen:
    began_s, told_s = watched
    before = [each for each in truth if each.at_s <= began_s][-1]
    after = [each for each in truth if began_s < each.at_s <= told_s]
    landing = [each.tilt_rad for each in truth if each.at_s > told_s]
    ground_m = [each.up_m for each in truth if each.at_s < began_s - moment_s][-1]  # that of the last landing
    return Seen(
        moment_s,
        stall_s,
        before.up_m - ground_m,
        -before.vel_d_mps,
        math.degrees(max(each.tilt_rad for each in after)),
        math.degrees(max(landing, default=0.0)),
        max((each.vel_d_mps for each in after if each.up_m - ground_m < _NEAR_M), default=0.0),
        max(each.up_m for each in after) - ground_m,
        0,
        "",
    )
