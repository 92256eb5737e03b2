"""The verb `reproduce`; it imports what it needs only when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.options import JsonOption, PlantName, SeedOption


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
    from app import console, files
    from app.cli import FAILED, INTERRUPTED
    from app.interrupts import Interrupts
    from app.reproduce.run import ReproduceOptions
    from app.reproduce.run import reproduce as run

    options = ReproduceOptions(out=out, quick=quick, plant=None if plant is None else plant.value, seed=seed)
    interrupts = Interrupts()
    with console.progress("reproducing") as show:
        result = run(options, stop_requested=interrupts.requested, on_progress=show)
    if result.stopped:
        console.say_error(f"{result.stopped}: the same command goes on from here")
        raise typer.Exit(INTERRUPTED)
    console.show_reproduced(result, out)
    if json is not None:
        files.write_json(json, result.as_json())
    if result.failed:
        console.say_error("; ".join(f"{name}: {why}" for name, why in sorted(result.failed.items())))
        raise typer.Exit(FAILED)
