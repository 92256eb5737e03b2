"""`flightstack campaign`: plans flown by workers, each row kept at once, the tables and the page after."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from flightstack.cli import files
from flightstack.cli.campaign.design import Design
from flightstack.cli.campaign.grouped import markdown
from flightstack.cli.campaign.journal import Entry, Journal
from flightstack.cli.campaign.outcomes import COMPLETED
from flightstack.cli.campaign.plan import Plan, Planner
from flightstack.cli.campaign.pool import Done, Pool
from flightstack.cli.campaign.result import CampaignResult, assess, extremes, replay_name
from flightstack.cli.campaign.spec import CampaignSpec, load_spec
from flightstack.cli.campaign.table import flight_row, require_parquet, write_tables
from flightstack.cli.compiled import ensure_compiled
from flightstack.cli.versions import versions
from flightstack.errors import InputError

OnProgress = Callable[[float, str], None]
_SAMPLE = 1e-3
"""Share of the flights whose log is kept whatever comes of it."""


@dataclass(frozen=True, slots=True)
class CampaignOptions:
    """What `campaign` was asked for."""

    file: Path
    out: Path
    resume: bool = False
    workers: int | None = None
    scheduler: str | None = None
    changes: tuple[str, ...] = ()
    """KEY=VALUE on top of the file."""


class Executor(Protocol):
    """What flies plans: processes here, or a cluster."""

    @property
    def shares(self) -> float:
        """Flights' worth of what is being flown."""

    def __enter__(self) -> Executor:
        """Itself."""

    def __exit__(self, *_: object) -> None:
        """End what it started."""

    def run(self, plans: Iterable[Plan], stop: Callable[[], str], idle: Callable[[], None]) -> Iterator[Done]:
        """Each flight once it is accounted for."""


class Campaign:
    """One campaign at work."""

    def __init__(
        self, spec: CampaignSpec, out: Path, journal: Journal, planner: Planner, stop: Callable[[], str],
        on_progress: OnProgress,
    ) -> None:  # fmt: skip
        self.spec, self.out, self.journal, self.planner = spec, out, journal, planner
        self._stop, self._on_progress = stop, on_progress
        self._began_s, self._flown = time.monotonic(), 0
        self.expected = spec.count
        self.executor: Executor | None = None

    @property
    def stopped(self) -> str:
        """Why nothing more is begun."""
        return self._stop()

    def fly(self, plans: Iterable[Plan]) -> None:
        """Fly what the journal does not hold yet; every row is in the journal when it returns, unless stopped."""
        assert self.executor is not None
        held = self.journal.entries
        left = (self._sampled(plan) for plan in plans if plan.flight not in held)
        for done in self.executor.run(left, self._stop, self._show):
            self.journal.add(self._entry(done))
            self._flown += 1
            self._show()

    def fly_again(self, plans: Sequence[Plan]) -> tuple[int, int]:
        """Fly what is known already once more for its log; (flights, those of them that gave the same row)."""
        assert self.executor is not None
        same, kept = 0, [replace(plan, kept=True) for plan in plans]

        def show() -> None:
            self._on_progress(1.0, f"the {len(plans)} worst flights once more, for their logs")

        for done in self.executor.run(kept, self._stop, show):
            entry, known = self._entry(done), self.journal.entries[done.plan.flight]
            equal = _comparable(entry) == _comparable(known)
            same += equal
            self.journal.update(done.plan.flight, {"log": entry["log"], "report": entry["report"], "equal": equal})
        return len(plans), same

    def _sampled(self, plan: Plan) -> Plan:
        drawn = np.random.default_rng([19, self.spec.design_seed, plan.flight]).random()
        return replace(plan, kept=True) if self.spec.keep == "failures" and drawn < _SAMPLE else plan

    def _entry(self, done: Done) -> Entry:
        plan, row = done.plan, done.row
        log, report = self._keep(done)
        return {
            "flight": plan.flight, "seed": plan.seed, "scenario": plan.scenario, "values": dict(plan.values),
            "outcome": row["outcome"], "reason": row["reason"], "log": log, "report": report, "result": row["result"],
            "timing": {"wall_s": row["wall_s"], "cpu_s": row.get("cpu_s")}
            | {"attempts": done.attempts, "worker": done.worker},
        }  # fmt: skip

    def _keep(self, done: Done) -> tuple[str | None, str | None]:
        """Move what is kept of a flight to its place: its log and its report, from the campaign's folder."""
        flight, found = done.plan.flight, []
        for source, place in (
            ("flight.mcap", f"logs/{flight:06d}.mcap"),
            ("report.html", f"reports/{flight:06d}.html"),
        ):
            lies = done.folder / source
            kept = lies.is_file() and self.spec.keep != "none"
            with suppress(OSError):
                if kept:
                    (self.out / place).parent.mkdir(exist_ok=True)
                    lies.replace(self.out / place)
            found.append(place if kept and (self.out / place).is_file() else None)
        shutil.rmtree(done.folder, ignore_errors=True)
        if found[0] is not None or done.row["outcome"] != COMPLETED:
            self.write_replay(done.plan)
        return found[0], found[1]

    def write_replay(self, plan: Plan) -> None:
        """The flight's scenario file."""
        path = self.out / replay_name(plan.flight)
        with suppress(OSError):
            path.parent.mkdir(exist_ok=True)
            path.write_text(plan.text, encoding="utf-8")

    def _show(self) -> None:
        assert self.executor is not None
        held = self.journal.entries
        known = min(len(held), self.expected)
        failed = sum(count for name, count in self.journal.outcomes.items() if name != COMPLETED)
        flown = self._flown + self.executor.shares
        spent_s = time.monotonic() - self._began_s
        left = (
            "" if flown < 0.5 else f", {_span((self.expected - known - self.executor.shares) * spent_s / flown)} left"
        )
        problem = f" ({self.journal.problem})" if self.journal.problem else ""
        share = min(1.0, (known + self.executor.shares) / max(self.expected, 1))
        self._on_progress(share, f"{len(held)} of {self.expected} flights, {failed} failed{left}{problem}")


