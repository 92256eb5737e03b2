"""A hover at stock parameters: does anything fly at all."""

from __future__ import annotations

import numpy as np

from benchmarks.px4.companion import fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4

ASKED = "Hover at default parameters, 20 s: completed, settled rmse of the estimated position below 0.25 m."
RUNS = 3
LIMIT_M = 0.25


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` flights, each on a PX4 started anew."""
    errors, notes = [], []
    for number in range(runs):
        with Px4(bench) as px4:
            flown = fly(bench, px4, "hover", "--duration", "20")
        error_m = flown.result.get("tracking", {}).get("rmse_settled_m")
        if flown.code or error_m is None:
            notes.append(f"run {number}: exit {flown.code}, {flown.result.get('reason') or flown.said[-200:]!r}")
        else:
            errors.append(error_m)
    measured = f"{np.mean(errors):.3f} +- {np.std(errors):.3f} m" if errors else "none completed"
    return [Row("hover, settled rmse", measured, len(errors) == runs and max(errors) < LIMIT_M, runs, notes)]
