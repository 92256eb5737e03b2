"""What every campaign is: jobs flown by a pool of processes, each result kept at once in a journal, and the page after.

A job is a tuple of words and numbers; the journal holds one line for each, `{"job": ..., "result": ...}`, so that a
campaign that was cut off goes on where it stopped.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import os
import platform
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from datetime import date
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
Job = tuple[str | int, ...]


class Campaign(NamedTuple):
    """A campaign's own parts."""

    name: str
    """make campaign-NAME; its journal and quick results lie in runs/campaign-NAME*."""
    page: str
    """File name below docs/."""
    words: str
    """For --help."""
    jobs: Callable[[bool], Sequence[Job]]
    """Quick or not -> what to fly, in its order."""
    run: Callable[[Any], Any]
    """One job -> its result; runs in a process of the pool and raises nothing."""
    schema: str
    """Of results.json."""
    gather: Callable[[dict[Job, Any], Sequence[Job]], dict[str, Any]]
    """(job -> result, all jobs) -> what results.json holds beside where and when."""
    write_results: Callable[[dict[str, Any], Path], None]
    write_page: Callable[[dict[str, Any], Path, str], None]
    """(results, page, command)"""
    passed: Callable[[dict[str, Any]], bool]


def held_in(journal: Path) -> dict[Job, Any]:
    """The journal's results; a last line that was cut off does not count."""
    held: dict[Job, Any] = {}
    for line in journal.read_text(encoding="utf-8").splitlines() if journal.exists() else []:
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            continue
        if "job" in entry:
            held[tuple(entry["job"])] = entry["result"]
    return held


def runs_in(journal: Path) -> tuple[float, list[str]]:
    """Wall time of all runs that wrote the journal, and the commits that they flew."""
    wall_s, commits = 0.0, []
    for line in journal.read_text(encoding="utf-8").splitlines() if journal.exists() else []:
        if line.startswith('{"run"'):
            run = json.loads(line)["run"]
            wall_s += run["wall_s"]
            if run["git_commit"] not in commits:
                commits.append(run["git_commit"])
    return wall_s, commits


def run_all(
    jobs: Sequence[Job], run: Callable[[Any], Any], journal: Path, processes: int, minutes: float = math.inf
) -> None:
    """Run what the journal does not hold yet; each result is a line of it, and at the end the run is one.

    After so many `minutes` nothing new is begun.
    """
    from flightstack.cli.versions import versions

    done = held_in(journal)
    left = [job for job in jobs if job not in done]
    print(f"{len(left)} jobs of {len(jobs)} to do, {processes} processes", flush=True)
    began = time.monotonic()
    journal.parent.mkdir(parents=True, exist_ok=True)
    commit = versions()["git_commit"]
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool, journal.open("a", encoding="utf-8") as out:
        out.write(json.dumps({"run": {"wall_s": 0.0, "git_commit": commit}}) + "\n")  # known even if it is cut off
        count, waiting = 0, iter(left)
        futures = {pool.submit(_tidied, run, job): job for job in islice(waiting, 2 * processes)}
        while futures:
            finished, _ = wait(futures, return_when=FIRST_COMPLETED)
            for future in finished:
                out.write(json.dumps({"job": futures.pop(future), "result": future.result()}) + "\n")
                count += 1
            out.flush()
            spent = time.monotonic() - began
            if spent < 60.0 * minutes:
                futures |= {pool.submit(_tidied, run, job): job for job in islice(waiting, len(finished))}
            if count % 10 == 0 or not futures:
                ahead = spent / count * (len(left) - count)
                print(f"{count} of {len(left)}, {spent / 60:.1f} min, {ahead / 60:.1f} min to go", flush=True)
        out.write(json.dumps({"run": {"wall_s": time.monotonic() - began, "git_commit": commit}}) + "\n")


def _tidied(run: Callable[[Any], Any], job: Any) -> Any:
    """The job's result; what a flight leaves behind in cycles is much for the few objects that the collector counts."""
    try:
        return run(job)
    finally:
        gc.collect()


def processor() -> str:
    """What the machine computes with; times mean little without it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text("utf-8").splitlines() if info.exists() else []
    names = [line.split(": ", 1)[1] for line in lines if line.startswith("model name")]
    return f"{os.cpu_count()} cores of {names[0] if names else platform.processor() or platform.machine()}"


def provenance(schema: str, journal: Path) -> dict[str, Any]:
    """Where and when: the head of results.json."""
    wall_s, commits = runs_in(journal)
    return {
        "schema": schema,
        "date": str(date.today()),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "git_commit": ", then ".join(commits),
        "wall_s": wall_s,
    }


def main(campaign: Campaign) -> int:
    """Fly, gather, write; 1 where the campaign shows a fault."""
    parser = argparse.ArgumentParser(description=campaign.words)
    parser.add_argument("--quick", action="store_true", help="a few of each, into runs/")
    parser.add_argument("--resume", action="store_true", help="keep the results of a campaign that was cut off")
    parser.add_argument("--report-only", action="store_true", help="tables and figures anew")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin nothing new after so long")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    kind = f"campaign-{campaign.name}{'-quick' if options.quick else ''}"
    page = (ROOT / "runs" / kind if options.quick else ROOT / "docs") / campaign.page
    stored = page.with_suffix("") / "results.json"
    if options.report_only:
        results = json.loads(stored.read_text(encoding="utf-8"))
    else:
        from flightstack.cli.compiled import ensure_compiled

        ensure_compiled(print)
        journal = ROOT / "runs" / f"{kind}.jsonl"
        if not options.resume:
            journal.unlink(missing_ok=True)
        jobs = campaign.jobs(options.quick)
        run_all(jobs, campaign.run, journal, options.processes, options.minutes)
        results = provenance(campaign.schema, journal) | campaign.gather(held_in(journal), jobs)
        stored.parent.mkdir(parents=True, exist_ok=True)
        campaign.write_results(results, stored)
    campaign.write_page(results, page, f"make {kind}")
    print(f"wrote {page}", flush=True)
    return 0 if campaign.passed(results) else 1
