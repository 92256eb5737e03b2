"""What is learned on a real PX4, whose truth is known: the thrust gain and its sigma, the estimator's health."""

from __future__ import annotations

import numpy as np

from benchmarks.px4.companion import fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4

ASKED = (
    "Learned thrust gain within 0.03 of the true one (1 / SIH_MASS) and within 3 sigma as the learner "
    "says; beside it the settled rmse of PX4's own position (figure8: 0.06 m), rms of c = d(position)/dt - velocity "
    '(north, east, down), and the latency that was identified ("unknown" where it was not).'
)
RUNS = 2
GAIN_ERROR, FIGURE_M = 0.03, 0.06
CASES: tuple[tuple[str, dict[str, float]], ...] = (
    ("hover", {}),
    ("hover", {"SIH_MASS": 1.2}),
    ("hover", {"SIH_MASS": 1.4, "SIH_KDV": 2.0}),
    ("figure8", {}),
    ("figure8", {"SIH_MASS": 1.4}),
    ("figure8", {"SIH_KDV": 2.0}),
    ("figure8", {"SIH_MASS": 1.2, "SIH_KDV": 2.0}),
    ("paper-tracking", {}),
    ("paper-tracking", {"SIH_MASS": 1.4}),
    ("paper-tracking", {"SIH_KDV": 2.0}),
)


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` flights of every case, each on a PX4 started anew: 20 in all."""
    return [_case(bench, scenario, params, runs) for scenario, params in CASES]


def _case(bench: Bench, scenario: str, params: dict[str, float], runs: int) -> Row:
    true_gain = 1.0 / params.get("SIH_MASS", 1.0)
    gains, sigmas, settled, apart, latencies, notes = [], [], [], [], [], []
    for number in range(runs):
        with Px4(bench, params=params) as px4:
            flown = fly(bench, px4, scenario, "--unprotected-ok")
        gp = flown.result.get("gp", {})
        if flown.code or gp.get("thrust_gain") is None:
            notes.append(f"run {number}: exit {flown.code}, {flown.result.get('reason') or flown.said[-200:]!r}")
            continue
        gains.append(gp["thrust_gain"])
        sigmas.append(gp["thrust_gain_sigma"])
        latencies.append(gp["latency_s"])
        settled.append(flown.result["tracking"]["rmse_settled_m"])
        apart.append(flown.result["estimator"]["disagreement_rms_mps"])
    words = ", ".join([scenario, *(f"{name} {value:g}" for name, value in params.items())])
    if not gains:
        return Row(words, "none flown", False, runs, notes)
    error = np.abs(np.array(gains) - true_gain)
    known = [f"{1e3 * value:.1f}" for value in latencies if value is not None]
    measured = (
        f"gain {np.mean(gains):.3f} ({min(gains):.3f} to {max(gains):.3f}), 3 sigma {3.0 * np.mean(sigmas):.3f}; "
        f"settled {np.mean(settled):.3f} m (worst {max(settled):.3f}); "
        f"rms(c) {'/'.join(f'{value:.2f}' for value in np.mean(apart, axis=0))} m/s; "
        f"latency {', '.join(known) + ' ms' if known else 'unknown'}"
    )
    inside = bool((error <= GAIN_ERROR).all() and (error <= 3.0 * np.array(sigmas)).all())
    near = scenario != "figure8" or max(settled) <= FIGURE_M
    return Row(words, measured, inside and near and not notes, runs, notes)
