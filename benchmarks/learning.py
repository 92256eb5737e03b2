"""The learning campaign: every bar, every baseline, every figure of docs/learning.md.

    python -m benchmarks.learning                 all flights (make campaign-learning), writes docs/learning.md
    python -m benchmarks.learning --quick         one seed of the main cases, into runs/campaign-learning-quick
    python -m benchmarks.learning --resume        go on where a campaign was cut off
    python -m benchmarks.learning --report-only   tables and figures anew from results.json

Flights are independent: a pool of processes flies them, each flight a process of its own sockets.  Every finished
flight is kept at once in runs/campaign-learning.jsonl.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from benchmarks import campaign
from benchmarks.learning_cases import FIRST_SEED, PILOTS, Flight, flights

SCHEMA = "flightstack.campaign-learning/1"
_TRACED = "paper-tracking"
_STUDY_SEEDS = 3
_WORLDS = ("air", "ground")
Job = tuple[str, str, str, int]
"""Kind (flight or study), case or world, pilot (empty for a study), seed."""


def run(job: Job) -> Any:
    """One job, in a process of the pool; a flight that could not be flown is a row that did not complete."""
    kind, name, pilot, seed = job
    try:
        if kind == "study":
            from flightstack_paper.inputs import Study, study

            return study(Study(world=name, seed=seed))
        from benchmarks.learning_flights import fly_scored

        return fly_scored(Flight(name, pilot, seed))
    except Exception as error:  # a campaign of hundreds goes on
        if kind == "study":
            return []
        lost = {"completed": False, "reason": repr(error), "rmse_m": None, "max_m": None, "rmse_settled_m": None}
        return {
            "case": name,
            "pilot": pilot,
            "seed": seed,
            **lost,
            "track_s": None,
            "trace_m": [],
            "trace_from_s": 0.0,
            "wall_s": 0.0,
        }


def jobs_of(quick: bool) -> list[Job]:
    """The campaign, seed by seed; the studies come first: they take longest."""
    seeds = range(FIRST_SEED, FIRST_SEED + (1 if quick else _STUDY_SEEDS))
    studies: list[Job] = [("study", world, "", seed) for world in _WORLDS for seed in seeds]
    return studies + [("flight", flight.case, flight.pilot, flight.seed) for flight in flights(quick=quick)]


def gather(held: dict[campaign.Job, Any], jobs: Sequence[Any]) -> dict[str, Any]:
    """The results: flights by case, pilot and seed; their traces only where a figure shows them."""
    from benchmarks.learning_stats import of, trace
    from benchmarks.learning_timing import timing

    rows = [held[job] for job in jobs if job[0] == "flight" and job in held]
    traces = {}
    for pilot in PILOTS:
        shown = [row for row in of(rows, _TRACED, pilot) if row["completed"]]
        if shown and pilot in ("learning", "none", "exact"):
            traces[f"{_TRACED}/{pilot}"] = trace(shown)
    for row in rows:
        row.pop("trace_m", None)
        row.pop("trace_from_s", None)
        if row["seed"] != FIRST_SEED and "change" in row:
            row["change"].pop("shown", None)
    return {
        "timing": timing(),
        "inputs": [row for job in jobs if job[0] == "study" and job in held for row in held[job]],
        "traces": traces,
        "flights": sorted(rows, key=lambda row: (row["case"], row["pilot"], row["seed"])),
    }


def write_results(results: dict[str, Any], path: Path) -> None:
    """JSON, a line for each flight."""
    head = {key: value for key, value in results.items() if key != "flights"}
    text = "{\n" + "".join(f" {json.dumps(key)}: {json.dumps(value)},\n" for key, value in head.items())
    rows = ",\n  ".join(json.dumps(_rounded(row)) for row in results["flights"])
    path.write_text(text + f' "flights": [\n  {rows}\n ]\n}}\n', encoding="utf-8")


def _rounded(value: Any) -> Any:
    """Floats to six digits."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value


def write_page(results: dict[str, Any], page: Path, command: str) -> None:
    """Figures and the page."""
    from benchmarks.learning_plots import draw
    from benchmarks.learning_report import report

    figures = draw(results, page.with_suffix(""))
    page.write_text(report(results, figures, command), encoding="utf-8")


def passed(results: dict[str, Any]) -> bool:
    """Whether every flight completed."""
    return all(row["completed"] for row in results["flights"])


CAMPAIGN = campaign.Campaign(
    "learning",
    "learning.md",
    (__doc__ or "").splitlines()[0],
    jobs_of,
    run,
    SCHEMA,
    gather,
    write_results,
    write_page,
    passed,
)

if __name__ == "__main__":
    sys.exit(campaign.main(CAMPAIGN))
