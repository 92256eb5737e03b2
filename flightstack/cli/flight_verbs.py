"""The verbs that fly: `fly` and `offboard`, with the options that both have."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from flightstack.cli.exits import BAD_INPUT, FAILED, INTERRUPTED
from flightstack.cli.interrupts import Interrupts
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
from flightstack.cli.shipped import CONTROLLER_WORDS, require_names


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


def flies(verb: Callable[..., tuple[Callable[..., Any], Any]]) -> Callable[..., None]:
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
    return run


@flies
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


@flies
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
