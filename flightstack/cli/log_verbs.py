"""`flightstack log ...`: what can be done with a log, ours or another's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flightstack.cli.options import JsonOption

log_app = typer.Typer(help="Look at a flight's log.", no_args_is_help=True, rich_markup_mode=None)


@log_app.command("info")
def info(
    file: Annotated[Path, typer.Argument(help="A log (.mcap).")],
    json: JsonOption = None,
) -> None:
    """Say what is in a log: topics, rates, events, settings, and whether it is whole."""
    from flightstack.cli import files, terminal
    from flightstack_logs.info import info as sum_up
    from flightstack_logs.info import render
    from flightstack_logs.reader import read

    summary = sum_up(read(file))
    terminal.show(render(summary))
    if json is not None:
        files.write_json(json, summary.as_json())
