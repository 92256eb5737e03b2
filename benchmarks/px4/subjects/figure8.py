"""figure8 against PX4's own position, and where the vehicle truly was: as it is, heavier, and with more drag."""

from __future__ import annotations

import numpy as np

from benchmarks.px4.companion import fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4

ASKED = (
    "figure8 at default parameters: settled rmse of PX4's own position at most 0.06 m, also with "
    "SIH_MASS 1.4, and with SIH_KDV 2 besides."
)
RUNS = 10
LIMIT_M = 0.06
CASES: tuple[tuple[str, dict[str, float]], ...] = (
    ("as it is", {}),
    ("mass 1.4 kg", {"SIH_MASS": 1.4}),
    ("mass 1.4 kg, drag doubled", {"SIH_MASS": 1.4, "SIH_KDV": 2.0}),
)


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` flights of every case, each on a PX4 started anew."""
    return [_case(bench, words, params, runs) for words, params in CASES]


def _case(bench: Bench, words: str, params: dict[str, float], runs: int) -> Row:
    errors, notes = [], []
    for number in range(runs):
        with Px4(bench, params=params) as px4:
            flown = fly(bench, px4, "figure8")
        error_m = flown.result.get("tracking", {}).get("rmse_settled_m")
        if flown.code or error_m is None:
            notes.append(f"run {number}: exit {flown.code}, {flown.result.get('reason') or flown.said[-200:]!r}")
        if error_m is not None:
            errors.append(error_m)
    if not errors:
        return Row(f"figure8, {words}", "none flown", False, runs, notes)
    measured = f"{np.mean(errors):.3f} +- {np.std(errors):.3f} m, worst {max(errors):.3f}"
    return Row(f"figure8, {words}", measured, not notes and max(errors) <= LIMIT_M, runs, notes)
