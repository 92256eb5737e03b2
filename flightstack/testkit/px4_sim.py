"""A simulated PX4 in the test's own process: its time moves when the test says so, and only then.

    def test_it_climbs(px4_sim):
        client = mavutil.mavlink_connection(px4_sim.address)     # any MAVLink client
        px4_sim.step(5.0)                                        # five seconds of the vehicle's time

Nothing here reads a clock but for `speed` and for clients that answer TIMESYNC: those are waited for, so that none is
overrun.  A client of one thread that sends between two steps gets the same bytes in every run.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

from flightstack.cli.compiled import JSBSIM, SIMULATOR, ensure_compiled
from flightstack.cli.files import load_vehicle
from flightstack.testkit.recording import Recording
from flightstack.types import InputError
from flightstack_sim.autopilot.modes import Mode
from flightstack_sim.autopilot.params import ParamResult
from flightstack_sim.faults import parse_faults
from flightstack_sim.grade import load_grade
from flightstack_sim.plant import Truth
from flightstack_sim.sensors import STANDARD_DEGC
from flightstack_sim.server import Server
from flightstack_sim.shell import GCS, ONBOARD, Seam
from flightstack_sim.simulated_vehicle import simulated_vehicle
from mavlink_bridge.transport.udp import UdpSocket

if TYPE_CHECKING:
    from flightstack.testkit.connection import Connection

T = TypeVar("T")
_log = logging.getLogger(__name__)
HOST: Final = "127.0.0.1"
TICK_MS: Final = 4
TICK_US: Final = 1000 * TICK_MS
DATAGRAM_BYTES: Final = 1400
"""Messages of one step are packed: a socket that nobody reads meanwhile holds 5 s of the offboard link, not 0.4 s."""
ZERO_DEGC_K: Final = 273.15
SYNC_LAG_US: Final = 150_000
"""How far the vehicle may be ahead of a client's last answer to TIMESYNC, which is asked every 100 ms."""
SYNC_PATIENCE_S: Final = 1.0
"""So long, on the wall, such an answer is waited for; then the client counts as gone until it answers again."""
_PORTS: Final = range(15_000, 31_000)
"""Below those that systems give out themselves, so that a port that is free stays free."""
_next_port = count(os.getpid() * 37)


@dataclass(frozen=True, slots=True)
class Px4Options:
    """Which vehicle: names or files as on the command line; `speed` 0: as fast as it goes."""

    vehicle: str | None = None
    seed: int = 0
    plant: str = "native"
    sensors: str = "mocap"
    speed: float = 0.0
    sysid: int = 1
    folder: Path = field(default_factory=Path)
    """Where `log` is written."""


def free_port() -> int:
    """A UDP port of loopback that nobody uses."""
    for _ in _PORTS:
        port = _PORTS[next(_next_port) % len(_PORTS)]
        try:
            UdpSocket.bind(HOST, port).close()
        except InputError:
            continue
        return port
    raise InputError("no free UDP port from 15000 to 31000")


