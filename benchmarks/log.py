"""What logs cost: writing in a tick, the live view beside it, reading ten minutes into arrays.

    python -m benchmarks.log        all rows, into docs/logs.md (make bench-log)

Writing: figure8 at 250 Hz of real time with learner and filter, everything logged; the wall time of all that the
flight's thread does for the log in one tick.  Live: the processor time of the threads that it brings, in a hover at
250 Hz of real time whose page is polled ten times a second.  (That of the whole process differs by more from flight to
flight.)  Reading: this package's own log of `rotor-drag`, ten minutes.  Nothing else should be running.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import campaign
from flightstack.cli import flight
from flightstack.cli.flight import FlyOptions, fly
from flightstack_logs.reader import read
from flightstack_logs.writer import Recorder

_BEGIN, _END = "<!-- log: begin -->", "<!-- log: end -->"
_LONG_S, _WRITTEN_S, _WATCHED_S, _RUNS = 590.0, 54.0, 20.0, 3  # 54 s of track are 75 s of log
_PORT = 8795
_BROWSER = """
import http.client, sys, time
page = http.client.HTTPConnection("127.0.0.1", int(sys.argv[1]), timeout=1.0)  # kept, as by a browser
while True:
    time.sleep(0.1)
    try:
        page.request("GET", "/state")
        page.getresponse().read()
    except (OSError, http.client.HTTPException):
        page.close()
"""


class Timed:
    """A recorder that counts what each tick of the flight spends in it."""

    def __init__(self, log: Recorder) -> None:
        self._log, self._spent = log, 0.0
        self.ticks: list[float] = []

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._log, name)
        return self._timed(name, found) if callable(found) else found

    def _timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **named: Any) -> Any:
            began = time.perf_counter()
            try:
                return call(*arguments, **named)
            finally:
                self._spent += time.perf_counter() - began
                if name == "tick":
                    self.ticks.append(self._spent)
                    self._spent = 0.0

        self.__dict__[name] = timed
        return timed


def writing(folder: Path) -> str:
    """What a tick spends for the log."""
    kept: list[Timed] = []

    def timed(recorder: Any, port: int | None) -> Any:
        kept.append(Timed(recorder))
        return kept[-1]

    usual, flight.shown_live = flight.shown_live, timed  # type: ignore[attr-defined]
    options = FlyOptions(scenario="figure8", duration_s=_WRITTEN_S, realtime=True, out=folder / "written")
    try:
        result = fly(options, stop_requested=lambda: "")
    finally:
        flight.shown_live = usual  # type: ignore[attr-defined]
    assert result.completed, result.reason
    us = 1e6 * np.array(kept[-1].ticks)
    path = folder / "written" / "flight.mcap"
    written, lasted_s = path.stat().st_size * 1e-6, read(path).span_us[1] * 1e-6
    median, late = np.median(us), np.quantile(us, 0.99)
    return (
        f"| a tick of figure8 in real time, all topics, {len(us)} ticks | {median:.0f} us median, {late:.0f} us p99; "
        f"{written:.1f} MB for {lasted_s:.0f} s | 20 us p99, 6 MB |"
    )


def watched(folder: Path) -> str:
    """What the live view takes: processor time of the threads that it brings, of a hover at 250 Hz of real time."""
    shares = [_watched_share(folder / f"live-{run}") for run in range(_RUNS)]
    least, most = min(shares), max(shares)
    return f"| live view, page polled at 10 Hz | {least:.1f} to {most:.1f} % of a core, {_RUNS} flights | 1 % |"


def _watched_share(out: Path) -> float:
    marks: list[tuple[float, dict[str, float]]] = []
    usual = flight.shown_live  # type: ignore[attr-defined]

    def shown(recorder: Any, port: int | None) -> Any:
        before = _threads_s()
        live: Any = usual(recorder, port)
        marks.append((time.perf_counter(), dict.fromkeys(_threads_s().keys() - before.keys(), 0.0)))
        ending = live.close

        def close() -> None:
            marks.append((time.perf_counter(), _threads_s()))
            ending()

        live.close = close
        return live

    flight.shown_live = shown  # type: ignore[attr-defined]
    browser = subprocess.Popen([sys.executable, "-c", _BROWSER, str(_PORT + 1)])
    try:
        options = FlyOptions(scenario="hover", duration_s=_WATCHED_S, realtime=True, out=out, live=_PORT)
        result = fly(options, stop_requested=lambda: "")
    finally:
        browser.kill()
        browser.wait()
        flight.shown_live = usual  # type: ignore[attr-defined]
    assert result.completed, result.reason
    (began_s, brought), (ended_s, spent) = marks
    return 100.0 * sum(spent.get(name, 0.0) for name in brought) / (ended_s - began_s)


def _threads_s() -> dict[str, float]:
    """Processor time of each thread of this process, by its number."""
    found = {}
    for stat in Path("/proc/self/task").glob("*/stat"):
        fields = stat.read_text().rpartition(")")[2].split()
        found[stat.parent.name] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return found


def reading(folder: Path) -> str:
    """Ten minutes into arrays."""
    fly(FlyOptions(scenario="rotor-drag", duration_s=_LONG_S, out=folder / "long"), stop_requested=lambda: "")
    path, took = folder / "long" / "flight.mcap", []
    for _ in range(_RUNS):
        began = time.perf_counter()
        log = read(path)
        took.append(time.perf_counter() - began)
    rows = sum(len(table) for table in log.tables.values())
    size, least, most = path.stat().st_size * 1e-6, min(took), max(took)
    return f"| ten minutes read into arrays, {size:.0f} MB, {rows} rows | {least:.2f} to {most:.2f} s | 2 s |"


def main() -> int:
    """All rows."""
    with tempfile.TemporaryDirectory() as name:
        lines = []
        for part in (writing, watched, reading):
            lines.append(part(Path(name)))
            print(lines[-1], flush=True)
    about = campaign.stamp(f"{campaign.processor()}; `make bench-log`.")
    head = "| what | measured | asked for |\n| --- | --- | --- |"
    campaign.put("\n".join([about, "", head, *lines]), _BEGIN, _END, campaign.ROOT / "docs/logs.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
