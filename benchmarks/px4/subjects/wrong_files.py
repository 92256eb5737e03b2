"""Vehicle files that are wrong for SIH's quadrotor: refused before the flight, or by the first hover."""

from __future__ import annotations

from benchmarks.px4.companion import VEHICLE, fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4
from flightstack.cli.files import load_vehicle
from flightstack.vehicle import vehicle_to_toml
from tests.wrong_vehicles import WRONG

ASKED = (
    "Wrong vehicle files at default parameters (MPC_THR_HOVER stands at its default 0.5, so the hover thrust is judged "
    "in the first hover): every one refused with exit code 2, the ground met at 1.5 m/s at most; the right file flies."
)
RUNS = 1
SOFT_MPS = 1.5


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` flights with every wrong file, and with the right one."""
    right, _ = load_vehicle(VEHICLE)
    files = {words: vehicle_to_toml(make(right)) for words, make in WRONG.items()}
    rows = [_row(bench, words, text, runs, refused=True) for words, text in files.items()]
    return [*rows, _row(bench, "the right file", vehicle_to_toml(right), runs, refused=False)]


def _row(bench: Bench, words: str, text: str, runs: int, *, refused: bool) -> Row:
    bench.out.mkdir(parents=True, exist_ok=True)
    file = bench.out / "vehicle.toml"
    file.write_text(text)
    said, notes, sink_mps = "", [], 0.0
    for number in range(runs):
        with Px4(bench) as px4:
            flown = fly(bench, px4, "hover", "--duration", "3", "--vehicle", str(file))
            low = [truth.vel_d_mps for truth in px4.truth if truth.up_m < 0.1]
        sink_mps = max(sink_mps, *low)
        lines = [line for line in flown.said.splitlines() if line.startswith("error:")]
        said = lines[0].removeprefix("error: ").split(";")[0] if lines else "flown"
        if flown.code != (2 if refused else 0):
            notes.append(f"run {number}: exit {flown.code}, {flown.said[-200:]!r}")
        if sink_mps > SOFT_MPS:
            notes.append(f"run {number}: met the ground at {sink_mps:.1f} m/s")
    measured = f"{said} (ground met at {sink_mps:.1f} m/s)" if sink_mps > 0.1 else said
    return Row(words, measured, not notes, runs, notes)
