"""The verb `certify`: explore and certify in flight, certify a stop in a site, or check a file."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from flightstack.cli import options as opt
from flightstack.cli.exits import FAILED, INTERRUPTED, OK
from flightstack.cli.interrupts import Interrupts
from flightstack.cli.options import asks
from flightstack.errors import InputError

if TYPE_CHECKING:
    from flightstack.cli.certify import CertifyResult
    from flightstack.cli.certify_site import SiteCertified
    from flightstack.cli.flight import FlyOptions


_REGION = "paper-barrier"


class _Certify:
    scenario: Annotated[str, typer.Option(help="A shipped scenario with a region, or a .toml file.")] = _REGION
    as_published: Annotated[
        bool, typer.Option("--as-published", help="The paper's own barrier, filter and acceptance, for the record.")
    ] = False
    vehicle: opt.VehicleOption = None
    plant: opt.PlantOption = opt.PlantName.native
    truth: opt.TruthOption = None
    sensors: opt.SensorsOption = None
    site: opt.SiteOption = None
    home: opt.HomeOption = None
    seed: opt.SeedOption = 0
    duration: Annotated[float | None, typer.Option(min=10.0, help="Explore for so many seconds at most.")] = None
    out: opt.OutOption = None
    log_wire: opt.LogWireOption = False
    live: opt.LiveOption = None
    check: Annotated[
        Path | None, typer.Option("--check", help="Fly nothing: let the independent checker verify this file.")
    ] = None
    log: Annotated[
        Path | None, typer.Option("--log", help="With --check: derive the file anew from this log of its flight.")
    ] = None
    json: opt.JsonOption = None


@asks(_Certify)
def certify(given: SimpleNamespace) -> None:
    """Learn the largest certified region in flight, or check a certificate."""
    from flightstack.cli.flight import FlyOptions
    from flightstack.cli.home import parse_home

    asked = dict(vars(given))
    check, log, json, asked["duration_s"] = (asked.pop(name) for name in ("check", "log", "json", "duration"))
    if check is not None:
        _check(check, log, given.vehicle, json)
    if log is not None:
        raise InputError("--log belongs to --check: the log of a new flight lies in --out")
    asked["home"] = parse_home(given.home)
    if given.site is None:
        _explore(FlyOptions(**asked), json)
        return
    from flightstack.cli.certify_site import EXPLORED

    if explores := given.scenario == _REGION:
        asked["scenario"] = EXPLORED
    _certify_site(FlyOptions(**asked), json, explores=explores)


def _check(file: Path, log: Path | None, vehicle: str | None, json: Path | None) -> NoReturn:
    """`certify --check`."""
    from flightstack.cli import console, files
    from flightstack.cli.checking import check_file

    found = check_file(file, log, None if vehicle is None else files.find("vehicles", vehicle).path)
    console.show_checked(str(file), found)
    level = found.level if found.valid else None
    said = {"certificate": str(file), "valid": found.valid, "level": level, "lines": found.lines}
    files.write_json(json, {"schema": "flightstack.check/1", **said})
    raise typer.Exit(OK if found.valid else FAILED)


def _explore(options: FlyOptions, json: Path | None) -> None:
    from flightstack.cli import console, terminal
    from flightstack.cli.certify import certify as run

    interrupts = Interrupts()
    with terminal.progress(f"certifying {options.scenario}") as show:
        result = run(options, stop_requested=interrupts.requested, on_progress=show)
    console.show_certified(result)
    _end(result, interrupts, json)


def _certify_site(options: FlyOptions, json: Path | None, *, explores: bool) -> None:
    """`certify --site`."""
    from flightstack.cli import terminal
    from flightstack.cli.certify_site import certify_site

    interrupts = Interrupts()
    with terminal.progress(f"certifying a stop in {options.site}") as show:
        result = certify_site(options, explores=explores, stop_requested=interrupts.requested, on_progress=show)
    _end(result, interrupts, json)
    print(result.words)


def _end(result: CertifyResult | SiteCertified, interrupts: Interrupts, json: Path | None) -> None:
    """Write the JSON; end with the right code where it did not pass."""
    from flightstack.cli import console, files

    files.write_json(json, result.as_json())
    if interrupts.reason:
        raise typer.Exit(INTERRUPTED)
    if not result.passed:
        console.say_error(result.failure())
        raise typer.Exit(FAILED)
