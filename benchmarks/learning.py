"""The learning campaign: every bar, every baseline, every figure of docs/learning.md.

    python -m benchmarks.learning                 all flights (make campaign-learning), writes docs/learning.md
    python -m benchmarks.learning --quick         one seed of the main cases, into runs/campaign-learning-quick
    python -m benchmarks.learning --resume        go on where a campaign was cut off
    python -m benchmarks.learning --report-only   tables and figures anew from results.json

Flights are independent: a pool of processes flies them, each flight a process of its own sockets.  Every finished
flight is kept at once in runs/campaign-learning.jsonl.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import date
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from benchmarks.learning_cases import FIRST_SEED, PILOTS, Flight, flights

ROOT = Path(__file__).resolve().parents[1]
SCHEMA = "flightstack.campaign-learning/1"
_TRACED = "paper-tracking"
_STUDY_SEEDS = 3
Job = tuple[str, str, str, int]
"""Kind (flight or study), case or world, pilot (empty for a study), seed."""


def run(job: Job) -> Any:
    """One job, in a process of the pool; a flight that could not be flown is a row that did not complete."""
    kind, name, pilot, seed = job
    try:
        if kind == "study":
            from benchmarks.learning_inputs import study

            return study(name, seed)
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


def jobs_of(*, quick: bool) -> list[Job]:
    """The campaign, seed by seed; the studies come first: they take longest."""
    from benchmarks.learning_inputs import WORLDS

    seeds = range(FIRST_SEED, FIRST_SEED + (1 if quick else _STUDY_SEEDS))
    studies: list[Job] = [("study", world, "", seed) for world in WORLDS for seed in seeds]
    return studies + [("flight", flight.case, flight.pilot, flight.seed) for flight in flights(quick=quick)]


def fly_all(jobs: list[Job], journal: Path, processes: int) -> None:
    """Run what the journal does not hold yet; each result is a line of it."""
    done = {tuple(json.loads(line)["job"]) for line in _lines(journal)}
    left = [job for job in jobs if job not in done]
    print(f"{len(left)} jobs of {len(jobs)} to do, {processes} processes", flush=True)
    began = time.monotonic()
    journal.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool, journal.open("a", encoding="utf-8") as out:
        futures = {pool.submit(run, job): job for job in left}
        for count, future in enumerate(as_completed(futures), 1):
            job, result = futures[future], future.result()
            out.write(json.dumps({"job": job, "result": result}) + "\n")
            out.flush()
            if count % 10 == 0 or count == len(left):
                spent = time.monotonic() - began
                ahead = spent / count * (len(left) - count)
                print(f"{count} of {len(left)}, {spent / 60:.1f} min, {ahead / 60:.1f} min to go", flush=True)


def _lines(journal: Path) -> list[str]:
    return journal.read_text(encoding="utf-8").splitlines() if journal.exists() else []


def gather(journal: Path, jobs: list[Job], wall_s: float) -> dict[str, Any]:
    """The results: flights by case, pilot and seed; their traces only where a figure shows them."""
    from app.files import versions
    from benchmarks.learning_stats import of, trace
    from benchmarks.learning_timing import timing

    held = {tuple(entry["job"]): entry["result"] for entry in map(json.loads, _lines(journal))}
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
        "schema": SCHEMA,
        "date": str(date.today()),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "git_commit": versions()["git_commit"],
        "wall_s": wall_s,
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
    path.parent.mkdir(parents=True, exist_ok=True)
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
    print(f"wrote {page}", flush=True)


def main() -> int:
    """Fly, gather, write; 1 where a flight did not complete."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one seed of the main cases")
    parser.add_argument("--resume", action="store_true", help="keep the flights of a campaign that was cut off")
    parser.add_argument("--report-only", action="store_true", help="tables and figures anew")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    runs = ROOT / "runs"
    page = runs / "campaign-learning-quick" / "learning.md" if options.quick else ROOT / "docs" / "learning.md"
    command = "make campaign-learning-quick" if options.quick else "make campaign-learning"
    stored = page.with_suffix("") / "results.json"
    if options.report_only:
        results = json.loads(stored.read_text(encoding="utf-8"))
    else:
        from app.compiled import ensure_compiled

        ensure_compiled(print)
        journal = runs / f"campaign-learning{'-quick' if options.quick else ''}.jsonl"
        if not options.resume:
            journal.unlink(missing_ok=True)
        jobs, began = jobs_of(quick=options.quick), time.monotonic()
        fly_all(jobs, journal, options.processes)
        results = gather(journal, jobs, time.monotonic() - began)
        write_results(results, stored)
    write_page(results, page, command)
    return 0 if all(row["completed"] for row in results["flights"]) else 1


if __name__ == "__main__":
    sys.exit(main())
