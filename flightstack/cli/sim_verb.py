"""The verbs `sim` and `warmup`."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from flightstack.cli import options as opt
from flightstack.cli.exits import INTERRUPTED
from flightstack.cli.interrupts import Interrupts
from flightstack.cli.options import asks

if TYPE_CHECKING:
    from flightstack.cli.simulate import SimOptions


def _end_at_once() -> NoReturn:
    """Without taking the interpreter down piece by piece, which takes a second on a busy machine."""
    print("error: interrupted", file=sys.stderr, flush=True)
    os._exit(INTERRUPTED)


class _Sim:
    vehicle: Annotated[str | None, typer.Option(help="Vehicle that flies, effects included: name or .toml file.")] = (
        None
    )
    plant: opt.PlantOption = opt.PlantName.native
    sensors: Annotated[
        opt.SensorGrade | None, typer.Option(help="Grade of sensors and estimate (default: mocap; gps with --px4-hil).")
    ] = None
    seed: opt.SeedOption = 0
    port: Annotated[int, typer.Option(min=1, max=65_495, help="Where the offboard link sends; binds 40 above.")] = (
        14_540
    )
    gcs_port: Annotated[int, typer.Option(min=1, max=65_535, help="Where the ground station's link sends.")] = 14_550
    bind: Annotated[
        str, typer.Option(help="Address of this machine that the links are bound to; 0.0.0.0: all.", metavar="ADDR")
    ] = "127.0.0.1"
    home: opt.HomeOption = None
    instances: Annotated[
        int, typer.Option(min=1, max=100, help="So many vehicles, with PX4's ports and system ids.")
    ] = 1
    sysid: Annotated[int, typer.Option(min=1, max=255, help="MAVLink system id of the (first) vehicle.")] = 1
    speed: Annotated[float, typer.Option(min=0.05, max=50.0, help="Times real time.")] = 1.0
    duration: Annotated[float | None, typer.Option(min=0.1, help="End after so many simulated seconds.")] = None
    fault: opt.FaultOption = None
    px4_hil: opt.PhysicsForPx4Option = False
    hil_port: opt.HilPortOption = 4_560
    log: Annotated[
        Path | None,
        typer.Option("--log", help="Record the truth in this log (.mcap); several vehicles: NAME-1.mcap, ..."),
    ] = None
    log_wire: opt.LogWireOption = False
    live: opt.LiveOption = None
    json: opt.JsonOption = None


@asks(_Sim)
def sim(given: SimpleNamespace) -> None:
    """Simulate a PX4 quadrotor on MAVLink/UDP until Ctrl-C, or be the physics behind a real PX4."""
    interrupts = Interrupts(always=(signal.SIGINT,))  # nothing flies that would have to land: also in the background
    interrupts.at_once = True
    from flightstack.cli.home import parse_home
    from flightstack.cli.simulate import SimOptions

    asked = dict(vars(given))
    px4_hil, json, asked["duration_s"] = (asked.pop(name) for name in ("px4_hil", "json", "duration"))
    _run(SimOptions(**asked | {"home": parse_home(given.home)}), interrupts, px4_hil, json)


def _run(options: SimOptions, interrupts: Interrupts, px4_hil: bool, json: Path | None) -> None:
    from flightstack.cli import files, terminal

    if px4_hil:
        from flightstack.cli.hil import serve as simulate
    else:
        from flightstack.cli.simulate import simulate

    def ready(text: str) -> None:
        interrupts.at_once = False
        print(text, flush=True)

    try:
        result = simulate(
            options,
            stop_requested=interrupts.requested,
            on_ready=ready,
            on_wait=lambda text: print(text, file=sys.stderr, flush=True),
        )
    except KeyboardInterrupt:
        _end_at_once()
    terminal.output.print(f"simulated {result['simulated_s']:.1f} s; {result['missed']} deadlines missed")
    files.write_json(json, result)
    if interrupts.reason:
        raise typer.Exit(INTERRUPTED)


def warmup(
    parts: Annotated[
        list[str] | None,
        typer.Argument(
            help="What to compile: simulator, jsbsim, flight, site, certify, gap (default: all).", metavar="PART"
        ),
    ] = None,
    json: opt.JsonOption = None,
) -> None:
    """Compile everything ahead, so that nothing has to be compiled when it is first used."""
    interrupts = Interrupts(always=(signal.SIGINT,))
    interrupts.at_once = True
    from flightstack.cli import files
    from flightstack.cli.compiled import PARTS, compiled, ensure_compiled
    from flightstack.errors import InputError

    unknown = sorted(set(parts or ()) - set(PARTS))
    if unknown:
        raise InputError(f"warmup {unknown[0]}: there is no such part; there are {', '.join(PARTS)}")
    began_s, done = time.monotonic(), []
    for part in parts or PARTS:
        there = compiled(part)
        try:
            ensure_compiled(lambda text, part=part: print(f"{part}: {text}", flush=True), part)  # type: ignore[misc]
        except KeyboardInterrupt:
            _end_at_once()
        if not compiled(part):
            print(f"error: {part} could not be compiled ahead; it is compiled when it is used", file=sys.stderr)
            raise typer.Exit(1)
        print(f"{part}: {'was compiled before' if there else 'compiled'}", flush=True)
        done.append({"part": part, "was_there": there})
    wall_s = time.monotonic() - began_s
    files.write_json(json, {"schema": "flightstack.warmup/1", "parts": done, "wall_time_s": wall_s})
