"""The barrier campaign: seeded exploration and adversarial flights through UDP, with the filter, without, as published.

    python -m benchmarks.barrier_campaign                 all flights (make campaign-barrier), writes docs/barrier.md
    python -m benchmarks.barrier_campaign --quick         a few of each, into runs/campaign-barrier-quick
    python -m benchmarks.barrier_campaign --resume        go on where a campaign was cut off
    python -m benchmarks.barrier_campaign --report-only   the tables anew from results.json

Flights are independent: a pool of processes flies them.  Every finished flight is kept at once in
runs/campaign-barrier.jsonl.
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

from benchmarks.barrier_cases import COUNTS, PILOTS, QUICK, TASKS

ROOT = Path(__file__).resolve().parents[1]
SCHEMA = "flightstack.campaign-barrier/1"
FIRST_SEED = 40_000
Job = tuple[str, str, int]
"""Pilot, task, seed."""


def jobs_of(*, quick: bool) -> list[Job]:
    """The campaign, seed by seed: every pilot flies the same worlds."""
    counts = QUICK if quick else COUNTS
    most = max(counts.values())
    return [
        (pilot, task, FIRST_SEED + k)
        for k in range(most)
        for pilot in PILOTS
        for task in TASKS
        if k < counts[pilot]
    ]  # fmt: skip


def run(job: Job) -> dict[str, Any]:
    """One flight, in a process of the pool; one that could not be flown is a row that says so."""
    from benchmarks.barrier_flights import fly_scored

    pilot, task, seed = job
    try:
        return fly_scored(pilot, task, seed)
    except Exception as error:  # a campaign of hundreds goes on
        return {"pilot": pilot, "task": task, "seed": seed, "refused": False, "lost": repr(error)}


def fly_all(jobs: list[Job], journal: Path, processes: int) -> None:
    """Run what the journal does not hold yet; each result is a line of it."""
    done = {(row["pilot"], row["task"], row["seed"]) for row in rows_of(journal)}
    left = [job for job in jobs if job not in done]
    print(f"{len(left)} flights of {len(jobs)} to do, {processes} processes", flush=True)
    began = time.monotonic()
    journal.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool, journal.open("a", encoding="utf-8") as out:
        futures = [pool.submit(run, job) for job in left]
        for count, future in enumerate(as_completed(futures), 1):
            out.write(json.dumps(future.result()) + "\n")
            out.flush()
            if count % 10 == 0 or count == len(left):
                spent = time.monotonic() - began
                ahead = spent / count * (len(left) - count)
                print(f"{count} of {len(left)}, {spent / 60:.1f} min, {ahead / 60:.1f} min to go", flush=True)


def rows_of(journal: Path) -> list[dict[str, Any]]:
    """The journal's rows; a last line that was cut off does not count."""
    rows = []
    for line in journal.read_text(encoding="utf-8").splitlines() if journal.exists() else []:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def summary(rows: list[dict[str, Any]], pilot: str, task: str) -> dict[str, Any]:
    """What a table's row says."""
    of = [row for row in rows if row["pilot"] == pilot and row["task"] == task]
    flown = [row for row in of if not row["refused"] and "lost" not in row]
    engaged = [row for row in flown if row["engaged_s"] is not None]
    least = [row["min_h"] for row in engaged if row["min_h"] is not None]
    grown = sorted(row["area_last_m2ps"] for row in flown if row["area_last_m2ps"] is not None)
    return {
        "drawn": len(of), "refused": sum(row["refused"] for row in of), "lost": sum("lost" in row for row in of),
        "flown": len(flown), "engaged": len(engaged),
        "left": sum(bool(row["exits"]) for row in engaged), "infeasible": sum(row["infeasible"] or 0 for row in flown),
        "min_h": min(least) if least else None, "area_median": grown[len(grown) // 2] if grown else None,
        "certificates": sum(row["certificates"] for row in flown), "refuted": sum(row["refuted"] for row in flown),
        "not_completed": sum(not row["completed"] for row in flown),
    }  # fmt: skip


def page(results: dict[str, Any], command: str) -> str:
    """docs/barrier.md: the tables and what they mean."""
    rows = results["flights"]
    lines = [
        "# The barrier campaign",
        "",
        f"{results['date']}, {results['machine']}, {results['cores']} cores, Python {results['python']}, commit "
        f"{results['git_commit']}; `{command}`, {results['wall_s'] / 60:.0f} minutes.",
        "",
        "Every flight goes through UDP on loopback in lockstep, 20 s on the track.  Drawn for each seed: true over ",
        "believed mass 0.8 to 1.5, a force up to 0.15 g in any direction, rotor lag 30 to 80 ms (believed to 15 %), ",
        "link delay 10 to 40 ms (believed to 2 ms), jitter up to 4 ms, 0 to 1 % of the datagrams lost, a command ",
        "every 4 to 20 ms.  `explore` is Algorithm 1; `adversary` is a controller that wants out: away from the ",
        "centre, the way it moves, or at random.  Worlds that leave less than 0.05 g to climb with are refused before ",
        "take-off.",
        "",
        "A flight has *left* when the true position and velocity were outside the certified region in force at any ",
        "tick after the filter had engaged.  *Infeasible*: ticks without a safe command.  *Refuted*: certificates ",
        "that count on more braking than the truth has.",
        "",
        "| pilot | task | drawn | refused | flown | engaged | left | infeasible | least h | median area m²/s | "
        "certificates | refuted | lost |",
        "| --- | --- | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: |",
    ]
    for pilot in PILOTS:
        for task in TASKS:
            s = summary(rows, pilot, task)
            shown = [
                s["drawn"], s["refused"], s["flown"], s["engaged"], s["left"], s["infeasible"], _short(s["min_h"]),
                _short(s["area_median"]), s["certificates"], s["refuted"], s["lost"],
            ]  # fmt: skip
            lines.append(f"| {pilot} | {task} | " + " | ".join(str(value) for value in shown) + " |")
    return "\n".join(lines) + "\n"


def _short(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}".replace("-", "−")


def gather(journal: Path, jobs: list[Job], wall_s: float) -> dict[str, Any]:
    """The results: the flights of these jobs, and where they were flown."""
    from app.files import versions

    held = {(row["pilot"], row["task"], row["seed"]): row for row in rows_of(journal)}
    return {
        "schema": SCHEMA, "date": str(date.today()), "machine": platform.machine(), "cores": os.cpu_count(),
        "python": platform.python_version(), "git_commit": versions()["git_commit"], "wall_s": wall_s,
        "flights": [held[job] for job in jobs if job in held],
    }  # fmt: skip


def main() -> int:
    """Fly, gather, write; 1 where a flight with the sound filter left its region or had no safe command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a few flights of each kind")
    parser.add_argument("--resume", action="store_true", help="keep the flights of a campaign that was cut off")
    parser.add_argument("--report-only", action="store_true", help="the tables anew")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    runs = ROOT / "runs"
    target = runs / "campaign-barrier-quick" / "barrier.md" if options.quick else ROOT / "docs" / "barrier.md"
    command = "make campaign-barrier-quick" if options.quick else "make campaign-barrier"
    stored = target.with_suffix("") / "results.json"
    if options.report_only:
        results = json.loads(stored.read_text(encoding="utf-8"))
    else:
        from app.compiled import ensure_compiled

        ensure_compiled(print)
        journal = runs / f"campaign-barrier{'-quick' if options.quick else ''}.jsonl"
        if not options.resume:
            journal.unlink(missing_ok=True)
        jobs, began = jobs_of(quick=options.quick), time.monotonic()
        fly_all(jobs, journal, options.processes)
        results = gather(journal, jobs, time.monotonic() - began)
        stored.parent.mkdir(parents=True, exist_ok=True)
        stored.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page(results, command), encoding="utf-8")
    print(f"wrote {target}", flush=True)
    sound = [summary(results["flights"], "sound", task) for task in TASKS]
    return 1 if any(row["left"] or row["infeasible"] or row["lost"] for row in sound) else 0


if __name__ == "__main__":
    sys.exit(main())
