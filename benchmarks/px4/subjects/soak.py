"""figure8 and hover by turns for half an hour at normal priority beside two busy loops: is a flight ended by load?

Nobody has a priority of its own: PX4, companion, dead-man and this driver run without the permission for one.
Companion, PX4 and each busy loop have a session of their own, as services have and what is started in other terminals:
Linux shares processors among sessions first.
With `SOAK_PX4=real-time` PX4 keeps its priority, as on a board of its own: starved, it loses its simulated sensors.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from benchmarks.px4.companion import start
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4, log_folder

ASKED = (
    "figure8 and hover by turns for 30 min (`SOAK_S` seconds of flight), companion and PX4 without the permission for "
    "another priority (`setpriv` takes it away), beside two busy loops (`SOAK_BUSY`): no flight is ended."
)
RUNS = 1
SECONDS = float(os.environ.get("SOAK_S", "1800"))
BUSY = int(os.environ.get("SOAK_BUSY", "2"))
PX4_NORMAL = os.environ.get("SOAK_PX4", "normal") == "normal"
FLIGHT_S = 300.0
"""Of a scenario; take-off and landing come to it."""
_NORMAL = ("setsid", "setpriv", "--inh-caps=-sys_nice", "--bounding-set=-sys_nice", "chrt", "-o", "0")
_SPINS = "while True: pass"
_BESIDE_S = 300.0
"""Start, take-off, landing; a PX4 on a busy machine flies slower than the wall's clock."""
_SHORTEST_S = 30.0
_ENDED_MOST = 10
_SCENARIOS = ("figure8", "hover")


@dataclass(frozen=True, slots=True)
class Flight:
    """What became of one."""

    scenario: str
    exit_code: int
    reason: str
    flight_time_s: float
    load: float
    """Of the last minute, at the end."""
    rate_hz: float | None
    lateness_us: dict[str, float] = field(default_factory=dict)
    missed: int = 0
    stalls: list[dict[str, Any]] = field(default_factory=list)
    dead_man: dict[str, Any] = field(default_factory=dict)


def run(bench: Bench, runs: int) -> list[Row]:
    """Flights one after the other until they make up the time; each that is ended begins another."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # started in real time, its threads would be, too
    normal = replace(bench, prefix=_NORMAL, px4_prefix=_NORMAL if PX4_NORMAL else ("setsid", "chrt", "-f", "10"))
    with _busy():
        return [_soak(normal) for _ in range(runs)]


@contextmanager
def _busy() -> Iterator[None]:
    command = [*_NORMAL, sys.executable, "-c", _SPINS]
    loops = [subprocess.Popen(command) for _ in range(BUSY)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def _soak(bench: Bench) -> Row:
    flights: list[Flight] = []
    left_s = SECONDS
    while left_s > _SHORTEST_S and sum(flight.exit_code != 0 for flight in flights) < _ENDED_MOST:
        flights.append(_fly(bench, _SCENARIOS[len(flights) % len(_SCENARIOS)], min(left_s, FLIGHT_S)))
        left_s -= max(flights[-1].flight_time_s, 1.0)
        print(flights[-1], flush=True)
        (bench.out / "soak.json").write_text(json.dumps([asdict(flight) for flight in flights], indent=1))
    return _row(flights)


def _fly(bench: Bench, scenario: str, seconds: float) -> Flight:
    with Px4(bench) as px4:
        folder = log_folder(bench, "soak")
        process = start(px4, folder, scenario, "--duration", f"{seconds:g}", "--unprotected-ok")
        px4.wait(lambda: process.poll() is not None, seconds + _BESIDE_S)
        code = process.wait(_BESIDE_S)
    file = folder / "flight.json"
    result = json.loads(file.read_text()) if file.exists() else {}
    loop = result.get("loop", {})
    return Flight(
        scenario,
        code,
        (result.get("reason") or "no result") if code else "",
        result.get("flight_time_s") or 0.0,
        os.getloadavg()[0],
        loop.get("rate_hz"),
        loop.get("lateness_us") or {},
        loop.get("missed") or 0,
        loop.get("stalls") or [],
        loop.get("dead_man") or {},
    )


def _row(flights: list[Flight]) -> Row:
    ended = [flight for flight in flights if flight.exit_code]
    longest = max((stall["s"] for flight in flights for stall in flight.stalls), default=0.0)
    acted = sum(flight.dead_man.get("acted", 0) for flight in flights)
    taken_back = sum(flight.dead_man.get("taken_back", 0) for flight in flights)
    late = [flight.lateness_us["p99"] for flight in flights if "p99" in flight.lateness_us]
    flown_s = sum(flight.flight_time_s for flight in flights)
    measured = (
        f"{flown_s:.0f} s in {len(flights)} flights, {len(ended)} of them ended; the dead-man acted {acted} times, "
        f"{taken_back} taken back; longest stall {1e3 * longest:.0f} ms, lateness p99 at worst "
        f"{1e-3 * max(late, default=0.0):.1f} ms; load (1 min) {min(each.load for each in flights):.1f} to "
        f"{max(each.load for each in flights):.1f}"
    )
    notes = [f"{flight.scenario}, {flight.flight_time_s:.0f} s: {flight.reason}" for flight in ended]
    px4 = "" if PX4_NORMAL else ", PX4 in real time"
    return Row(f"normal priority, {BUSY} busy loops{px4}", measured, not ended, 1, notes)
