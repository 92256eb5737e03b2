"""The verb `reproduce`; it imports what it needs only when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flightstack.cli.options import JsonOption, PlantName, SeedOption

if TYPE_CHECKING:
    from flightstack_paper.run import ReproduceResult


def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for results.json, report.html and the figures.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer and shorter flights, native plant only: minutes.")
    ] = False,
    plant: Annotated[
        PlantName | None, typer.Option(help="Fly on this plant alone (default: native, and in a full run JSBSim too).")
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Compute every figure and number of the paper anew, beside what it says; an interrupted run goes on."""
    from flightstack.cli import console, files, terminal
    from flightstack.cli.exits import FAILED, INTERRUPTED
    from flightstack.cli.interrupts import Interrupts
    from flightstack_paper.run import ReproduceOptions
    from flightstack_paper.run import reproduce as run

    options = ReproduceOptions(out=out, quick=quick, plant=None if plant is None else plant.value, seed=seed)
    interrupts = Interrupts()
    with terminal.progress("reproducing") as show:
        result = run(options, stop_requested=interrupts.requested, on_progress=show)
    if result.stopped:
        console.say_error(f"{result.stopped}: the same command goes on from here")
        raise typer.Exit(INTERRUPTED)
    show_reproduced(result, out)
    files.write_json(json, result.as_json())
    if result.failed:
        console.say_error("; ".join(f"{name}: {why}" for name, why in sorted(result.failed.items())))
        raise typer.Exit(FAILED)


def show_reproduced(result: ReproduceResult, out: Path) -> None:
    """The paper's claims beside what was measured, and why some don't hold."""
    from rich.markup import escape
    from rich.table import Table

    from flightstack.cli import terminal
    from flightstack.cli.terminal import output, show
    from flightstack_paper.page import shown

    table = Table(title="the paper, side by side", title_justify="left", box=None)
    for column in ("row", "claim", "paper", "ours", "holds"):
        table.add_column(column, overflow="fold")
    for row in result.rows:
        word = "[green]yes[/]" if row.holds else "[red]no[/]" if row.ours is not None else "[red]not measured[/]"
        figures = (escape(shown(value, row.unit)) for value in (row.paper, row.ours))
        table.add_row(row.id, escape(row.claim), *figures, word)
    show(table)
    output.print("\nwhat does not hold, and why")
    for row in result.rows:
        if not row.holds:
            output.print(f" {row.id}: {row.note}", markup=False)
    for name in ("results.json", "report.html"):
        terminal.say(f" {name:<14}{out / name}")
