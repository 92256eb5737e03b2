"""The verb `shield`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flightstack.cli.exits import FAILED, INTERRUPTED
from flightstack.cli.interrupts import Interrupts
from flightstack.cli.options import CertificateOption, JsonOption, SensorsOption, VehicleOption


def shield(
    connect: Annotated[str, typer.Option(help="Of the PX4: udpin:HOST:PORT, udpout:HOST:PORT or serial:DEVICE:BAUD.")],
    serve: Annotated[
        str, typer.Option(help="For the program: udpout:HOST:PORT speaks first, from PORT + 40; or udpin:HOST:PORT.")
    ],
    site: Annotated[
        Path,
        typer.Option(help="Keep the vehicle in this site (.toml, .plan, .geojson); SIGUSR1: read it anew."),
    ],
    vehicle: VehicleOption = None,
    certificate: CertificateOption = None,
    sensors: SensorsOption = None,
    duration: Annotated[float | None, typer.Option(min=0.1, help="End after so many seconds.")] = None,
    json: JsonOption = None,
) -> None:
    """Keep anybody's offboard program inside a site: a MAVLink router between it and a PX4."""
    from flightstack.cli import console, files, terminal
    from flightstack.cli.shield import ShieldOptions
    from flightstack.cli.shield import shield as run

    interrupts = Interrupts()
    options = ShieldOptions(
        connect=connect,
        serve=serve,
        site=site,
        vehicle=vehicle,
        certificate=certificate,
        sensors=sensors.value if sensors else "mocap",
        duration_s=duration,
    )
    interrupts.at_once = True
    with terminal.progress(f"shielding {connect}") as show:

        def on_progress(share: float, words: str) -> None:
            interrupts.at_once = False  # from here on something may fly
            show(share, words)

        result = run(options, stop_requested=interrupts.requested, on_progress=on_progress)
    console.say(
        f"{result['setpoints']} setpoints taken, {result['ticks']} ticks flown, "
        f"{100.0 * result['changed_share']:.1f} % changed by the site filter"
    )
    files.write_json(json, result)
    if not result["vehicle_heard"]:
        console.say_error(f"no PX4 was heard at {connect}")
        raise typer.Exit(FAILED)
    if result["ended"]:
        console.say_error(result["ended"])
        raise typer.Exit(FAILED)
    if interrupts.requested():
        raise typer.Exit(INTERRUPTED)
