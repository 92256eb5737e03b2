"""The gap workflow on recorded flights whose answer is known: what it says beside what it must, as a table.

    python -m benchmarks.gap_recorded            all rows (make gap-recorded): the table in docs/gap-measured.md
    python -m benchmarks.gap_recorded --row iris  one row, printed only

The flights lie where FLIGHTSTACK_TEST_DATA says.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import campaign
from flightstack.gap.result import GapResult
from flightstack.gap.workflow import analyse
from flightstack.types import InputError
from flightstack.vehicle import Vehicle, parse_vehicle

VEHICLES = Path(__file__).parent / "vehicles"
_BEGIN, _END = "<!-- recorded: begin -->", "<!-- recorded: end -->"
_CRAZYFLIE = VEHICLES / "crazyflie-2.1.toml"


@dataclass(frozen=True, slots=True)
class Row:
    """Logs, what they are compared with, and what must come out."""

    key: str
    logs: tuple[str, ...]
    vehicle: Path | str
    expected: str
    columns: str | None = None
    holdout: tuple[str, ...] = ()


ROWS = (
    Row(
        "iris",
        ("gazebo_iris_sitl_56s.csv.gz",),
        VEHICLES / "gazebo-iris.toml",
        "rotor drag, 0.370 1/s in hover (k_d 1.75e-4)",
        "gazebo_iris",
    ),
    *(
        Row(
            key,
            (f"nanobench_{name}.csv.gz",),
            _CRAZYFLIE,
            expected,
            "nanobench",
            tuple(f"nanobench_{other}.csv.gz" for other in kept),
        )
        for key, name, expected, kept in (
            ("circle fast", "B2_circle_fast_rep1", "drag 0.37 to 0.42 1/s; no sag", ("B2_circle_medium_rep1",)),
            ("circle medium", "B2_circle_medium_rep1", "drag; no sag", ()),
            ("figure 8", "B3_figure8_fast_rep2", "drag 0.37 to 0.42 1/s; no sag", ()),
            ("linear ramp", "B6_linear_ramp_rep2", "too slow for drag; no sag", ()),
        )
    ),
    Row(
        "thrust chirp",
        ("crazyflie_thrust_chirp_50s.cfusdlog",),
        _CRAZYFLIE,
        "lag and delay, 60 to 75 ms in all",
    ),
    Row("normal", ("crazypad/normal_E8_log00",), _CRAZYFLIE, "no rotor fault"),
    Row(
        "clipped M3",
        ("crazypad/cut4mm_M3_E8_log00",),
        _CRAZYFLIE,
        "rotor fault, rotor 2 (M3, rear left)",
        None,
        ("crazypad/cut4mm_M3_E8_log01",),
    ),
    Row("bench", ("px4_real_bench_NOTFLYING_68s.ulg",), "px4_sih.toml", "refused: not a flight"),
    Row(
        "modern topics",
        ("px4_sitl_modern_topics_31s.ulg",),
        VEHICLES / "gazebo-iris.toml",
        "refused: five seconds in the air",
    ),
    Row("SIH", ("px4_sih_flight.ulg.gz",), "px4_sih.toml", "nothing: model and flight agree"),
)


def vehicle(row: Row, data: Path) -> Vehicle:
    """The believed vehicle of a row."""
    path = Path(row.vehicle) if isinstance(row.vehicle, Path) else data / row.vehicle
    return parse_vehicle(path.read_text("utf-8"), path.name)


def run(row: Row, data: Path) -> GapResult:
    """The workflow on a row's files; InputError where it refuses them."""
    logs, kept = [data / name for name in row.logs], [data / name for name in row.holdout]
    return analyse(logs, vehicle(row, data), columns=row.columns, holdout=kept)


def said(result: GapResult, mass_kg: float) -> str:
    """What was found, in a few words."""
    parts = []
    for found in result.found:
        values = " ".join(f"{name} {each.estimate:.4g}" for name, each in found.parameters.items())
        if found.name == "linear_drag":
            values += f" ({found.parameters['d_x_kgps'].estimate / mass_kg:.2f}, " + (
                f"{found.parameters['d_y_kgps'].estimate / mass_kg:.2f} 1/s)"
            )
        twins = f" or {', '.join(found.indistinguishable_from)}" if found.indistinguishable_from else ""
        parts.append(f"{found.name} {values}{twins}")
    late = late_s(result)
    if late is not None:
        parts.append(f"lag and delay {1e3 * late:.0f} ms in all")
    rest = result.unexplained
    if rest.significant:
        parts.append(f"unexplained ({', '.join(rest.depends_on) or 'no driver'})")
    return "; ".join(parts) or "nothing"


def late_s(result: GapResult) -> float | None:
    """Lag and delay of the corrected vehicle's rotors in all, where either was named."""
    if not {"motor_lag", "transport_delay"} & {found.name for found in result.found}:
        return None
    effects = result.corrected.effects
    lag_s = effects.get("motor_lag", {}).get("time_constant_s", result.corrected.rotors.time_constant_s)
    return float(lag_s) + float(effects.get("transport_delay", {}).get("delay_s", 0.0))


def lift(result: GapResult) -> str:
    """By how much the lift's residual falls on held-out data."""
    return _chi2_decrease(result, slice(2, 3))


def lateral(result: GapResult) -> str:
    """By how much the side force's residual falls on held-out data."""
    return _chi2_decrease(result, slice(0, 2))


def _chi2_decrease(result: GapResult, channels: slice) -> str:
    trace = result.report.traces[0]
    held = np.zeros(len(trace.t_s), bool)
    for first, last in trace.held_out_s:
        held |= (trace.t_s >= first) & (trace.t_s <= last)
    was, now = (
        float(np.sqrt(np.nanmean((trace.measured - x)[held][:, channels] ** 2))) for x in (trace.before, trace.after)
    )
    return f"{100.0 * (1.0 - now / was):.0f} %" if was > 0.0 else "–"


def line(row: Row, data: Path) -> str:
    """One line of the table."""
    began = time.perf_counter()
    try:
        result = run(row, data)
    except InputError as error:
        return f"| {row.key} | {row.expected} | refused: {str(error).split('.ulg: ', 1)[-1][:110]} | | | | |"
    closed = "–" if result.gap.closed is None else f"{100.0 * result.gap.closed:.0f} %"
    words = said(result, vehicle(row, data).mass_kg)
    figures = (lateral(result), lift(result), closed, f"{time.perf_counter() - began:.0f} s")
    return f"| {row.key} | {row.expected} | {words} | {' | '.join(figures)} |"


def main() -> int:
    """Print the table and put it into docs/gap-measured.md."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--row", action="append", help="only this row, printed (may be repeated)")
    options = parser.parse_args()
    data = Path(os.environ.get("FLIGHTSTACK_TEST_DATA", "../shared/data"))
    if not data.is_dir():
        print("no recorded flights: set FLIGHTSTACK_TEST_DATA to their folder")
        return 0
    lines = []
    for row in ROWS:
        if not options.row or row.key in options.row:
            lines.append(line(row, data))
            print(lines[-1], flush=True)
    if not options.row:
        names = ("flight", "must say", "says", "side force falls by", "lift falls by", "closed", "took")
        head = f"| {' | '.join(names)} |\n| {' | '.join(['---'] * 3 + ['--:'] * 4)} |"
        campaign.put("\n".join([campaign.stamp("`make gap-recorded`."), "", head, *lines]), _BEGIN, _END)
    return 0


if __name__ == "__main__":
    sys.exit(main())
