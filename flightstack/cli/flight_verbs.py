"""The verbs that fly: `fly` and `offboard`, with the options that both have."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from flightstack.cli import options as opt
from flightstack.cli.exits import BAD_INPUT, FAILED, INTERRUPTED
from flightstack.cli.interrupts import Interrupts
from flightstack.cli.options import asks
from flightstack.cli.shipped import CONTROLLER_WORDS, require_names
from flightstack.errors import InputError


class FlightCommand(TyperCommand):
    """A verb that flies: its help ends with what its options may name."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Name the controllers."""
        with formatter.section("Controllers"):
            formatter.write_dl(list(CONTROLLER_WORDS.items()))


class _Flight:
    """The options that every verb that flies has."""

    vehicle: opt.VehicleOption = None
    duration: opt.DurationOption = None
    controller: opt.ControllerOption = "flatness"
    no_learning: opt.NoLearningOption = False
    learned: opt.LearnedOption = None
    no_filter: opt.NoFilterOption = False
    as_published: opt.AsPublishedOption = False
    certificate: opt.CertificateOption = None
    site: opt.SiteOption = None
    unprotected_ok: opt.UnprotectedOption = False
    log: opt.LogOption = None
    log_wire: opt.LogWireOption = False
    live: opt.LiveOption = None
    out: opt.OutOption = None
    json: opt.JsonOption = None


def _asked(given: SimpleNamespace) -> dict[str, Any]:
    """What a verb was given, as `FlightOptions` and those of the verbs name it."""
    asked = dict(vars(given))
    del asked["json"]
    unlearned, unfiltered, asked["duration_s"] = (asked.pop(key) for key in ("no_learning", "no_filter", "duration"))
    return asked | {"learning": not unlearned, "filtering": not unfiltered}


def _finish_flight(fly: Callable[..., Any], options: Any, json_file: Path | None) -> None:
    """Fly, show, write the JSON, and end with the right code."""
    from flightstack.cli import console, files, terminal

    interrupts = Interrupts()

    def kept(result: Any) -> bool:
        """Before the page is made: what that costs may end the process, and the result would be lost."""
        if json_file is not None and not files.is_stream(json_file):
            with suppress(InputError):  # said below, when the page is made
                files.write_json(json_file, result.as_json())
        return True

    with terminal.progress(f"flying {options.scenario}") as show:
        result = fly(options, stop_requested=interrupts.requested, on_progress=show, report_wanted=kept)
    console.show_result(result)
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


class _Fly:
    scenario: opt.ScenarioArgument = "paper-tracking"
    waypoints: opt.WaypointsArgument = None
    named: Annotated[str | None, typer.Option("--scenario", help="The same as SCENARIO, as other verbs have it.")] = (
        None
    )
    realtime: Annotated[bool, typer.Option("--realtime", help="Fly at 250 Hz of real time, not in lockstep.")] = False
    plant: opt.PlantOption = opt.PlantName.native
    sensors: opt.SensorsOption = None
    truth: opt.TruthOption = None
    seed: opt.SeedOption = 0
    fault: opt.FaultOption = None
    home: opt.HomeOption = None
    px4_hil: opt.PhysicsForPx4Option = False
    hil_port: opt.HilPortOption = 4_560


@asks(_Fly, _Flight)
def fly(given: SimpleNamespace) -> None:
    """Fly a scenario: simulator and companion in one process, over MAVLink/UDP on loopback."""
    given.scenario = vars(given).pop("named") or given.scenario
    require_names(given.scenario, given.controller, given.vehicle, given.truth)
    from flightstack.cli.flight import FlyOptions
    from flightstack.cli.flight import fly as run
    from flightstack.cli.hil_flight import fly_behind_px4
    from flightstack.cli.home import parse_home

    asked = _asked(given)
    hil = asked.pop("px4_hil")
    options = FlyOptions(**asked | {"realtime": given.realtime or hil, "home": parse_home(given.home)})
    _finish_flight(fly_behind_px4 if hil else run, options, given.json)


class _Offboard:
    connect: Annotated[str, typer.Option(help="udpin:HOST:PORT, udpout:HOST:PORT or serial:DEVICE:BAUD.")]
    scenario: Annotated[str, typer.Option(help="A shipped scenario, a .toml file, or `waypoints`.")] = "hover"
    waypoints: Annotated[str | None, typer.Option(help="The file of `--scenario waypoints`.")] = None
    arm: Annotated[bool, typer.Option("--arm", help="Select OFFBOARD and arm; else the pilot does both.")] = False
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Connect and check; send no setpoint.")] = False
    believe_file: opt.BelieveFileOption = False
    set_params: opt.SetParamsOption = None
    sensors: opt.SensorsOption = None
    timeout: Annotated[float, typer.Option(min=0.1, help="Seconds to wait for the first heartbeat.")] = 10.0
    signing_key: opt.SigningKeyOption = None
    no_dead_man: Annotated[
        bool, typer.Option("--no-dead-man", help="Nobody answers the companion's silence: COM_OF_LOSS_T <= 0.5 s.")
    ] = False


@asks(_Offboard, _Flight)
def offboard(given: SimpleNamespace) -> None:
    """Fly a scenario on a PX4: a real one, or `flightstack sim` in another process."""
    require_names(given.scenario, given.controller, given.vehicle, None)
    from flightstack.cli.offboard import OffboardOptions
    from flightstack.cli.offboard import offboard as run

    asked = _asked(given)
    options = OffboardOptions(heartbeat_timeout_s=asked.pop("timeout"), dead_man=not asked.pop("no_dead_man"), **asked)
    _finish_flight(run, options, given.json)