class Px4Sim:
    """One vehicle.  `server` (flightstack_sim.server.Server) is all that is behind it, for what is not offered here."""

    def __init__(self, options: Px4Options, say: Callable[[str], None] = _log.warning) -> None:
        if not 0.0 <= options.speed < math.inf:
            raise InputError(f"speed {options.speed:g}: give 0 (as fast as it goes) or times real time")
        self.options = options
        ensure_compiled(say, JSBSIM if options.plant == JSBSIM else SIMULATOR)
        truth, self._file = load_vehicle(options.vehicle)
        vehicle = simulated_vehicle(
            replace(truth, effects={}), truth, load_grade(options.sensors), seed=options.seed, plant=options.plant
        )
        self.server = Server(vehicle, system=options.sysid)
        if options.speed <= 0.0:
            self.server.gcs_waiting = set()
        self.recording = Recording()
        self._seam = Seam(self.server, 2, options.seed)
        self._ports = (free_port(), free_port())
        self._sockets = tuple(UdpSocket.bind(HOST, 0, peer=(HOST, port), latch=True) for port in self._ports)
        self._packed = [b"", b""]
        self._thrust_scale = truth.effects.get("thrust_scale", {}).get("scale", 1.0)
        self._memory: dict[int, Connection] = {}
        self._end_us = 0.0
        self._wall_s = -1.0
        self._absent = False

    # --- what a test looks at ---

    @property
    def address(self) -> str:
        """Where the offboard link sends, for pymavlink and others: udpin:HOST:PORT."""
        return f"udpin:{HOST}:{self._ports[ONBOARD]}"

    @property
    def mavsdk_address(self) -> str:
        """The same as MAVSDK writes it: udpin://HOST:PORT."""
        return f"udpin://{HOST}:{self._ports[ONBOARD]}"

    @property
    def gcs_address(self) -> str:
        """Where the ground station's link sends."""
        return f"udpin:{HOST}:{self._ports[GCS]}"

    @property
    def now_s(self) -> float:
        """The vehicle's time since boot, s."""
        return self.server.t_us * 1e-6

    @property
    def truth(self) -> Truth:
        """The true state: position (NED, m), velocity, attitude, rates, thrusts, wind, voltage."""
        return self.server.vehicle.plant.truth()

    @property
    def armed(self) -> bool:
        """Whether the motors are live."""
        return self.server.commander.state.armed

    @property
    def landed(self) -> bool:
        """Whether the autopilot takes itself for landed."""
        return self.server.vehicle.landed

    @property
    def mode(self) -> Mode:
        """The mode that flies (`.title`, `.custom_mode`)."""
        return self.server.commander.state.mode

    @property
    def log(self) -> Path:
        """An MCAP log of the flight so far (truth, wire, texts), written now: read it by `flightstack.api.read_log`."""
        return self.write_log(self.options.folder)

    # --- what a test does ---

    def step(self, seconds: float) -> None:
        """Let the vehicle's time run so long; what clients have sent acts with the next 4 ms.

        ValueError for a time that is negative or no number.
        """
        self.advance(seconds)
        self.end_step()

    def advance(self, seconds: float) -> None:
        """A part of a step: what the vehicle says waits until a datagram is full or the step ends."""
        if not 0.0 <= seconds < math.inf:
            raise ValueError(f"step takes a time of 0 s or more, not {seconds!r}")
        self._end_us += seconds * 1e6
        while self.server.t_us + TICK_US <= self._end_us + 0.5:
            self._receive()
            self.server.advance(TICK_MS)
            self.recording.truth(self.truth)
            self._collect()
            self._wait_for_client()
            self._wait_for_wall()

    def end_step(self) -> None:
        """After its parts: ground stations count that have come, and everything is sent."""
        self._hear_ground_stations()
        self._flush()

    def step_until(self, condition: Callable[[], bool], timeout_s: float = 60.0) -> bool:
        """Step until `condition()` is true, looked at every 4 ms, at most so long; whether it came true."""
        end_s = self.now_s + timeout_s
        while not condition():
            if self.now_s >= end_s:
                return False
            self.step(0.001 * TICK_MS)
        return True

    def serve(self) -> None:
        """Answer what clients have asked, at the vehicle's present time: commands, parameters, missions."""
        self._receive()
        self._hear_ground_stations()
        self.server.answer()
        self._collect()
        self._flush()

    async def call(self, awaitable: Awaitable[T], step_s: float = 0.0) -> T:
        """Await a call of an asynchronous client (MAVSDK) while its questions are answered.

        The vehicle's time stands still, or, with `step_s`, moves on by so much every millisecond.
        """
        task = asyncio.ensure_future(awaitable)
        while not task.done():
            self.serve()
            if step_s > 0.0:
                self.step(step_s)
            await asyncio.sleep(0.001)
        return task.result()

    def fault(self, name: str) -> None:
        """A fault begins now: NAME[:VALUE][+DURATION] as for `--fault`.  InputError for an unknown one."""
        self.server.faults.begin(parse_faults(name), self.server.t_us)

    def param(self, name: str, value: float | None = None) -> float:
        """A PX4 parameter's value, set first where one is given.  InputError for what PX4 would refuse."""
        params = self.server.vehicle.params
        if value is not None and (result := params.set(name, value)) is not ParamResult.OK:
            raise InputError(f"parameter {name} = {value}: {result.name.lower().replace('_', ' ')}")
        try:
            return params.get(name)
        except KeyError:
            raise InputError(f"parameter {name} does not exist") from None

    def set_effect(self, name: str, **values: float) -> None:
        """An effect of the physics has these values from now on: `steady_wind`, north_mps=3.0 (see EFFECTS)."""
        self.server.vehicle.plant.set_effect(name, values)
        if name == "thrust_scale":
            self._thrust_scale = values.get("scale", 1.0)

    def wind(self, north_mps: float, east_mps: float, down_mps: float = 0.0) -> None:
        """The air moves so over ground from now on; it acts through the vehicle's drag effects."""
        self.set_effect("steady_wind", north_mps=north_mps, east_mps=east_mps, down_mps=down_mps)

    def temperature(self, degc: float) -> None:
        """The air's temperature from now on: sensors tell it, and thrust goes with the air's density at this pressure.

        The vehicle file's thrust holds at the standard atmosphere's 11.8 degrees; drag stays as it is.
        """
        if not -60.0 <= degc <= 60.0:
            raise InputError(f"temperature({degc}): degrees Celsius from -60 to 60")
        sensors, scale = self.server.vehicle.sensors, self._thrust_scale
        sensors.imu_degc = sensors.air_degc = float(degc)
        ratio = (STANDARD_DEGC + ZERO_DEGC_K) / (degc + ZERO_DEGC_K)
        self.server.vehicle.plant.set_effect("thrust_scale", {"scale": scale * ratio})

    def battery(self, remaining: float | None) -> None:
        """The charge that the autopilot is told, 0..1; None: the simulated one again."""
        if remaining is not None and not 0.0 <= remaining <= 1.0:
            raise InputError(f"battery({remaining}): the charge must lie in 0..1")
        self.server.view.battery.forced = remaining

    def connect(self, link: int = ONBOARD) -> Connection:
        """A pymavlink connection in memory: `recv_match(blocking=True, timeout=...)` moves the vehicle's time itself.

        It takes the link from the socket.  Nothing is lost, however long a step.
        """
        from flightstack.testkit.connection import Connection  # pymavlink's client side

        if link not in self._memory:
            self._memory[link] = Connection(self, link)
        return self._memory[link]

    def send(self, link: int, data: bytes) -> None:
        """A datagram for the vehicle, as if it had come by the link's socket."""
        self.recording.datagram("tx", self.server.t_us, link, data)
        self.server.receive(link, data)

    def write_log(self, folder: Path) -> Path:
        """Write the log of the flight so far into a folder."""
        return self.recording.write(folder / f"px4-{self.options.sysid}.mcap", self._settings(), self._file.text)

    def write_report(self, folder: Path, log: Path) -> Path:
        """Write the page of a log into a folder."""
        return self.recording.report(log, folder / f"px4-{self.options.sysid}.html")

    def close(self) -> None:
        """Give the ports back."""
        for socket in self._sockets:
            socket.close()

    # --- sockets ---

    def _settings(self) -> dict[str, str]:
        options = self.options
        names = ("vehicle", "seed", "plant", "sensors", "sysid")
        return {name: str(getattr(options, name)) for name in names} | {"pace": "stepped"}

    def _receive(self) -> None:
        for index, socket in enumerate(self._sockets):
            for data in self._seam.into(index, socket.receive_all()):
                self.send(index, data)

    def _collect(self) -> None:
        """Take what the vehicle has to say; it leaves when a datagram is full."""
        t_us = self.server.t_us
        for index in range(len(self._sockets)):
            for data in self._seam.out(index, self.server.datagrams(index)):
                self.recording.datagram("rx", t_us, index, data)
                if index in self._memory:
                    self._memory[index].deliver(data)
                    continue
                if len(self._packed[index]) + len(data) > DATAGRAM_BYTES:
                    self._flush_link(index)
                self._packed[index] += data

    def _flush(self) -> None:
        for index in range(len(self._sockets)):
            self._flush_link(index)

    def _flush_link(self, index: int) -> None:
        if self._packed[index]:
            self._sockets[index].send(self._packed[index])
            self._packed[index] = b""

    def _hear_ground_stations(self) -> None:
        """One that comes by the wall's time counts from here on: between two steps, whenever within one it came."""
        for index in self.server.gcs_waiting or ():
            self.server.hear_gcs(index)
        self.server.gcs_waiting = None if self.server.gcs_waiting is None else set()

    def _wait_for_client(self) -> None:
        """Let a client that answers TIMESYNC keep up; as a ground station it is there as long as it does."""
        for index, socket in enumerate(self._sockets):
            port = self.server.port(index)
            if port.synced_us is None:
                continue
            if self.server.t_us - port.synced_us <= SYNC_LAG_US:
                self._absent = False
                stepped = self.server.gcs_waiting is not None
                if stepped and port.has_gcs(self.server.t_us, self.server.vehicle.params):
                    self.server.hear_gcs(index)  # its heartbeats come by the wall's time
                continue
            if self._absent:
                continue
            self._flush()
            limit_s = time.monotonic() + SYNC_PATIENCE_S
            while self.server.t_us - port.synced_us > SYNC_LAG_US:
                left_s = limit_s - time.monotonic()
                if left_s <= 0.0:
                    self._absent = True
                    break
                socket.wait(min(left_s, 0.01))
                self._receive()

    def _wait_for_wall(self) -> None:
        """Not faster than `speed` times real time."""
        if self.options.speed <= 0.0:
            return
        now_s = time.monotonic()
        due_s = max(self._wall_s, now_s - 0.1) + 0.001 * TICK_MS / self.options.speed
        self._wall_s = due_s
        if due_s > now_s:
            self._flush()
            time.sleep(due_s - now_s)
