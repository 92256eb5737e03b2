"""`make replay`: the reference flights of tests/reference through today's stack, beside what is recorded of them.

    python -m benchmarks.reference_flights              what differs by more than is allowed; exit code 1 where any does
    python -m benchmarks.reference_flights --update     the outputs of today become the recorded ones
    python -m benchmarks.reference_flights --record     fly them anew (other inputs: only where the wire has changed)

NAME.mcap holds the inputs, messages of the first seconds of a flight in lockstep, with its files and settings.
NAME.csv holds what came out five times a second, as text: a change of the outputs is a change in the diff;
processor.txt for which kind of processor that was compiled.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from llvmlite.binding import get_host_cpu_name

from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.replay import records_of
from flightstack.jit import machine_key
from flightstack.types import TickRecord
from flightstack_logs.reader import read
from flightstack_logs.tables import Log
from flightstack_logs.topics import MESSAGE, TOPICS
from flightstack_logs.writer import FlightLog

FOLDER = Path(__file__).resolve().parents[1] / "tests/reference"
FLIGHTS: dict[str, Mapping[str, Any]] = {
    "hover": {"scenario": "hover", "duration_s": 2.0, "learning": False, "seed": 1},
    "tracking": {"scenario": "paper-tracking", "duration_s": 2.0, "seed": 2},
    "figure8": {"scenario": "figure8", "duration_s": 2.0, "sensors": "gps", "seed": 3},
    "published": {"scenario": "paper-barrier", "duration_s": 2.0, "as_published": True, "seed": 4},
}
UNTIL_US = 9_500_000
"""4.5 s of flight."""
TOLERANCE = 1e-9
"""On the kind of processor that the outputs were recorded on."""
OTHER_TOLERANCE = 1e-5
"""On another, whose vectors sum in another order, what is learned differs by up to 5e-7 m/s^2 and commands by 1.4e-8
(recorded on another EPYC, replayed as znver3 and as plain x86-64): the recursion betters an answer only to a thousandth
of its variance."""
_PROCESSOR = FOLDER / "processor.txt"
_PERIOD_US = 200_000
_INPUTS = ("/vehicle/attitude", "/vehicle/local_position", "/vehicle/imu", "/vehicle/motors")

Row = dict[str, float]


def excerpt(log: Log, path: Path) -> None:
    """The inputs of a flight up to `UNTIL_US`, as a log."""
    attachments = [item for item in log.attachments if not item.name.startswith("certificate")]
    settings = {name: log.metadata[name] for name in ("settings", "versions", "clock")}
    out = FlightLog.open(path, metadata=settings, attachments=attachments, overwrite=True, compact=True)
    rows = [row for topic in _INPUTS for row in _rows(log, topic)]
    raw = log.messages[MESSAGE]
    assert raw.place is not None
    rows += zip(raw.place.tolist(), raw.t_us.tolist(), [MESSAGE] * len(raw), raw.data, strict=True)
    for _, t_us, topic, record in sorted(rows, key=lambda row: row[0]):
        if t_us <= UNTIL_US:
            out.write(topic, t_us, record)
    out.close()


def _rows(log: Log, topic: str) -> Iterator[tuple[int, int, str, Any]]:
    table = log.tables[topic]
    assert table.place is not None
    columns = [table.columns[field.name].tolist() for field in TOPICS[topic].fields]
    for place, t_us, *record in zip(table.place.tolist(), table.t_us.tolist(), *columns, strict=True):
        yield place, t_us, topic, tuple(record)


def outputs(path: Path) -> list[Row]:
    """What today's stack makes of the inputs, five times a second."""
    found: list[Row] = []
    due_us = 0
    for record in records_of(read(path)):
        if record.t_us >= due_us:
            due_us = record.t_us - record.t_us % _PERIOD_US + _PERIOD_US
            found.append(_row(record))
    return found


def _row(record: TickRecord) -> Row:
    measured, learned, filtered = record.measurement, record.learned, record.filtered
    row = {"t_s": record.t_us * 1e-6, "thrust_norm": record.command.thrust_norm}
    for name, values in (
        ("rate_frd_radps", record.command.rate_frd_radps),
        ("pos_ned_m", measured.pos_ned_m),
        ("vel_ned_mps", measured.vel_ned_mps),
        ("q_ned_frd", measured.q_ned_frd),
        ("reference_ned_m", record.reference.pos_ned_m),
        ("residual_frd_mps2", learned.residual_frd_mps2),
        ("sigma_frd_mps2", learned.sigma_frd_mps2),
    ):
        row |= {f"{name}_{k}": float(value) for k, value in enumerate(values)}
    row |= {"thrust_gain": learned.thrust_gain, "stage": learned.stage, "points": learned.points}
    return row | {"h": filtered.h, "status": filtered.status, "intervened": filtered.intervened}


def write_outputs(rows: list[Row], path: Path) -> None:
    """As text, 12 digits."""
    with path.open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(rows[0])
        out.writerows([f"{value:.12g}" for value in row.values()] for row in rows)


def read_outputs(path: Path) -> list[Row]:
    """What is recorded."""
    with path.open(newline="") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def allowed() -> float:
    """By how much outputs may differ from the recorded ones on this machine."""
    return TOLERANCE if _PROCESSOR.read_text().split()[0] == machine_key() else OTHER_TOLERANCE


def differences(then: list[Row], now: list[Row], tolerance: float = TOLERANCE) -> list[str]:
    """In words: which columns differ, from when on and by how much at most."""
    if [round(row["t_s"], 6) for row in then] != [round(row["t_s"], 6) for row in now]:
        return [f"other ticks: {len(then)} rows recorded, {len(now)} today"]
    if then and then[0].keys() != now[0].keys():
        return ["other columns"]
    found = []
    for name in then[0] if then else ():
        apart = [(old["t_s"], old[name], new[name]) for old, new in zip(then, now, strict=True)
                 if not _near(old[name], new[name], tolerance)]  # fmt: skip
        if apart:
            most = max(abs(new - old) for _, old, new in apart)
            at_s, old, new = apart[0]
            found.append(f"{name}: from {at_s:.3f} s on ({old:.9g}, today {new:.9g}), by {most:.3g} at most")
    return found


def _near(old: float, new: float, tolerance: float) -> bool:
    if old != old or new != new:
        return old != old and new != new
    return old == new or abs(new - old) <= tolerance * max(1.0, abs(old))


def record(name: str) -> None:
    """Fly a reference flight anew and keep its inputs."""
    with tempfile.TemporaryDirectory() as folder:
        fly(FlyOptions(out=Path(folder), **FLIGHTS[name]), stop_requested=lambda: "")
        excerpt(read(Path(folder) / "flight.mcap"), FOLDER / f"{name}.mcap")


def main() -> None:
    """Replay, and show."""
    asked = set(sys.argv[1:])
    if asked - {"--update", "--record"}:
        sys.exit("error: known are --update and --record")
    if asked:
        _PROCESSOR.write_text(f"{machine_key()} {get_host_cpu_name()}\n")
    apart = False
    for name in FLIGHTS:
        if "--record" in asked:
            record(name)
        today = outputs(FOLDER / f"{name}.mcap")
        if asked:
            write_outputs(today, FOLDER / f"{name}.csv")
        words = differences(read_outputs(FOLDER / f"{name}.csv"), today, allowed())
        apart = apart or bool(words)
        print(f"{name}: " + ("as recorded" if not words else "\n  ".join(("", *words)).strip("\n")), flush=True)
    sys.exit(1 if apart else 0)


if __name__ == "__main__":
    main()
