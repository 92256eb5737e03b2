"""The blind campaign of the gap workflow: flights with a hidden effect, named without a look at the answer, judged.

    python -m benchmarks.gap_blind                 all cases (make gap-blind): the tables in docs/gap.md
    python -m benchmarks.gap_blind --quick         one of each, into runs/gap-blind-quick.md
    python -m benchmarks.gap_blind --first-seed N  other cases; runs accumulate in runs/gap-blind.jsonl
    python -m benchmarks.gap_blind --fresh         forget earlier runs
    python -m benchmarks.gap_blind --report-only   the tables anew
    python -m benchmarks.gap_blind --also RULES    with cases judged by these rules, too (may be repeated)

A case is flown in memory, written as a log (CSV or MCAP) and a vehicle file into a folder of its own, and the workflow
is given those two; the answer is opened when gap.json is written.  The journal says of each case which commit judged
it and by which rules (`benchmarks.gap_rules`); the tables count cases of the present rules only.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import importlib.util
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks import campaign, gap_tables
from benchmarks.gap_judge import Row, judge, lost, summary
from benchmarks.gap_rules import rules

FIRST_SEED = 60_000
_MCAP_EVERY = 4
Job = tuple[str, str, str, int, str]
"""Plant, kind, form of the log, seed, rules."""


def counts(quick: bool) -> dict[str, int]:
    """Cases of each kind."""
    from benchmarks.gap_cases import kinds

    if quick:
        return {kind: 3 if kind in ("clean", "two") else 1 for kind in kinds()}
    own = {"clean": 320, "two": 60, "three": 30}
    return {kind: own.get(kind, 12 if kind.startswith("outside:") else 6) for kind in kinds()}


def jobs_of(quick: bool, first_seed: int) -> list[Job]:
    """All cases, mixed, so that a run that is cut off has seen something of each kind.

    Half of the flights that the other simulator can fly (all but those with something outside the table, and what it
    refuses) are its.
    """
    most = counts(quick)
    plants, own = ["native"], set[str]()
    if importlib.util.find_spec("flightstack_sim.jsbsim") and importlib.util.find_spec("jsbsim"):
        from flightstack_sim.jsbsim.aircraft import REFUSED

        plants.append("jsbsim")
        own = {f"one:{effect}" for effect in REFUSED}
    judged_by = rules()
    jobs = []
    for at, (kind, count) in enumerate(most.items()):
        for k in range(count):
            plant = plants[0] if kind.startswith("outside:") or kind in own else plants[(k + at) % len(plants)]
            form = "mcap" if (k // 2 + at) % _MCAP_EVERY == 0 else "csv"
            jobs.append((k / count, (plant, kind, form, first_seed + k, judged_by)))
    return [job for _, job in sorted(jobs)]


def run(job: Job) -> Row:
    """One case, in a process of the pool; one that fails is a row that says so."""
    plant, kind, form, seed, _ = job
    try:
        with tempfile.TemporaryDirectory() as folder:
            return _run(plant, kind, form, seed, Path(folder))
    except Exception as error:  # a campaign of hundreds goes on
        return lost(f"{type(error).__name__}: {error}")


def _run(plant: str, kind: str, form: str, seed: int, folder: Path) -> Row:
    from benchmarks.gap_cases import make, write
    from flightstack.cli.files import load_vehicle
    from flightstack.cli.gap import GapOptions, find_gap
    from flightstack.cli.versions import versions

    log, vehicle, sealed = write(make(kind, seed, plant=plant), folder, "case", form)
    began = time.perf_counter()
    find_gap(GapOptions(logs=(log,), vehicle=str(vehicle), out=folder / "out"))
    wall_s = time.perf_counter() - began
    said = json.loads((folder / "out" / "gap.json").read_text(encoding="utf-8"))
    answer: dict[str, Any] = json.loads(sealed.read_text(encoding="utf-8"))
    row = judge(answer, said, load_vehicle(str(vehicle))[0])
    about = {"plant": plant, "kind": kind, "form": form, "seed": seed, "wall_s": round(wall_s, 2)}
    return row | about | {"commit": versions()["git_commit"]}


def pooled(journal: Path, judged_by: set[str]) -> list[Row]:
    """The journal's cases that were judged by one of these rules."""
    return [row for job, row in campaign.held_in(journal).items() if job[-1] in judged_by]


def main() -> int:
    """Fly, name, judge, write; 1 where a case was lost or a bar is missed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one of each, into runs/")
    parser.add_argument("--fresh", action="store_true", help="forget earlier runs")
    parser.add_argument("--report-only", action="store_true", help="the tables anew")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--also", action="append", help="count cases judged by these rules, too (may be repeated)")
    parser.add_argument("--kind", action="append", help="only this kind (may be repeated)")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    name = f"gap-blind{'-quick' if options.quick else ''}"
    journal = campaign.ROOT / "runs" / f"{name}.jsonl"
    if options.fresh or (options.quick and not options.report_only):
        journal.unlink(missing_ok=True)
    if not options.report_only:
        jobs = [job for job in jobs_of(options.quick, options.first_seed) if not options.kind or job[1] in options.kind]
        campaign.run_all(jobs, run, journal, options.processes)
    rows = pooled(journal, {rules(), *(options.also or ())})
    flown_by = dict.fromkeys(row["commit"] for row in rows if "commit" in row)
    about = campaign.provenance(gap_tables.SCHEMA, journal) | {
        "git_commit": ", then ".join(flown_by),
        "wall_s": sum(row.get("wall_s", 0.0) for row in rows),
    }
    page = campaign.ROOT / "runs" / f"{name}.md" if options.quick else campaign.ROOT / "docs" / "gap.md"
    gap_tables.write(rows, about, page, f"make {name}")
    print(f"wrote {page}", flush=True)
    figures = summary(rows)
    for bar in gap_tables.BARS:
        print(f"{bar.words}: {gap_tables.shown(bar, figures)}")
    return (
        0 if all(gap_tables.kept(bar, figures) is not False for bar in gap_tables.BARS) and not figures["lost"] else 1
    )


if __name__ == "__main__":
    sys.exit(main())
