"""`flightstack sim`: the simulated PX4 alone, in real time or faster, with PX4's ports."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flightstack.cli import files
from flightstack.cli.compiled import ensure_compiled
from flightstack.cli.preparation import text_file
from flightstack.cli.versions import versions
from flightstack_logs.log_clock import clock_metadata
from flightstack_logs.writer import FlightLog
from flightstack_sim.faults import parse_faults
from flightstack_sim.grade import load_grade
from flightstack_sim.server import Server
from flightstack_sim.shell import GCS, ONBOARD, Shell
from flightstack_sim.simulated_vehicle import simulated_vehicle
from flightstack_sim.warmup import warm_up
from mavlink_bridge import messages
from mavlink_bridge.pace import Pace, undisturbed
from mavlink_bridge.transport.clock import utc_us
from mavlink_bridge.transport.udp import UdpSocket

HOST = "127.0.0.1"
OFFBOARD_PORT = 14540
GCS_PORT = 14550
GCS_BIND = 18570
DEFAULT_SENSORS = "mocap"
PORT_STEP = 40
"""PX4 binds its offboard link 40 ports above the one it sends to."""
TICK_MS = 4
PATIENCE_US = 200_000
"""So far behind real time the simulator catches up; beyond, its clock stands still instead."""


@dataclass(frozen=True, slots=True)
class SimOptions:
    """What `sim` was asked for."""

    vehicle: str | None = None
    sensors: str | None = None
    """None: mocap, behind a real PX4 gps."""
    seed: int = 0
    port: int = OFFBOARD_PORT
    gcs_port: int = GCS_PORT
    speed: float = 1.0
    duration_s: float | None = None
    plant: str = "native"
    fault: str | None = None
    """As on the command line; see sim.faults."""
    hil_port: int = 4560
    """Of `--px4-hil`."""
    log: Path | None = None
    """Where the truth is recorded."""


def open_truth_log(options: SimOptions, vehicle_text: str) -> FlightLog | None:
    """The log of the truth, where one is asked for."""
    if options.log is None:
        return None
    settings = {"seed": str(options.seed), "plant": options.plant, "pace": "realtime", "speed": f"{options.speed:g}"}
    clock = clock_metadata(utc_us(), simulated=False)
    metadata = {"settings": settings, "versions": versions(), "clock": clock}
    truth = text_file("truth.toml", vehicle_text)
    return FlightLog.open(options.log, metadata=metadata, attachments=(truth,), overwrite=True)


def simulate(
    options: SimOptions,
    *,
    stop_requested: Callable[[], str],
    on_ready: Callable[[str], None] = lambda text: None,
    on_wait: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Simulate until asked to stop or `duration_s` of simulated time is over; what was done."""
    faults = parse_faults(options.fault)
    truth, file = files.load_vehicle(options.vehicle)
    grade = load_grade(options.sensors or DEFAULT_SENSORS)
    ensure_compiled(on_wait)
    messages.prepare()
    warm_up(truth, grade, options.plant)
    vehicle = simulated_vehicle(replace(truth, effects={}), truth, grade, seed=options.seed, plant=options.plant)
    onboard = UdpSocket.bind(HOST, options.port + PORT_STEP, peer=(HOST, options.port), latch=True)
    gcs_bind = GCS_BIND if options.gcs_port == GCS_PORT else 0
    try:
        gcs = UdpSocket.bind(HOST, gcs_bind, peer=(HOST, options.gcs_port), latch=True)
    except BaseException:
        onboard.close()
        raise
    log = open_truth_log(options, file.text)
    shell = Shell(Server(vehicle, faults=faults), (onboard, gcs), options.seed)
    on_ready(
        f"{truth.name} is up: offboard link {HOST}:{options.port} (bound to {onboard.address[1]}), "
        f"ground station {HOST}:{options.gcs_port} (bound to {gcs.address[1]}), {options.speed:g} times real time"
    )
    sent = [0, 0]
    try:
        with undisturbed():
            pace = _loop(shell, options, stop_requested, sent, on_ready, log)
    finally:
        shell.close()
        if log is not None:
            log.close()
    return {
        "schema": "flightstack.sim/1",
        "vehicle": truth.name,
        "plant": options.plant,
        "seed": options.seed,
        "simulated_s": vehicle.t_us * 1e-6,
        "speed": options.speed,
        "missed": pace.missed,
        "log": None if options.log is None else str(options.log),
        "datagrams_sent": {"onboard": sent[ONBOARD], "gcs": sent[GCS]},
    }


def _loop(
    shell: Shell,
    options: SimOptions,
    stop_requested: Callable[[], str],
    sent: list[int],
    on_fault: Callable[[str], None],
    log: FlightLog | None,
) -> Pace:
    pace = Pace(TICK_MS * 1000 / options.speed, patience_us=PATIENCE_US)
    vehicle = shell.server.vehicle
    end_us = None if options.duration_s is None else round(options.duration_s * 1e6)
    ticks = 0
    while end_us is None or vehicle.t_us < end_us:
        pace.wait()
        shell.receive()
        for index, count in enumerate(shell.advance(TICK_MS)):
            sent[index] += count
        if log is not None:
            log.truth(vehicle.t_us, vehicle.plant.truth())
        ticks += 1
        for at_us, words in shell.server.faults.new():
            on_fault(f"{at_us * 1e-6:.1f} s: fault {words}")
        if ticks % 25 == 0 and stop_requested():
            break
        if ticks % 250 == 0:
            gc.collect(0)
    return pace
