"""End to end: a load and drag that the file lacks, told from a flight's log, flown again with the corrected file."""

from __future__ import annotations

from pathlib import Path

from benchmarks.close_gap import Flown, close
from benchmarks.px4.companion import VEHICLE, fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4, log_folder

ASKED = (
    "figure8 with SIH_MASS 1.3 and SIH_KDV 2 (the file: 1.0 and 1.0), `gap` on its log, flown again with the "
    "corrected file: the thrust gain nearer to 1 and no larger error; the payload 0.3 kg within 10 %."
)
RUNS = 1
HIDDEN = {"SIH_MASS": 1.3, "SIH_KDV": 2.0}
PAYLOAD_KG = 0.3


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` pairs of flights, each on a PX4 started anew."""
    return [_closed(bench, number) for number in range(runs)]


def _closed(bench: Bench, number: int) -> Row:
    def flown(vehicle: str, out: Path) -> Flown:
        with Px4(bench, params=HIDDEN) as px4:
            done = fly(bench, px4, "figure8", "--vehicle", vehicle, "--unprotected-ok", "--believe-file")
        return done.folder / "flight.mcap", done.result

    words, folder = "figure8, gap, figure8", log_folder(bench, f"gap-{number}")
    closed = close(flown, VEHICLE, folder)
    named = {f.name: f.parameters for f in closed.result.found}
    gains = [each.get("gp", {}).get("thrust_gain") for each in (closed.before, closed.after)]
    errors = [each.get("tracking", {}).get("rmse_settled_m") for each in (closed.before, closed.after)]
    measured = (
        f"{closed.result.sentence} thrust gain {gains[0]} -> {gains[1]}, settled error {errors[0]} -> {errors[1]} m"
    )
    if None in (*gains, *errors) or "payload" not in named:
        return Row(words, measured, False, 2, [str(closed.page)])
    near = abs(named["payload"]["mass_kg"].estimate - PAYLOAD_KG) < 0.1 * PAYLOAD_KG
    return Row(words, measured, near and abs(gains[1] - 1.0) < abs(gains[0] - 1.0), 2, [])
