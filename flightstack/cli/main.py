"""The command line `flightstack`.  Verbs import what they need only when they run."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a second BLAS thread beside a busy core costs 100 ms
os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from flightstack.cli.campaign.verb import campaign
from flightstack.cli.certify_verb import certify
from flightstack.cli.exits import BAD_INPUT, INTERRUPTED, OK
from flightstack.cli.flight_verbs import FlightCommand, fly, offboard
from flightstack.cli.log_verbs import log_app
from flightstack.cli.options import JsonOption
from flightstack.cli.shield_verb import shield
from flightstack.cli.shipped import shipped_names
from flightstack.cli.sim_verb import sim, warmup
from flightstack.cli.vehicle import vehicle_app
from flightstack.errors import InputError, one_line
from flightstack_paper.verb import reproduce

_LIVE_PORT = 8765

_USAGE_ERRORS: Any = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")

app = typer.Typer(
    name="flightstack",
    help="Offboard flight stack for PX4, its simulator and its logs.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _show_version(wanted: bool) -> None:
    if not wanted:
        return
    from flightstack.cli.versions import commit, version_of

    known = commit()
    print(f"flightstack {version_of('flightstack')}" + (f" ({known})" if known else ""))
    raise typer.Exit()


@app.callback()
def _everywhere(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version and exit.")
    ] = False,
) -> None:
    """Options of the program itself."""


app.command(cls=FlightCommand)(fly)
app.command(cls=FlightCommand)(offboard)
app.command()(certify)


@app.command()
def scenarios(json: JsonOption = None) -> None:
    """List the shipped scenarios."""
    from flightstack.cli import console, files

    rows = []
    for name in shipped_names("scenarios"):
        scenario, _ = files.load_scenario(name)
        rows.append((name, f"{scenario.duration_s:.3g} s", scenario.sensors, scenario.description))
    rows.append(("waypoints FILE", "", "mocap", "minimum-snap flight through the waypoints of a file"))
    console.show_table("scenarios", ("name", "track", "sensors", "what it is"), rows)
    keys = ("name", "duration", "sensors", "description")
    listed = [dict(zip(keys, row, strict=True)) for row in rows]
    files.write_json(json, {"schema": "flightstack.scenarios/1", "scenarios": listed})


@app.command()
def learn(
    logs: Annotated[list[Path], typer.Argument(help="Logs of flights (.mcap), with or without learning.")],
    vehicle: Annotated[str | None, typer.Option(help="Believed vehicle (default: the one in the first log).")] = None,
    out: Annotated[Path, typer.Option(help="File to write, for `--learned`.")] = Path("learned.json"),
    json: JsonOption = None,
) -> None:
    """Fit the learner's hyper-parameters to recorded flights."""
    from flightstack.cli import files, terminal
    from flightstack.cli.learn import learn as run

    stored = run(logs, vehicle, out)
    terminal.output.print(f"fitted to {stored.windows} points of vehicle {stored.vehicle}: {out}", soft_wrap=True)
    hashes = {"vehicle_hash": stored.vehicle_hash, "data_hash": stored.data_hash}
    result = {"schema": "flightstack.learn/1", "learned": str(out), "vehicle": stored.vehicle}
    files.write_json(json, result | hashes | {"windows": stored.windows})


@app.command()
def gap(
    logs: Annotated[list[Path], typer.Argument(help="Logs of flights: .mcap, .ulg, .csv (also .gz), .cfusdlog.")],
    vehicle: Annotated[str, typer.Option(help="Vehicle file whose model is compared: name or .toml file.")],
    out: Annotated[Path, typer.Option(help="Folder for gap.json, vehicle.toml and report.html.")],
    holdout: Annotated[
        list[Path] | None, typer.Option(help="A log kept for the verdict (may be repeated; default: last thirds).")
    ] = None,
    columns: Annotated[
        str | None, typer.Option(help="TOML that maps a log's columns, units and frames, or a name that comes along.")
    ] = None,
    ground_d: Annotated[float, typer.Option("--ground-d", help="Where the ground lies: down coordinate, m.")] = 0.0,
    kinematics_only: Annotated[
        bool, typer.Option("--kinematics-only", help="Allow logs without motors: data check and sensor effects.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Find, name, add and verify what the model of a vehicle lacks in logs of its flights."""
    from flightstack.cli import files, terminal
    from flightstack.cli.gap import GapOptions, find_gap, show_gap
    from flightstack.gap.result import as_json

    options = GapOptions(
        logs=tuple(logs),
        vehicle=vehicle,
        out=out,
        holdout=tuple(holdout or ()),
        columns=columns,
        ground_d_m=ground_d,
        kinematics_only=kinematics_only,
    )
    with terminal.progress("gap") as show:
        result = find_gap(options, on_progress=show)
    show_gap(result, out)
    files.write_json(json, as_json(result))


app.command()(campaign)
app.command()(shield)
app.command()(sim)
app.command()(warmup)
app.command()(reproduce)
app.add_typer(log_app, name="log")
app.add_typer(vehicle_app, name="vehicle")


def _with_ports(arguments: list[str]) -> list[str]:
    """`--live` alone names its usual port."""
    followed = [*arguments[1:], ""]
    bare = [a == "--live" and not after.lstrip("-").isdigit() for a, after in zip(arguments, followed, strict=True)]
    return [f"--live={_LIVE_PORT}" if alone else a for a, alone in zip(arguments, bare, strict=True)]


def main(arguments: list[str] | None = None) -> None:
    """Entry point: no traceback for the user's mistakes, one line and exit code 2."""
    try:
        code = app(
            _with_ports(sys.argv[1:] if arguments is None else arguments),
            standalone_mode=False,
            prog_name="flightstack",
        )
    except typer.Abort:
        code = INTERRUPTED
    except _USAGE_ERRORS as error:
        print(f"error: {one_line(error.format_message())} (see --help)", file=sys.stderr)
        code = BAD_INPUT
    except InputError as error:
        print(f"error: {one_line(str(error))}", file=sys.stderr)
        code = BAD_INPUT
    except KeyboardInterrupt:
        print("error: interrupted", file=sys.stderr)
        code = INTERRUPTED
    sys.exit(code if isinstance(code, int) else OK)
