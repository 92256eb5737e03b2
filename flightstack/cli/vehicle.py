"""`flightstack vehicle new|check|fit`: vehicle files from what people have, what is wrong with one, what logs say."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from flightstack.cli.options import JsonOption
from flightstack.errors import InputError

vehicle_app = typer.Typer(help="Make, check and fit vehicle files.", no_args_is_help=True, rich_markup_mode=None)

SCHEMA = "flightstack.vehicle-check/1"
_ADDRESSES = ("udpin:", "udpout:", "serial:")
_ULOG, _GZIP, _DATAFLASH = b"ULog", b"\x1f\x8b", b"\xa3\x95"
_WAIT_S, _ANSWERS_S = 10.0, 20.0
_SOURCE = "A PX4's address, a log (.ulg, .tlog, .BIN), or a file of its parameters."
FromOption = Annotated[str, typer.Option("--from", help=_SOURCE)]


@vehicle_app.command("new")
def new(
    source: FromOption,
    mass: Annotated[float, typer.Option(help="Take-off mass, kg: no parameter tells it.")],
    out: Annotated[Path, typer.Option(help="The vehicle file to write.")],
    arm: Annotated[float | None, typer.Option(help="Mean distance of the rotors' axes from the centre, m.")] = None,
    name: Annotated[str | None, typer.Option(help="The vehicle's name (default: the file's).")] = None,
) -> None:
    """Write a vehicle file from what a PX4 is set up with; what nothing tells gets a range."""
    from flightstack.cli import files, terminal
    from flightstack.vehicle import parse_vehicle
    from flightstack.vehicle_new import vehicle_text

    for value, low, high, what in ((mass, 0.005, 100.0, "--mass"), (arm, 0.01, 3.0, "--arm")):
        if value is not None and not low <= value <= high:
            raise InputError(f"{what} {value:g} is not allowed; it must be {low:g} to {high:g}")
    called = name or out.stem
    if not called.isprintable() or '"' in called or "\\" in called:
        raise InputError(f"--name {called!r}: give the vehicle a name of plain printable characters")
    text = vehicle_text(parameters(source), name=called, mass_kg=mass, arm_m=arm, source=Path(source).name)
    parse_vehicle(text, str(out))  # what is written can be flown
    files.write_text(out, text)
    terminal.output.print(f"wrote {out}: look at its ranges, and narrow them by docs/vehicle.md", soft_wrap=True)


@vehicle_app.command("check")
def check(
    file: Annotated[str, typer.Argument(help="The vehicle file: a name or a .toml file.")],
    against: Annotated[str | None, typer.Option(help=_SOURCE)] = None,
    json: JsonOption = None,
) -> None:
    """Say what is wrong with a vehicle file, one line each; exit 1 where anything is."""
    from flightstack.airframe import contradictions, unsettled_hover
    from flightstack.cli import files, terminal
    from flightstack.cli.exits import FAILED
    from flightstack.model import Model
    from flightstack.plausibility import implausible

    vehicle, _ = files.load_vehicle(file)
    lines, notes = implausible(vehicle), []
    if against is not None and not lines:
        values, hover = parameters(against), Model.from_vehicle(vehicle).hover_norm
        lines = contradictions(values, vehicle, hover)
        notes = [note for note in (unsettled_hover(values, hover),) if note]
    for line in (*lines, *notes):
        terminal.say(line)
    result = {"schema": SCHEMA, "vehicle": vehicle.name, "contradictions": lines, "warnings": notes}
    files.write_json(json, result)
    if lines:
        raise typer.Exit(FAILED)
    terminal.output.print(f"{file}: nothing speaks against it" + (f" by {against}" if against else ""), soft_wrap=True)


@vehicle_app.command("fit")
def fit(
    logs: Annotated[list[Path], typer.Argument(help="Logs of the vehicle; several are fitted together.")],
    vehicle: Annotated[str, typer.Option(help="The vehicle file; its ranges say what is free.")],
    out: Annotated[Path, typer.Option(help="The vehicle file to write.")],
    columns: Annotated[str | None, typer.Option(help="Maps another CSV's columns: a TOML or a shipped name.")] = None,
    ground_d: Annotated[float, typer.Option(help="The ground's pos_d_m.")] = 0.0,
    json: JsonOption = None,
) -> None:
    """Say what logs tell of every number of a vehicle file, and write the file with the estimates and their ranges."""
    from flightstack.cli import files, terminal
    from flightstack.cli.vehicle_fit import as_json, fit_file, lines

    done, text = fit_file(logs, vehicle, columns, ground_d)
    files.write_text(out, text)
    for line in lines(done):
        terminal.say(line)
    terminal.say(f"wrote {out}")
    files.write_json(json, as_json(done, [str(path) for path in logs], vehicle))


def parameters(source: str) -> dict[str, float]:
    """PX4's parameters of a vehicle at an address, of a log, or of a file; InputError, one line."""
    if source.startswith(_ADDRESSES):
        return _from_vehicle(source)
    path = Path(source)
    try:
        with path.open("rb") as file:
            head = file.read(4)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    if head == _ULOG or head[:2] in (_GZIP, _DATAFLASH) or path.suffix.lower() == ".tlog":
        return _from_log(path)
    from flightstack.cli.files import read_text
    from mavlink_bridge.param_file import listed_params

    return listed_params(read_text(path).text, str(path))


def _from_log(path: Path) -> dict[str, float]:
    from flightstack_logs.ardupilot import as_px4
    from flightstack_logs.reader import read

    log = read(path)
    told = {name: float(value) for name, value in log.metadata.get("parameters", {}).items()}
    if not told:
        raise InputError(f"log {path}: holds no parameters; a ULog of a PX4 does")
    is_px4 = "SYS_AUTOSTART" in told or log.kind == "ulog"
    return told if is_px4 else as_px4(told, str(path))


def _from_vehicle(source: str) -> dict[str, float]:
    from flightstack.cli.set_params import VehicleLink
    from flightstack.vehicle_new import BATTERY, NEEDED
    from mavlink_bridge import messages
    from mavlink_bridge.transport.address import open_address, parse_address

    address = parse_address(source)
    messages.prepare()
    with closing(open_address(address)) as transport:
        wire = VehicleLink(transport, address, None, _WAIT_S)
        session = wire.session(list(NEEDED))
        if not wire.run(session, lambda: session.identified, _WAIT_S):
            raise InputError(f"{source}: {session.problem or f'no PX4 answered within {_WAIT_S:g} s'}")
        if not wire.run(session, lambda: session.settled, _ANSWERS_S):
            raise InputError(f"{source}: {session.problem or 'the vehicle does not tell its parameters'}")
        more = wire.session(list(BATTERY))  # a PX4 may lack them
        wire.run(more, lambda: more.settled, _ANSWERS_S)
        return {name: stored.value for name, stored in {**session.stored, **more.stored}.items()}
