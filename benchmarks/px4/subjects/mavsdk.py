"""MAVSDK-Python's script of `tests/client`, which flies our simulator in `make test`, on a real PX4."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import OFFBOARD_PORT, Px4

ASKED = (
    "The client's script: health, version, parameters, streams, take-off, offboard, Hold, Return, Land.  Left out are "
    "goto, orbit and set_home: MAVSDK 4.1 sends COMMAND_INT in a frame that PX4 answers with UNSUPPORTED_MAV_FRAME."
)
RUNS = 3
SCRIPT = Path(__file__).resolve().parents[3] / "tests" / "client" / "mavsdk_flight.py"
LIMIT_S = 300.0


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` times, each on a PX4 started anew."""
    steps, notes = 0, []
    for number in range(runs):
        with Px4(bench) as px4:
            address = f"udpin://127.0.0.1:{OFFBOARD_PORT + px4.instance}"
            done = subprocess.run(
                [sys.executable, SCRIPT, address, "--without-places"],
                capture_output=True, text=True, timeout=LIMIT_S, check=False,
            )  # fmt: skip
        said = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
        steps = len(said)
        if done.returncode:
            last = said[-1]["step"] if said else "nothing"
            notes.append(f"run {number}: after {last}: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
    return [Row("MAVSDK-Python 4", f"{runs - len(notes)} of {runs} to the end, {steps} steps", not notes, runs, notes)]
