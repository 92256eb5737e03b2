"""Filters compared: seeded exploration and adversarial flights through UDP, with the filter, without, as published.

    python -m benchmarks.barrier_campaign          all flights (make campaign-barrier-filters)
    python -m benchmarks.barrier_campaign --quick         a few of each, into runs/campaign-barrier-filters-quick
    python -m benchmarks.barrier_campaign --resume        go on where a campaign was cut off
    python -m benchmarks.barrier_campaign --report-only   the tables anew from results.json

Flights are independent: a pool of processes flies them.  Every finished flight is kept at once in
runs/campaign-barrier-filters.jsonl.
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
from benchmarks.barrier_cases import COUNTS, PILOTS, QUICK, TASKS

SCHEMA = "flightstack.campaign-barrier-filters/1"
FIRST_SEED = 40_000
Job = tuple[str, str, int]
"""Pilot, task, seed."""


def jobs_of(quick: bool) -> list[Job]:
    """The campaign: every pilot flies the same worlds; wherever it is cut, each has flown its share."""
    counts = QUICK if quick else COUNTS
    ordered = [
        ((k + 0.5) / counts[pilot], (pilot, task, FIRST_SEED + k))
        for pilot in PILOTS
        for k in range(counts[pilot])
        for task in TASKS
    ]  # fmt: skip
    return [job for _, job in sorted(ordered)]


def run(job: Job) -> dict[str, Any]:
    """One flight, in a process of the pool; one that could not be flown is a row that says so."""
    from benchmarks.barrier_flights import fly_scored

    pilot, task, seed = job
    try:
        return fly_scored(pilot, task, seed)
    except Exception as error:  # a campaign of hundreds goes on
        return {"pilot": pilot, "task": task, "seed": seed, "refused": False, "lost": repr(error)}


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
    """docs/barrier-filters.md: the tables and what they mean."""
    rows = results["flights"]
    lines = [
        "# Barrier filters compared",
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
        "that count on more braking than the truth has.  *Ended early*: falsified, or taken over by the guard.",
        "",
        "| pilot | task | drawn | refused | flown | engaged | left | infeasible | least h | median area m²/s | "
        "certificates | refuted | ended early | lost |",
        "| --- | --- |" + 12 * " --: |",
    ]
    for pilot in PILOTS:
        for task in TASKS:
            s = summary(rows, pilot, task)
            shown = [
                s["drawn"], s["refused"], s["flown"], s["engaged"], s["left"], s["infeasible"], _short(s["min_h"]),
                _short(s["area_median"]), s["certificates"], s["refuted"], s["not_completed"],
                s["lost"],
            ]  # fmt: skip
            lines.append(f"| {pilot} | {task} | " + " | ".join(str(value) for value in shown) + " |")
    return "\n".join(lines) + "\n"


def _short(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}".replace("-", "−")


def gather(held: dict[campaign.Job, Any], jobs: Sequence[Any]) -> dict[str, Any]:
    """The results: the flights of these jobs, and where they were flown."""
    return {"flights": [held[job] for job in jobs if job in held]}


def write_results(results: dict[str, Any], path: Path) -> None:
    """As JSON."""
    path.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


def write_page(results: dict[str, Any], path: Path, command: str) -> None:
    """The tables."""
    path.write_text(page(results, command), encoding="utf-8")


def passed(results: dict[str, Any]) -> bool:
    """Whether no flight with the sound filter left its region, had no safe command or was lost."""
    sound = [summary(results["flights"], "sound", task) for task in TASKS]
    return not any(row["left"] or row["infeasible"] or row["lost"] for row in sound)


CAMPAIGN = campaign.Campaign(
    "barrier-filters", "barrier-filters.md", (__doc__ or "").splitlines()[0], jobs_of, run, SCHEMA, gather,
    write_results, write_page, passed,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(campaign.main(CAMPAIGN))
