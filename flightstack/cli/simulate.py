"""`flightstack sim`: simulated PX4s alone, in real time or faster, with PX4's ports.

Instance i has PX4's numbers: system id `sysid` + i, an offboard link from `port` + 40 + i to `port` + i (from i = 10 on
all send to `port` + 9), a ground station's link from 18570 + i to `gcs_port`.  One loop moves them all.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flightstack.cli import files
from flightstack.cli.compiled import JSBSIM, SIMULATOR, ensure_compiled
from flightstack.cli.home import HOME, Home
from flightstack.cli.live_view import shown_live
from flightstack.types import InputError
from flightstack.vehicle import Vehicle
from flightstack_logs.recorder import Recorder
from flightstack_sim.faults import parse_faults
from flightstack_sim.grade import Grade, load_grade
from flightstack_sim.server import Server
from flightstack_sim.shell import GCS, ONBOARD, Shell
from flightstack_sim.simulated_vehicle import simulated_vehicle
from flightstack_sim.warmup import warm_up
from mavlink_bridge import messages
from mavlink_bridge.pace import Pace, undisturbed
from mavlink_bridge.px4 import describe_mode
from mavlink_bridge.transport.clock import utc_us
from mavlink_bridge.transport.udp import UdpSocket

if TYPE_CHECKING:
    from flightstack_logs.writer import FlightLog

HOST = "127.0.0.1"
OFFBOARD_PORT = 14540
GCS_PORT = 14550
GCS_BIND = 18570
DEFAULT_SENSORS = "mocap"
PORT_STEP = 40
"""PX4 binds its offboard link 40 ports above the one it sends to."""
LAST_OWN_PORT = 9
"""From the instance after this one on PX4 sends to one port: 14549."""
MOST_SYSTEM = 255
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
    bind: str = HOST
    """The address of this machine that the links are bound to."""
    home: Home = HOME
    instances: int = 1
    sysid: int = 1
    """Of the first instance."""
    log_wire: bool = False
    """Whether what goes over the wire is recorded too (not with `--px4-hil`)."""
    live: int | None = None
    """Port of the live view of the first instance; None: there is none."""


def log_of(path: Path, instance: int, instances: int) -> Path:
    """The log of one instance: the path as it was given, with its number before the ending where there are several."""
    return path if instances == 1 else path.with_name(f"{path.stem}-{instance}{path.suffix}")


def open_truth_log(options: SimOptions, vehicle_text: str, path: Path | None = None) -> FlightLog | None:
    """The log of the truth, where one is asked for."""
    path = path or options.log
    if path is None:
        return None
    files.require_place_of_a_log(path)
    # half a second of imports, for whoever keeps a log
    from flightstack.cli.versions import versions
    from flightstack_logs.log_clock import clock_metadata
    from flightstack_logs.topics import Attachment
    from flightstack_logs.writer import FlightLog

    settings = {"seed": str(options.seed), "plant": options.plant, "pace": "realtime", "speed": f"{options.speed:g}"}
    clock = clock_metadata(utc_us(), simulated=False)
    metadata = {"settings": settings, "versions": versions(), "clock": clock}
    truth = Attachment.of_text("truth.toml", vehicle_text)
    return FlightLog.open(path, metadata=metadata, attachments=(truth,), overwrite=True, compact=True)


@dataclass(slots=True)
class Instance:
    """One vehicle with its sockets and its log."""

    number: int
    shell: Shell
    log: Recorder | None
    sent: list[int] = field(default_factory=lambda: [0, 0])
    status: tuple[str, bool, bool] | None = None
    """Mode, armed, landed, as the log has them last."""

    def tick(self) -> None:
        """Take what has come, simulate, send, record."""
        shell, log, vehicle = self.shell, self.log, self.shell.server.vehicle
        shell.receive()
        for index, count in enumerate(shell.advance(TICK_MS)):
            self.sent[index] += count
        if log is not None:
            log.truth(vehicle.t_us, vehicle.plant.truth())
            commander = shell.server.commander.state
            status = describe_mode(commander.mode.custom_mode), commander.armed, vehicle.landed
            if status != self.status:
                self.status = status
                log.write("/vehicle/status", vehicle.t_us, status)

    def news(self) -> list[tuple[int, str]]:
        """Faults that have begun or ended and warnings, with the vehicle's time."""
        server = self.shell.server
        return [(at_us, f"fault {words}") for at_us, words in server.faults.new()] + server.console.take()

    def close(self) -> None:
        """Close its sockets and its log."""
        self.shell.close()
        if self.log is not None:
            self.log.close()


def _bind(options: SimOptions, number: int) -> tuple[UdpSocket, UdpSocket]:
    """The offboard and the ground station's link of one instance."""
    # Who is bound to an address of its own can't reach loopback: its client is expected beside it.
    everywhere = options.bind == "0.0.0.0" or options.bind.startswith("127.")
    peer_host = HOST if everywhere else options.bind
    port = options.port + min(number, LAST_OWN_PORT)
    onboard = UdpSocket.bind(options.bind, options.port + PORT_STEP + number, peer=(peer_host, port), latch=True)
    gcs_bind = GCS_BIND + number if options.gcs_port == GCS_PORT else 0
    try:
        return onboard, UdpSocket.bind(options.bind, gcs_bind, peer=(peer_host, options.gcs_port), latch=True)
    except BaseException:
        onboard.close()
        raise


