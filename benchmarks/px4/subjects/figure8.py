"""figure8 against PX4's own position, and where the vehicle truly was: as it is, heavier, with a profile."""

from __future__ import annotations

import numpy as np

from benchmarks.px4.companion import fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4
from benchmarks.px4.true_path import std_of_truth_m

ASKED = (
    "figure8: settled rmse of PX4's own position at most 0.06 m at default parameters, also with SIH_MASS 1.4, and "
    "with SIH_KDV 2 besides; standard deviation of the true horizontal position about the path at most 0.12 m with "
    "`--set-params px4-sih-ekf`."
)
RUNS = 10
LIMIT_M, TRUE_LIMIT_M = 0.06, 0.12
SETTLED_S = 20.0
"""The second half of the track."""
PROFILE = ("--set-params", "px4-sih-ekf")
CASES: tuple[tuple[str, dict[str, float], tuple[str, ...]], ...] = (
    ("as it is", {}, ()),
    ("mass 1.4 kg", {"SIH_MASS": 1.4}, ()),
    ("mass 1.4 kg, drag doubled", {"SIH_MASS": 1.4, "SIH_KDV": 2.0}, ()),
    ("with px4-sih-ekf", {}, PROFILE),
)


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` flights of every case, each on a PX4 started anew."""
    return [_case(bench, words, params, more, runs) for words, params, more in CASES]


def _case(bench: Bench, words: str, params: dict[str, float], more: tuple[str, ...], runs: int) -> Row:
    errors, stds, notes = [], [], []
    for number in range(runs):
        with Px4(bench, params=params) as px4:
            flown = fly(bench, px4, "figure8", *more)
            std_m = std_of_truth_m(flown.folder / "flight.mcap", px4.truth, SETTLED_S) if flown.result else None
        error_m = flown.result.get("tracking", {}).get("rmse_settled_m")
        if flown.code or error_m is None:
            notes.append(f"run {number}: exit {flown.code}, {flown.result.get('reason') or flown.said[-200:]!r}")
        if error_m is not None:
            errors.append(error_m)
        if std_m is not None:
            stds.append(std_m)
    if not errors:
        return Row(f"figure8, {words}", "none flown", False, runs, notes)
    measured = f"{np.mean(errors):.3f} +- {np.std(errors):.3f} m, worst {max(errors):.3f}"
    if stds:
        across = [float(np.max(std[:2])) for std in stds]
        measured += ", true std N/E/D " + "/".join(f"{part:.2f}" for part in np.mean(stds, axis=0)) + " m"
    reached = not notes and max(errors) <= LIMIT_M
    if more == PROFILE:
        reached = reached and bool(stds) and max(across) <= TRUE_LIMIT_M
    return Row(f"figure8, {words}", measured, reached, runs, notes)
