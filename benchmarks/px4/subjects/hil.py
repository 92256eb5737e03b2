"""Our physics behind a real PX4 (airframe 10016, none_iris): `fly --px4-hil`, scored by the truth."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np

from benchmarks.px4.companion import LIMIT_S
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.station import Px4, log_folder

ASKED = (
    "Our plant behind a real PX4, GPS grade: settled rmse of PX4's own position at most 0.05 m in hover and 0.08 m in "
    "figure8; beside it that of the true position (in PX4's frame), and the error of PX4's estimate."
)
RUNS = 10
CASES = (("hover", 0.05, ("--duration", "20")), ("figure8", 0.08, ()))


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` flights of every scenario with seeds from 0 on, each on a PX4 started anew."""
    return [_row(bench, scenario, limit_m, more, runs) for scenario, limit_m, more in CASES]


def _row(bench: Bench, scenario: str, limit_m: float, more: tuple[str, ...], runs: int) -> Row:
    errors, true_errors, across, heights, notes = [], [], [], [], []
    for seed in range(runs):
        folder = log_folder(bench, f"hil-{scenario}")
        with Px4(bench, "hil") as px4:
            words = [
                *bench.prefix,
                sys.executable,
                "-m",
                "flightstack",
                "fly",
                scenario,
                "--px4-hil",
                "--seed",
                str(seed),
            ]
            words += ["--hil-port", str(px4.hil_port), "--out", str(folder), "--json", str(folder / "flight.json")]
            done = subprocess.run([*words, *more], capture_output=True, text=True, timeout=LIMIT_S, check=False)
        (folder / "said.txt").write_text(done.stdout + done.stderr)
        file = folder / "flight.json"
        result = json.loads(file.read_text()) if file.exists() else {}
        error_m = ((result.get("estimate") or {}).get("tracking") or {}).get("rmse_settled_m")
        if done.returncode or error_m is None:
            notes.append(f"seed {seed}: exit {done.returncode}, {result.get('reason') or done.stderr[-200:]!r}")
            continue
        errors.append(error_m)
        true_errors.append(result["tracking"]["rmse_settled_m"])
        across.append(result["estimate"]["horizontal_rms_m"])
        heights.append(result["estimate"]["height_rms_m"])
    if not errors:
        return Row(scenario, "none flown", False, runs, notes)
    measured = (
        f"{np.mean(errors):.3f} +- {np.std(errors):.3f} m, worst {max(errors):.3f}; "
        f"truth {np.mean(true_errors):.3f} +- {np.std(true_errors):.3f}; "
        f"estimate off by {np.mean(across):.3f} m across, {np.mean(heights):.3f} m in height"
    )
    return Row(scenario, measured, not notes and max(errors) <= limit_m, runs, notes)
