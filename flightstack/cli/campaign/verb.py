"""The verb `campaign`; it imports what it needs only when it runs."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flightstack.cli.options import JsonOption

if TYPE_CHECKING:
    from flightstack.cli.campaign.result import CampaignResult

_EVERY_S = 10.0


def campaign(
    file: Annotated[Path, typer.Argument(help="Campaign file (.toml): what is varied, how often, what is kept.")],
    out: Annotated[Path, typer.Option(help="Folder for the tables, summary.json, report.html and the kept logs.")],
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the campaign in --out; what was flown is not flown again.")
    ] = False,
    workers: Annotated[int | None, typer.Option(help="Processes on this machine (default: one for each core).")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Fly on a Dask cluster: its scheduler's address.", metavar="ADDR")
    ] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="KEY=VALUE (TOML) on top of the file; may be repeated.")
    ] = None,
    minutes: Annotated[float | None, typer.Option(help="Stop after so long; --resume goes on.", min=0.0)] = None,
    json: JsonOption = None,
) -> None:
    """Fly many flights from one file and count what comes of them, or search for the worst one."""
    from flightstack.cli import files, terminal
    from flightstack.cli.campaign.run import CampaignOptions
    from flightstack.cli.campaign.run import campaign as run
    from flightstack.cli.console import say_error
    from flightstack.cli.exits import INTERRUPTED
    from flightstack.cli.interrupts import Interrupts

    interrupts, due_s, began_s = Interrupts(), 0.0, time.monotonic()

    def stop() -> str:
        late = minutes is not None and time.monotonic() - began_s > 60.0 * minutes
        return interrupts.requested() or (f"--minutes {minutes:g} are over" if late else "")

    with terminal.progress("campaign") as show:

        def told(share: float, phase: str) -> None:
            nonlocal due_s
            if terminal.errors.is_terminal or time.monotonic() >= due_s:
                due_s = time.monotonic() + _EVERY_S
                show(share, phase)

        options = CampaignOptions(file, out, resume, workers, scheduler, tuple(changes or ()))
        result = run(options, stop_requested=stop, on_progress=told)
    show_campaign(result, out)
    files.write_json(json, result.as_json())
    if result.stopped:
        say_error(f"{result.stopped}: the same command with --resume goes on from here")
    if interrupts.requested():
        raise typer.Exit(INTERRUPTED)
    if result.too_many_failures:
        say_error(result.too_many_failures)
        raise typer.Exit(1)


def show_campaign(result: CampaignResult, out: Path) -> None:
    """Outcomes with their intervals, what drives the failures, the worst flights, where everything lies."""
    from flightstack.cli.campaign.grouped import shown
    from flightstack.cli.terminal import say

    say(f"{result.spec.path.name}: {len(result.entries)} flights")
    for row in result.rates:
        if row["count"] or row["of"] == "completed":
            low, high = (100.0 * end for end in row["ci95"])
            say(f" {row['of']:<16}{row['count']:>7}  {100.0 * row['rate']:.3g} % (95 %: {low:.3g} to {high:.3g} %)"
                if row["rate"] is not None else f" {row['of']:<16}{row['count']:>7}")  # fmt: skip
    for each in result.influences[:3]:
        if each.p_value < 0.05:
            say(f" failures depend on {each.factor}: {each.words} (influence {each.effect:.2f}, p {each.p_value:.1g})")
    flights, equal = result.reflown
    if flights and equal < flights:
        say(f" {flights - equal} of {flights} flights that were flown again for their logs came out differently")
    for row in result.table:
        say(" " + ", ".join(f"{head} {shown(value)}" for head, value in row.items()))
    told: set[str] = set()
    for row in result.worst:
        if row["of"] not in told:
            told.add(row["of"])
            say(
                f" worst {row['of']}: {row['value']:.4g}, flight {row['flight']}: "
                f"flightstack {result.spec.verb} {out / row['replay']}"
            )
    for name, value in (result.search or {}).items():
        say(f" {name}: {value}")
    for name in ("flights.parquet", "timings.parquet", "summary.json", "report.html"):
        say(f" {name:<16}{out / name}")