def _comparable(entry: Entry) -> dict[str, Any]:
    return {name: value for name, value in flight_row(entry).items() if name not in ("log", "report")}


def _span(seconds: float) -> str:
    seconds = max(seconds, 0.0)
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def campaign(
    options: CampaignOptions, *, stop_requested: Callable[[], str], on_progress: OnProgress = lambda share, phase: None
) -> CampaignResult:
    """Fly a campaign; its tables, summary and page lie in `options.out`."""
    spec = load_spec(options.file, options.changes)
    require_parquet()
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers} is not allowed; it must be at least 1")
    planner = Planner(spec)
    with _executor(options, spec, on_progress) as executor:
        journal = Journal(options.out, _head(spec, planner), resume=options.resume)
        try:
            work = Campaign(spec, options.out, journal, planner, stop_requested, on_progress)
            work.executor = executor
            result = _flown(work)
        finally:
            shutil.rmtree(options.out / "flying", ignore_errors=True)
            journal.close()
    return result


def _drawn(spec: CampaignSpec, planner: Planner) -> Callable[[int], Plan]:
    """Flight -> its plan."""
    design = Design(spec)
    return lambda flight: planner.plan(flight, design.values(flight), spec.seed_of(flight))


def _flown(work: Campaign) -> CampaignResult:
    spec, planner = work.spec, work.planner
    found: dict[str, Any] | None = None
    if spec.search is None:
        plan_of = _drawn(spec, planner)
        work.fly(plan_of(i) for i in range(spec.count))
    else:
        from flightstack.cli.campaign.search import search

        found, plan_of = search(work)
    flown = work.journal.ordered(None if spec.search else spec.count)
    stopped = work.stopped
    reflown = (0, 0)
    if not stopped:
        missing = [i for i in extremes(spec, flown) if work.journal.entries[i].get("equal") is None]
        if spec.keep == "failures" and missing:
            work.fly_again([plan_of(i) for i in missing if work.journal.entries[i]["log"] is None])
        flown = work.journal.ordered(None if spec.search else spec.count)
        stopped = work.stopped
        again = [entry["equal"] for entry in flown if entry.get("equal") is not None]
        reflown = len(again), sum(again)
    work.journal.flush()
    result = assess(spec, flown)
    result.stopped, result.reflown, result.search = stopped, reflown, found
    for row in result.worst:
        work.write_replay(plan_of(row["flight"]))
    write_results(result, work.out)
    if work.journal.problem:
        raise InputError(f"{work.out}: {work.journal.problem}; make room and go on with --resume")
    return result


def write_results(result: CampaignResult, out: Path) -> None:
    """The tables, the summary and the page."""
    from flightstack.cli.campaign.page import render

    write_tables(result.entries, out)
    files.write_json(out / "summary.json", result.as_json())
    if result.table:
        files.write_text(out / "table.md", markdown(result.table))
    files.write_text(out / "report.html", render(result))


def _head(spec: CampaignSpec, planner: Planner) -> Entry:
    return {"schema": "flightstack.campaign-journal/1", "campaign": planner.digest, "version": _version()}


def _version() -> str:
    known = versions()
    return f"{known['flightstack']} {known['git_commit']}".strip()


def _executor(options: CampaignOptions, spec: CampaignSpec, on_progress: OnProgress) -> Executor:
    if options.scheduler is not None:
        from flightstack.cli.campaign.cluster import Cluster

        return Cluster(options.scheduler, options.out / "flying", spec.keep)
    ensure_compiled(lambda text: on_progress(0.0, text))
    return Pool(options.workers or os.cpu_count() or 1, options.out / "flying", spec.keep)
