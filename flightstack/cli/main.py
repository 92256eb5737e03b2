"""The command line `flightstack`.  Verbs import what they need only when they run."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a second BLAS thread beside a busy core costs 100 ms
os.environ.setdefault("OMP_NUM_THREADS", "1")

import inspect
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from flightstack.cli.campaign.verb import campaign
from flightstack.cli.interrupts import Interrupts
from flightstack.cli.log_verbs import log_app
from flightstack.cli.options import (
    AsPublishedOption,
    BelieveFileOption,
    CertificateOption,
    ControllerOption,
    DurationOption,
    FaultOption,
    HilPortOption,
    JsonOption,
    LearnedOption,
    LiveOption,
    LogOption,
    LogWireOption,
    NoFilterOption,
    NoLearningOption,
    OutOption,
    PhysicsForPx4Option,
    PlantName,
    PlantOption,
    ScenarioArgument,
    SeedOption,
    SensorsOption,
    SetParamsOption,
    SigningKeyOption,
    SiteOption,
    TruthOption,
    UnprotectedOption,
    VehicleOption,
    WaypointsArgument,
)
from flightstack.cli.shield_verb import shield
from flightstack.cli.shipped import CONTROLLER_WORDS, require_names, shipped_names
from flightstack.cli.sim_verb import sim, warmup
from flightstack.cli.vehicle import vehicle_app
from flightstack.errors import InputError
from flightstack_paper.verb import reproduce

_LIVE_PORT = 8765
OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

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


class FlightCommand(TyperCommand):
    """A verb that flies: its help ends with what its options may name."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Name the controllers."""
        with formatter.section("Controllers"):
            formatter.write_dl(list(CONTROLLER_WORDS.items()))


def _flight_options(
    vehicle: VehicleOption = None,
    duration: DurationOption = None,
    controller: ControllerOption = "flatness",
    no_learning: NoLearningOption = False,
    learned: LearnedOption = None,
    no_filter: NoFilterOption = False,
    as_published: AsPublishedOption = False,
    certificate: CertificateOption = None,
    site: SiteOption = None,
    unprotected_ok: UnprotectedOption = False,
    log: LogOption = None,
    log_wire: LogWireOption = False,
    live: LiveOption = None,
    out: OutOption = None,
) -> dict[str, Any]:
    """The options that every verb that flies has, as `FlightOptions` names them."""
    return {
        "vehicle": vehicle,
        "duration_s": duration,
        "controller": controller,
        "learning": not no_learning,
        "learned": learned,
        "filtering": not no_filter,
        "as_published": as_published,
        "certificate": certificate,
        "site": site,
        "unprotected_ok": unprotected_ok,
        "log": log,
        "log_wire": log_wire,
        "live": live,
        "out": out,
    }


def _finish_flight(fly: Callable[..., Any], options: Any, json_file: Path | None) -> None:
    """Fly, show, write the JSON, and end with the right code."""
    from flightstack.cli import console, files, terminal

    interrupts = Interrupts()
    with terminal.progress(f"flying {options.scenario}") as show:
        result = fly(options, stop_requested=interrupts.requested, on_progress=show)
    console.show_result(result)
    if json_file is not None:
        files.write_json(json_file, result.as_json())
    if interrupts.reason:
        raise typer.Exit(INTERRUPTED)
    if result.contradictions:
        for line in result.contradictions:
            console.say_error(line)
        raise typer.Exit(BAD_INPUT)
    if not result.passed:
        console.say_error(result.failure())
        raise typer.Exit(BAD_INPUT if result.link_too_slow else FAILED)


def _flies(verb: Callable[..., tuple[Callable[..., Any], Any]]) -> Callable[..., None]:
    """Make a function that gives (what flies, its options) a verb, whose options `_flight_options` join as `common`."""
    own = inspect.signature(verb, eval_str=True).parameters
    shared = inspect.signature(_flight_options, eval_str=True).parameters
    json = inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=JsonOption)
    offered = [option for name, option in own.items() if name != "common"] + [*shared.values(), json]

    @wraps(verb)
    def run(**given: Any) -> None:
        json_file = given.pop("json")
        require_names(given["scenario"], given["controller"], given["vehicle"], given.get("truth"))
        common = _flight_options(**{name: given.pop(name) for name in shared})
        _finish_flight(*verb(**given, common=common), json_file)

    run.__signature__ = inspect.Signature(offered)  # type: ignore[attr-defined]
    run.__annotations__ = {option.name: option.annotation for option in offered}
    return app.command(cls=FlightCommand)(run)


@_flies
def fly(
    scenario: ScenarioArgument = "paper-tracking",
    waypoints: WaypointsArgument = None,
    realtime: Annotated[bool, typer.Option("--realtime", help="Fly at 250 Hz of real time, not in lockstep.")] = False,
    plant: PlantOption = PlantName.native,
    sensors: SensorsOption = None,
    truth: TruthOption = None,
    seed: SeedOption = 0,
    fault: FaultOption = None,
    px4_hil: PhysicsForPx4Option = False,
    hil_port: HilPortOption = 4_560,
    *,
    common: dict[str, Any],
) -> tuple[Callable[..., Any], Any]:
    """Fly a scenario: simulator and companion in one process, over MAVLink/UDP on loopback."""
    from flightstack.cli.flight import FlyOptions
    from flightstack.cli.flight import fly as run
    from flightstack.cli.hil_flight import fly_behind_px4

    return fly_behind_px4 if px4_hil else run, FlyOptions(
        scenario=scenario,
        waypoints=waypoints,
        truth=truth,
        sensors=sensors.value if sensors else None,
        seed=seed,
        plant=plant.value,
        realtime=realtime or px4_hil,
        fault=fault,
        hil_port=hil_port,
        **common,
    )