def _start(options: SimOptions, number: int, truth: Vehicle, grade: Grade, vehicle_text: str) -> Instance:
    sockets = _bind(options, number)
    try:
        vehicle = simulated_vehicle(
            replace(truth, effects={}), truth, grade, seed=options.seed + number, plant=options.plant,
            heading_rad=options.home.heading_rad,
        )  # fmt: skip
        server = Server(
            vehicle, system=options.sysid + number, frame=options.home.frame, faults=parse_faults(options.fault)
        )
        path = None if options.log is None else log_of(options.log, number + 1, options.instances)
        log: Recorder | None = None if path is None else open_truth_log(options, vehicle_text, path)
        if options.live is not None and number == 0:
            log = shown_live(log, options.live)
    except BaseException:
        for socket in sockets:
            socket.close()
        raise
    shell = Shell(server, sockets, options.seed + number)
    kept = log
    if kept is not None and options.log_wire:
        shell.on_datagram = lambda direction, index, data: (
            kept.mavlink(direction, server.t_us, data) if index == ONBOARD or direction == "tx" else None
        )
    return Instance(number, shell, log)


def _start_all(
    options: SimOptions, truth: Vehicle, grade: Grade, vehicle_text: str, on_problem: Callable[[str], None]
) -> list[Instance]:
    """Every instance that can be; where several were asked for, one whose port is taken is told and left out."""
    started: list[Instance] = []
    problem: InputError | None = None
    try:
        for number in range(options.instances):
            try:
                started.append(_start(options, number, truth, grade, vehicle_text))
            except InputError as error:
                problem = error
                if options.instances > 1:
                    on_problem(f"instance {number} is left out: {error}")
    except BaseException:
        for instance in started:
            instance.close()
        raise
    if not started and problem is not None:
        raise problem
    return started


def _up(options: SimOptions, name: str, instance: Instance) -> str:
    onboard, gcs = instance.shell.sockets
    assert onboard is not None
    assert gcs is not None
    peer, ground = onboard.peer, gcs.peer
    assert peer is not None
    assert ground is not None
    who = name if options.instances == 1 else f"{name} {instance.shell.server.system}"
    return (
        f"{who} is up: offboard link {peer[0]}:{peer[1]} (bound to {onboard.address[1]}), "
        f"ground station {ground[0]}:{ground[1]} (bound to {gcs.address[1]}), {options.speed:g} times real time"
    )


def simulate(
    options: SimOptions,
    *,
    stop_requested: Callable[[], str],
    on_ready: Callable[[str], None] = lambda text: None,
    on_wait: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Simulate until asked to stop or `duration_s` of simulated time is over; what was done."""
    if options.sysid + options.instances - 1 > MOST_SYSTEM:
        raise InputError(
            f"--sysid {options.sysid} with --instances {options.instances}: system ids end at {MOST_SYSTEM}"
        )
    parse_faults(options.fault)
    truth, file = files.load_vehicle(options.vehicle)
    grade = load_grade(options.sensors or DEFAULT_SENSORS)
    ensure_compiled(on_wait, JSBSIM if options.plant == JSBSIM else SIMULATOR)
    messages.prepare()
    warm_up(truth, grade, options.plant)
    instances = _start_all(options, truth, grade, file.text, on_wait)
    for instance in instances:
        on_ready(_up(options, truth.name, instance))
    try:
        with undisturbed(real_time=options.speed <= 1.0):
            pace = _loop(instances, options, stop_requested, on_ready)
    finally:
        for instance in instances:
            instance.close()
    first = instances[0]
    sent = [{"onboard": one.sent[ONBOARD], "gcs": one.sent[GCS]} for one in instances]
    return {
        "schema": "flightstack.sim/1",
        "vehicle": truth.name,
        "plant": options.plant,
        "seed": options.seed,
        "simulated_s": first.shell.server.t_us * 1e-6,
        "speed": options.speed,
        "missed": pace.missed,
        "log": None if first.log is None else str(log_of(options.log, first.number + 1, options.instances)),  # type: ignore[arg-type]
        "datagrams_sent": sent[0],
        "instances": [
            {"system": one.shell.server.system, "datagrams_sent": counts}
            for one, counts in zip(instances, sent, strict=True)
        ],
    }


def _loop(
    instances: list[Instance], options: SimOptions, stop_requested: Callable[[], str], on_news: Callable[[str], None]
) -> Pace:
    pace = Pace(TICK_MS * 1000 / options.speed, patience_us=PATIENCE_US)
    first = instances[0].shell.server
    end_us = None if options.duration_s is None else round(options.duration_s * 1e6)
    several = len(instances) > 1
    ticks = 0
    while end_us is None or first.t_us < end_us:
        pace.wait()
        for instance in instances:
            instance.tick()
            for at_us, words in instance.news():
                on_news(f"{at_us * 1e-6:.1f} s: {f'vehicle {instance.shell.server.system}: ' * several}{words}")
        ticks += 1
        if ticks % 25 == 0 and stop_requested():
            break
        if ticks % 250 == 0:
            gc.collect(0)
    return pace
