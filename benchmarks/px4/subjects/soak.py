"""figure8 for half an hour at normal priority, beside whatever else runs: is a flight ended by load?"""

from __future__ import annotations

import json
import os
from dataclasses import replace

from benchmarks.px4.companion import start
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4, log_folder

ASKED = (
    "figure8 without the permission for another priority (`setpriv` takes it away), 30 min (`SOAK_S` seconds) beside a "
    "load of two: no flight is ended."
)
RUNS = 1
SECONDS = float(os.environ.get("SOAK_S", "1800"))
_NORMAL = ("setpriv", "--inh-caps=-sys_nice", "--bounding-set=-sys_nice", "chrt", "-o", "0")
_BESIDE_S = 120.0
"""Start, take-off, landing."""
_SHORTEST_S = 30.0
_ENDED_MOST = 10


def run(bench: Bench, runs: int) -> list[Row]:
    """Flights one after the other until they make up the time; each that is ended begins another."""
    return [_soak(replace(bench, prefix=_NORMAL)) for _ in range(runs)]


def _soak(bench: Bench) -> Row:
    notes, left_s, flown, stalls, taken_back = [], SECONDS, 0, [0.0], 0
    loads = []
    while left_s > _SHORTEST_S and len(notes) < _ENDED_MOST:
        flown += 1
        with Px4(bench) as px4:
            folder = log_folder(bench, "soak")
            process = start(px4, folder, "figure8", "--duration", f"{left_s:g}", "--unprotected-ok")
            px4.wait(lambda: process.poll() is not None, left_s + _BESIDE_S)  # noqa: B023  waited for here
            code = process.wait(_BESIDE_S)
        loads.append(os.getloadavg()[1])
        file = folder / "flight.json"
        result = json.loads(file.read_text()) if file.exists() else {}
        left_s -= max(result.get("flight_time_s") or 0.0, 1.0)
        loop = result.get("loop", {})
        stalls += [stall["s"] for stall in loop.get("stalls") or []]
        taken_back += (loop.get("dead_man") or {}).get("taken_back") or 0
        if code:
            notes.append(f"{left_s:.0f} s before the end: {result.get('reason') or 'no result'}")
    measured = (
        f"{SECONDS:.0f} s in {flown} flights, {len(notes)} of them ended; longest stall {1e3 * max(stalls):.0f} ms, "
        f"{taken_back} taken back; load (5 min) {min(loads):.1f} to {max(loads):.1f}"
    )
    return Row("figure8 at normal priority", measured, not notes, 1, notes)
