"""`flightstack log ...`: what can be done with a log, ours or another's."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from flightstack.cli.options import JsonOption
from flightstack.errors import InputError

log_app = typer.Typer(
    help="Look at a log (.mcap, .ulg, .tlog, .BIN, .csv), convert, export or mend it.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


class Format(StrEnum):
    """Of exported tables."""

    csv = "csv"
    parquet = "parquet"


LogArgument = Annotated[Path, typer.Argument(help="A log: .mcap, .ulg, .tlog, .BIN, .csv, also as .gz.", metavar="LOG")]
ColumnsOption = Annotated[
    Path | None, typer.Option("--columns", help="TOML that says what the columns of a CSV mean.", metavar="FILE")
]
NewMcapOption = Annotated[Path, typer.Option(help="File to write (.mcap); it must not exist yet.", metavar="FILE")]


def _read(path: Path, columns: Path | None) -> Any:
    """The log, through the map of its columns where one is given."""
    from flightstack.cli import files
    from flightstack_logs.columns import parse_columns
    from flightstack_logs.reader import read

    mapped = None
    if columns is not None:
        file = files.read_text(columns)
        mapped = parse_columns(file.text, str(file.path))
    return read(path, mapped)


@log_app.command("info")
def info(log: LogArgument, columns: ColumnsOption = None, json: JsonOption = None) -> None:
    """Say what is in a log: topics, rates, events, settings, and whether it is whole."""
    from flightstack.cli import files, terminal
    from flightstack_logs.info import info as sum_up
    from flightstack_logs.info import render

    summary = sum_up(_read(log, columns))
    terminal.show(render(summary))
    files.write_json(json, summary.as_json())


@log_app.command("report")
def report(
    log: LogArgument,
    out: Annotated[Path, typer.Option(help="Folder for report.html.")],
    columns: ColumnsOption = None,
    json: JsonOption = None,
) -> None:
    """Make the page of a flight from its log, whoever recorded it."""
    from flightstack.cli import files, terminal
    from flightstack_logs.report.log_input import from_log
    from flightstack_logs.report.page import render_report
    from flightstack_logs.standard import with_vehicle_topics

    flown = with_vehicle_topics(_read(log, columns))
    if not any(len(table) for table in flown.tables.values()):
        raise InputError(f"log {log}: holds no table of a flight; there is nothing to show")
    path = out / "report.html"
    files.write_text(path, render_report(from_log(flown)))
    for note in flown.notes:
        terminal.say(f"{log}: {note}")
    terminal.say(str(path))
    files.write_json(json, {"schema": "flightstack.logreport/1", "log": str(log), "report": str(path)})


@log_app.command("convert")
def convert(log: LogArgument, out: NewMcapOption, columns: ColumnsOption = None, json: JsonOption = None) -> None:
    """Write a log of other origin (.ulg, .tlog, .BIN, .csv) as .mcap: its tables, and the vehicle under our topics."""
    from flightstack.cli import files, terminal
    from flightstack_logs.convert import convert as run

    source = _read(log, columns)
    made = run(source, out)
    for note in source.notes:
        terminal.say(f"{log}: {note}")
    terminal.say(f"{made.messages} messages of {made.topics} topics: {out}")
    said = {"log": str(log), "converted": str(out), "messages": made.messages, "topics": made.topics}
    files.write_json(json, {"schema": "flightstack.logconvert/1", **said, "notes": list(source.notes)})


@log_app.command("export")
def export(
    log: LogArgument,
    out: Annotated[Path, typer.Option(help="Folder for one file of each topic.")],
    format: Annotated[Format, typer.Option(help="Kind of files.")] = Format.csv,
    topic: Annotated[
        list[str] | None, typer.Option(help="Only this topic, or pattern such as '/vehicle/*' (may be repeated).")
    ] = None,
    column: Annotated[
        list[str] | None, typer.Option(help="Only this column, or pattern such as 'pos_*' (may be repeated).")
    ] = None,
    columns: ColumnsOption = None,
    json: JsonOption = None,
) -> None:
    """Write the tables of a log as CSV or Parquet; times are log time in seconds."""
    from flightstack.cli import files, terminal
    from flightstack_logs.export import export as run

    source = _read(log, columns)
    made = run(source, out, format.value, tuple(topic or ()), tuple(column or ()))
    for note in source.notes:
        terminal.say(f"{log}: {note}")
    terminal.say(f"{len(made)} files: {out}")
    files.write_json(json, {"schema": "flightstack.logexport/1", "files": [str(path) for path in made]})


@log_app.command("replay")
def replay(
    log: Annotated[Path, typer.Argument(help="A log of `flightstack fly` in lockstep (.mcap).", metavar="LOG")],
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="Numbers count as the same up to this (other machines: 1e-9).")
    ] = 0.0,
    json: JsonOption = None,
) -> None:
    """Run a flight's recorded inputs through today's stack: exit code 1 where an output differs, the first one told."""
    from flightstack.cli import files, terminal
    from flightstack.cli.replay import replay as run

    with terminal.progress(f"replaying {log}") as show:
        result = run(log, tolerance=tolerance, on_progress=show)
    for line in result.lines:
        terminal.say(line)
    files.write_json(json, result.as_json())
    if not result.same:
        raise typer.Exit(1)


@log_app.command("recover")
def recover(
    log: Annotated[Path, typer.Argument(help="A cut-off or damaged .mcap.", metavar="LOG")],
    out: NewMcapOption,
    json: JsonOption = None,
) -> None:
    """Mend a cut-off or damaged .mcap: all that can be read, in a whole file, and what was lost in words."""
    from flightstack.cli import files, terminal
    from flightstack_logs.recover import recover as run

    saved = run(log, out)
    for line in saved.lost or ("nothing was lost: the file was whole",):
        terminal.say(line)
    terminal.say(f"{saved.messages} messages of {saved.topics} topics saved: {out}")
    said = {"log": str(log), "recovered": str(out), "messages": saved.messages, "topics": saved.topics}
    files.write_json(json, {"schema": "flightstack.logrecover/1", **said, "lost": list(saved.lost)})
