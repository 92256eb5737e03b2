"""The paper's tracking flight: protected with the estimator's profile, and told not to be without it."""

from __future__ import annotations

import numpy as np

from benchmarks.px4.companion import Flown, fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4

ASKED = (
    "paper-tracking with `--set-params px4-sih-ekf`: the filter engages within 40 s of take-off in 9 of 10 flights and "
    "the region is never left; at default parameters what does not fit is named, `protection` is `none`, exit code 1."
)
RUNS = 10
ENGAGED_WITHIN_S = 40.0
TRACK_S = 60.0


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` flights with the profile and as many without."""
    return [_profile(bench, runs), _stock(bench, runs)]


def _flights(bench: Bench, runs: int, *more: str) -> list[Flown]:
    flown = []
    for _ in range(runs):
        with Px4(bench) as px4:
            flown.append(fly(bench, px4, "paper-tracking", *more))
    return flown


def _profile(bench: Bench, runs: int) -> Row:
    flights, begins, notes, errors = _flights(bench, runs, "--set-params", "px4-sih-ekf"), [], [], []
    for number, flown in enumerate(flights):
        spans = flown.result.get("barrier", {}).get("protected") or []
        protection = flown.result.get("protection")
        errors.append(flown.result.get("tracking", {}).get("rmse_settled_m") or np.nan)
        if spans and spans[0]["from_s"] <= ENGAGED_WITHIN_S and protection == "held":
            begins.append(spans[0]["from_s"])
        else:
            said = flown.result.get("reason") or flown.said[-200:]
            notes.append(f"run {number}: exit {flown.code}, protection {protection}: {said!r}")
    engaged = f"from {min(begins):.0f} to {max(begins):.0f} s" if begins else "never"
    measured = f"held in {len(begins)} of {runs}, engaged {engaged}; settled rmse {np.nanmean(errors):.3f} m"
    return Row("with px4-sih-ekf", measured, len(begins) >= 0.9 * runs, runs, notes)


def _stock(bench: Bench, runs: int) -> Row:
    right, notes = 0, []
    for number, flown in enumerate(_flights(bench, runs)):
        said = str(flown.result.get("reason", ""))
        flown_whole = flown.result.get("flight_time_s", 0.0) > TRACK_S
        if flown.code == 1 and flown.result.get("protection") == "none" and flown_whole:
            right += 1
        else:
            notes.append(f"run {number}: exit {flown.code}, protection {flown.result.get('protection')}: {said!r}")
    return Row("at default parameters", f"told so in {right} of {runs}: {said!r}", right == runs, runs, notes)
