"""How long `flightstack gap` takes, and how much memory: whole commands, one after the other, on files.

    python -m benchmarks.gap_timing              all rows, into docs/gap-measured.md (make bench-gap)
    python -m benchmarks.gap_timing --row clean  one row, printed only

60 s at 125 Hz: blind flights (benchmarks.gap_cases) cut to a minute, a CSV and a vehicle file each, with every effect
of the table a candidate.  Long logs: this package's own MCAP of `rotor-drag` at 250 Hz, 5 and 10 minutes.  Least and
greatest of three runs; nothing else should be running.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import campaign, gap_cases

_BEGIN, _END = "<!-- timing: begin -->", "<!-- timing: end -->"
_MINUTE_S, _RATE_HZ = 60.0, 125
_SEED = 500_000
RUNS = 3
MINUTES = {
    "clean": "clean",
    "payload": "one:payload",
    "rotor drag": "one:rotor_drag",
    "motor lag": "one:motor_lag",
    "slung load": "one:slung_load",
    "two effects": "two",
    "three effects": "three",
}
LONG_S = {"5 min": 290, "10 min": 590}
Spent = tuple[float, float, float]
"""Wall time and CPU time in s, greatest memory in GB."""


def minute(kind: str, folder: Path) -> tuple[Path, Path]:
    """Log and vehicle file of the first drawn flight of this kind that holds a minute."""
    for seed in range(_SEED, _SEED + 100):
        case = gap_cases.make(kind, seed)
        table, _ = gap_cases.measure(case.flown, case.truth, np.random.default_rng(seed), 1.0, _RATE_HZ)
        if len(table["time_s"]) < _MINUTE_S * _RATE_HZ:
            continue
        cut = {name: values[: round(_MINUTE_S * _RATE_HZ)] for name, values in table.items()}
        made = gap_cases.Case(case.believed, cut, case.answer, case.truth, case.flown)
        log, vehicle, _ = gap_cases.write(made, folder, kind.replace(":", "-"))
        return log, vehicle
    raise RuntimeError(f"no flight of {kind} holds a minute")


def long_flight(duration_s: int, folder: Path) -> tuple[Path, Path]:
    """Log of a flight of our own, and the vehicle file that it believed."""
    out = folder / f"flight-{duration_s}"
    _flightstack("fly", "rotor-drag", "--duration", str(duration_s), "--out", str(out))
    return out / "flight.mcap", campaign.ROOT / "flightstack/data/vehicles" / "quad-x.toml"


def spent(log: Path, vehicle: Path, out: Path) -> Spent:
    """One run of the command, imports and report included."""
    return _flightstack("gap", str(log), "--vehicle", str(vehicle), "--out", str(out))


def _flightstack(*arguments: str) -> Spent:
    began = time.perf_counter()
    process = subprocess.Popen(
        [str(Path(sys.executable).with_name("flightstack")), *arguments],
        stdout=subprocess.DEVNULL,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"flightstack {' '.join(arguments)}: exit {process.returncode}")
    return time.perf_counter() - began, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024e-9


def row(name: str, folder: Path) -> str:
    """One line of the table."""
    long = name in LONG_S
    log, vehicle = long_flight(LONG_S[name], folder) if long else minute(MINUTES[name], folder)
    words = f"{name} at 250 Hz, MCAP" if long else f"60 s at 125 Hz, {name}"
    runs = [spent(log, vehicle, folder / "out") for _ in range(RUNS)]
    wall, cpu, memory = (sorted(values) for values in zip(*runs, strict=True))
    bar = {"5 min": "–", "10 min": "60 s, 2 GB"}.get(name, "8 s")
    return f"| {words} | {wall[0]:.1f} to {wall[-1]:.1f} s | {cpu[0]:.1f} s | {memory[-1]:.2f} GB | {bar} |"


def main() -> int:
    """Print the table and put it into docs/gap-measured.md."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--row", action="append", choices=[*MINUTES, *LONG_S], help="only this, printed")
    options = parser.parse_args()
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for name in options.row or (*MINUTES, *LONG_S):
            lines.append(row(name, Path(folder)))
            print(lines[-1], flush=True)
    if not options.row:
        head = "| log | takes | CPU | memory | asked for |\n| --- | --: | --: | --: | --: |"
        about = campaign.stamp(f"{campaign.processor()}; `make bench-gap`.")
        campaign.put("\n".join([about, "", head, *lines]), _BEGIN, _END)
    return 0


if __name__ == "__main__":
    sys.exit(main())
