"""A ground station for tests: speaks MAVLink with the simulated vehicle's server and keeps what it hears."""

from __future__ import annotations

import math
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from flightstack.vehicle import Vehicle, parse_vehicle
from flightstack_sim.grade import load_grade
from flightstack_sim.server import Server
from flightstack_sim.simulated_vehicle import simulated_vehicle
from flightstack_sim.streams import LinkKind
from mavlink_bridge import messages as m
from mavlink_bridge.link import Link

ROOT = Path(__file__).resolve().parents[2]
NAN = math.nan
ONBOARD, GCS = 0, 1
TICK_MS = 4
T = TypeVar("T")

OFFBOARD_MODE = (1.0, 6.0)
HOLD_MODE = (1.0, 4.0, 3.0)
POSITION_MODE = (1.0, 3.0)
HOSTILE = (math.nan, math.inf, -math.inf, 1e38, -1e38)
"""Numbers that no sane client sends."""
MODE, ARM, TAKEOFF, LAND, RETURN = 176, 400, 22, 21, 20


@cache
def vehicle_file(name: str) -> Vehicle:
    path = ROOT / "flightstack/data/vehicles" / f"{name}.toml"
    return parse_vehicle(path.read_text(), path.name)


class Station:
    """One client on each of the server's two links; commands go out on `link_index`."""

    def __init__(
        self, *, system: int = 245, component: int = 190, grade: str = "mocap", link_index: int = ONBOARD
    ) -> None:
        vehicle = vehicle_file("px4-sihsim-quadx")
        self.vehicle = simulated_vehicle(vehicle, vehicle, load_grade(grade), seed=1)
        self.server = Server(self.vehicle, links=(LinkKind.ONBOARD, LinkKind.GCS))
        self.links = (Link(system, component), Link(system, component))
        self.link_index = link_index
        self.heard: tuple[list[tuple[int, Any]], list[tuple[int, Any]]] = ([], [])
        """Per link: (time of the tick, message)."""
        self.stream: Any = None
        """A setpoint to send before every tick."""
        self.heartbeat_every_us = 0
        """0: never."""

    @property
    def state(self) -> Any:
        return self.server.commander.state

    def send(self, message: Any, link_index: int | None = None) -> None:
        index = self.link_index if link_index is None else link_index
        self.links[index].send(message)
        for data in self.links[index].datagrams_to_send():
            self.server.receive(index, data)

    def tick(self) -> None:
        if self.heartbeat_every_us and self.server.t_us % self.heartbeat_every_us == 0:
            self.send(m.Heartbeat(6, 8, 0, 0, 4))
        if self.stream is not None:
            self.send(self.stream)
        self.server.advance(TICK_MS)
        self.collect()

    def collect(self) -> None:
        for index, link in enumerate(self.links):
            for data in self.server.datagrams(index):
                link.receive_datagram(data, self.server.t_us)
            while (received := link.next_event()) is not None:
                self.heard[index].append((self.server.t_us, received.message))

    def run(self, seconds: float) -> None:
        for _ in range(round(1000 * seconds) // TICK_MS):
            self.tick()

    def run_until(self, condition: Any, limit_s: float) -> float:
        """Run until the condition holds; the time that took, in seconds."""
        start = self.server.t_us
        while not condition():
            assert self.server.t_us - start < limit_s * 1e6, "it never happened"
            self.tick()
        return (self.server.t_us - start) * 1e-6

    def clear(self) -> None:
        for messages in self.heard:
            messages.clear()

    def all(self, kind: type[T], link_index: int | None = None) -> list[T]:
        index = self.link_index if link_index is None else link_index
        return [message for _, message in self.heard[index] if isinstance(message, kind)]

    def last(self, kind: type[T], link_index: int | None = None) -> T:
        return self.all(kind, link_index)[-1]

    def rates(self, link_index: int, seconds: float) -> dict[str, float]:
        counts = Counter(type(message).__name__ for _, message in self.heard[link_index])
        return {name: count / seconds for name, count in counts.items()}

    def texts(self, link_index: int | None = None) -> list[str]:
        """Whole texts, chunks joined, without the tab at the end."""
        texts: dict[int, str] = {}
        for message in self.all(m.Statustext, link_index):
            texts[message.id] = texts.get(message.id, "") + message.text
        return [text.rstrip("\t") for text in texts.values()]

    def command(self, number: int, *params: float, target: tuple[int, int] = (1, 1)) -> list[int]:
        """Send a COMMAND_LONG with NaN for what isn't given; the results of its acknowledgements within 20 ms."""
        count = len(self.all(m.CommandAck))
        padded = (*params, *(NAN,) * (7 - len(params)))
        self.send(m.CommandLong(*target, number, 0, padded))
        for _ in range(5):
            self.tick()
        return [ack.result for ack in self.all(m.CommandAck)[count:] if ack.command == number]

    def boot(self) -> Station:
        """Until the vehicle can be armed."""
        self.run(5.0)
        return self


def rates_setpoint(thrust: float = 0.0, rate: tuple[float, float, float] = (0.0, 0.0, 0.0), mask: int = 128) -> Any:
    return m.SetAttitudeTarget(0, 1, 1, mask, (0.0, 0.0, 0.0, 0.0), rate, thrust)


def velocity_setpoint(north: float, east: float, down: float) -> Any:
    """As MAVSDK sends it: mask 2503, frame 1."""
    return m.SetPositionTargetLocalNed(
        0, 1, 1, 1, 2503, (0.0, 0.0, 0.0), (north, east, down), (0.0, 0.0, 0.0), 0.0, 0.0
    )


def position_setpoint(north: float, east: float, down: float) -> Any:
    zero = (0.0, 0.0, 0.0)
    return m.SetPositionTargetLocalNed(0, 1, 1, 1, 0b101111111000, (north, east, down), zero, zero, 0.0, 0.0)


def airborne(setpoint: Any = None) -> Station:
    """In the air at about 2.5 m in OFFBOARD, flown by position setpoints unless told otherwise."""
    station = Station().boot()
    station.stream = setpoint or position_setpoint(0.0, 0.0, -2.5)
    station.run(0.5)
    assert station.command(MODE, *OFFBOARD_MODE) == [0, 0]
    assert station.command(ARM, 1.0) == [0]
    station.run(6.0)
    assert station.last(m.ExtendedSysState).landed_state == 2
    return station
