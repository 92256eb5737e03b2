"""The shield between a real PX4 and a stranger's program (`tests/client/shielded_program.py`), by ground truth."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.px4.companion import MASS_KG, light_vehicle
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4, log_folder
from benchmarks.px4.subjects.kills import LOST_MAX_M

ASKED = (
    "A program races at 4 m/s behind the shield, PX4 at default parameters but for a mass of 0.7 kg (at 1 kg its "
    "thrust is too little for a certificate from the prior). The shield killed, stopped for 0.3 s or ended by SIGTERM: "
    "height lost 0.8 m at worst (tilts are the program's own, and how fast PX4's Hold comes to rest is its own); added "
    "latency p99 1 ms."
)
RUNS = 3
SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 20.0
inside = [[-30.0, -20.0], [30.0, -20.0], [30.0, 20.0], [-30.0, 20.0]]
"""
_PORT = 14640
_PROGRAM = Path(__file__).parents[3] / "tests" / "client" / "shielded_program.py"
_KILLED, _STOPPED, _ENDED = _DEEDS = ("killed", "stopped for 0.3 s", "ended by SIGTERM")
_WATCH_S, _REST_S, _LIMIT_S = 1.0, 9.0, 60.0


def run(bench: Bench, runs: int) -> list[Row]:
    """Every deed `runs` times, each on a PX4 of its own."""
    return [_row(deed, [_flight(bench, deed) for _ in range(runs)]) for deed in _DEEDS]


def _row(deed: str, seen: list[dict[str, float]]) -> Row:
    before, tilt, lost = (max(each[name] for each in seen) for name in ("before_deg", "tilt_deg", "lost_m"))
    rest, late = max(each["rest_mps"] for each in seen), [each["p99_us"] for each in seen if "p99_us" in each]
    words = f"tilt {tilt:.0f} degrees ({before:.0f} before), {max(lost, 0.0):.2f} m lost"
    words += f", {rest:.2f} m/s after {_REST_S:g} s"
    good = lost <= LOST_MAX_M
    if late:
        words += f"; added latency p99 {max(late):.0f} us"
        good = good and max(late) <= 1000.0
    return Row(f"shield {deed}, worst", words, good, len(seen))


def _flight(bench: Bench, deed: str) -> dict[str, float]:
    folder = log_folder(bench, "shield")
    (folder / "field.toml").write_text(SITE)
    with Px4(bench, params={"SIH_MASS": MASS_KG}) as px4:
        words = [*bench.prefix, sys.executable, "-m", "flightstack", "shield", "--connect", px4.address]
        words += ["--serve", f"udpout:127.0.0.1:{_PORT}", "--site", str(folder / "field.toml")]
        words += [
            "--vehicle",
            str(light_vehicle(folder)),
            "--sensors",
            "px4-sih-ekf",
            "--json",
            str(folder / "shield.json"),
        ]
        shield = subprocess.Popen(words, stdout=(folder / "shield.txt").open("wb"), stderr=subprocess.STDOUT)
        said = (folder / "program.txt").open("wb")
        program = subprocess.Popen([sys.executable, str(_PROGRAM), f"udpin:127.0.0.1:{_PORT}", "8"], stdout=said)
        try:
            if not px4.wait(lambda: bool(px4.truth) and px4.truth[-1].vel_n_mps > 3.0, _LIMIT_S):
                raise RuntimeError(f"the program never got fast: see {folder}")
            began_s = time.monotonic()
            _do(deed, shield, px4)
            time.sleep(_REST_S)
        finally:
            program.kill()
            shield.terminate()
            shield.wait(10.0)
        return _seen(px4, began_s, folder / "shield.json")


def _do(deed: str, shield: subprocess.Popen[bytes], px4: Px4) -> None:
    if deed == _KILLED:
        shield.kill()
    elif deed == _ENDED:
        shield.terminate()
    else:  # afterwards the program flies on: then it is ended
        os.kill(shield.pid, signal.SIGSTOP)
        time.sleep(0.3)
        os.kill(shield.pid, signal.SIGCONT)
        px4.wait(lambda: px4.truth[-1].vel_n_mps < -2.0, _LIMIT_S)
        shield.terminate()


def _seen(px4: Px4, began_s: float, result: Path) -> dict[str, float]:
    before = [sample for sample in px4.truth if sample.at_s <= began_s][-1]
    after = [sample for sample in px4.truth if began_s < sample.at_s <= began_s + _WATCH_S]
    last = px4.truth[-1]
    seen = {
        "before_deg": math.degrees(before.tilt_rad),
        "tilt_deg": math.degrees(max(sample.tilt_rad for sample in after)),
        "lost_m": before.up_m - min(sample.up_m for sample in after),
        "rest_mps": float(np.linalg.norm([last.vel_n_mps, last.vel_e_mps, last.vel_d_mps])),
    }
    if result.exists():
        seen["p99_us"] = float(json.loads(result.read_text())["added_latency_us"]["p99"])
    print(seen, flush=True)
    return seen