@_flies
def offboard(
    connect: Annotated[str, typer.Option(help="udpin:HOST:PORT, udpout:HOST:PORT or serial:DEVICE:BAUD.")],
    scenario: Annotated[str, typer.Option(help="A shipped scenario, a .toml file, or `waypoints`.")] = "hover",
    waypoints: Annotated[str | None, typer.Option(help="The file of `--scenario waypoints`.")] = None,
    arm: Annotated[bool, typer.Option("--arm", help="Select OFFBOARD and arm; else the pilot does both.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Connect and check; send no setpoint.")] = False,
    believe_file: BelieveFileOption = False,
    set_params: SetParamsOption = None,
    sensors: SensorsOption = None,
    timeout: Annotated[float, typer.Option(min=0.1, help="Seconds to wait for the first heartbeat.")] = 10.0,
    signing_key: SigningKeyOption = None,
    no_dead_man: Annotated[
        bool, typer.Option("--no-dead-man", help="Nobody answers the companion's silence: COM_OF_LOSS_T <= 0.5 s.")
    ] = False,
    *,
    common: dict[str, Any],
) -> tuple[Callable[..., Any], Any]:
    """Fly a scenario on a PX4: a real one, or `flightstack sim` in another process."""
    from flightstack.cli.offboard import OffboardOptions
    from flightstack.cli.offboard import offboard as run

    return run, OffboardOptions(
        connect=connect,
        scenario=scenario,
        waypoints=waypoints,
        arm=arm,
        dry_run=dry_run,
        believe_file=believe_file,
        set_params=set_params,
        sensors=sensors.value if sensors else None,
        heartbeat_timeout_s=timeout,
        signing_key=signing_key,
        dead_man=not no_dead_man,
        **common,
    )


def _certify_site(options: Any, interrupts: Interrupts, json_file: Path | None) -> None:
    """`certify --site`."""
    from flightstack.cli import console, files, terminal
    from flightstack.cli.certify_site import certify_site

    with terminal.progress(f"certifying a stop in {options.site}") as show:
        result = certify_site(options, stop_requested=interrupts.requested, on_progress=show)
    if json_file is not None:
        files.write_json(json_file, result.as_json())
    if interrupts.reason:
        raise typer.Exit(INTERRUPTED)
    if not result.passed:
        console.say_error(result.failure())
        raise typer.Exit(FAILED)
    made = result.as_json()
    print(f"certificate {made['certificate']}: {made['radius_m']:.2f} m at rest, stops within {made['stops_within_m']}")


@app.command()
def certify(
    scenario: Annotated[str, typer.Option(help="A shipped scenario with a region, or a .toml file.")] = "paper-barrier",
    as_published: Annotated[
        bool, typer.Option("--as-published", help="The paper's own barrier, filter and acceptance, for the record.")
    ] = False,
    vehicle: VehicleOption = None,
    plant: PlantOption = PlantName.native,
    truth: TruthOption = None,
    sensors: SensorsOption = None,
    site: SiteOption = None,
    seed: SeedOption = 0,
    duration: Annotated[float | None, typer.Option(min=10.0, help="Explore for so many seconds at most.")] = None,
    out: OutOption = None,
    log_wire: LogWireOption = False,
    live: LiveOption = None,
    check: Annotated[
        Path | None, typer.Option("--check", help="Fly nothing: let the independent checker verify this file.")
    ] = None,
    log: Annotated[
        Path | None, typer.Option("--log", help="With --check: derive the file anew from this log of its flight.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Learn the largest certified region in flight, or check a certificate."""
    from flightstack.cli import console, files, terminal
    from flightstack.cli.certify import certify as run
    from flightstack.cli.checking import check_file
    from flightstack.cli.flight import FlyOptions

    if check is not None:
        found = check_file(check, log, None if vehicle is None else files.find("vehicles", vehicle).path)
        console.show_checked(str(check), found)
        if json is not None:
            level = found.level if found.valid else None
            said = {"certificate": str(check), "valid": found.valid, "level": level, "lines": found.lines}
            files.write_json(json, {"schema": "flightstack.check/1", **said})
        raise typer.Exit(OK if found.valid else FAILED)
    if log is not None:
        from flightstack.types import InputError

        raise InputError("--log belongs to --check: the log of a new flight lies in --out")
    if site is not None and scenario == "paper-barrier":
        scenario = "figure8"
    options = FlyOptions(
        scenario=scenario,
        as_published=as_published,
        vehicle=vehicle,
        plant=plant.value,
        truth=truth,
        sensors=sensors.value if sensors else None,
        site=site,
        seed=seed,
        duration_s=duration,
        out=out,
        log_wire=log_wire,
        live=live,
    )
    interrupts = Interrupts()
    if site is not None:
        _certify_site(options, interrupts, json)
        return
    with terminal.progress(f"certifying {scenario}") as show:
        result = run(options, stop_requested=interrupts.requested, on_progress=show)
    console.show_certified(result)
    if json is not None:
        files.write_json(json, result.as_json())
    if interrupts.reason:
        raise typer.Exit(INTERRUPTED)
    if not result.passed:
        console.say_error(result.failure())
        raise typer.Exit(FAILED)


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
    if json is not None:
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
    if json is not None:
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
    from flightstack.cli import console, files, terminal
    from flightstack.cli.gap import GapOptions, find_gap
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
    console.show_gap(result, out)
    if json is not None:
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
        print(f"error: {' '.join(error.format_message().split())} (see --help)", file=sys.stderr)
        code = BAD_INPUT
    except InputError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        code = BAD_INPUT
    except KeyboardInterrupt:
        print("error: interrupted", file=sys.stderr)
        code = INTERRUPTED
    sys.exit(code if isinstance(code, int) else OK)


if __name__ == "__main__":
    main()
