"""The shield's router with a simulated PX4 and a program, in memory, on one clock."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.cli import files
from flightstack.cli.shield import ShieldOptions, shield_stack
from flightstack.cli.shield_router import ShieldRouter
from flightstack_sim.grade import load_grade
from flightstack_sim.server import Server
from flightstack_sim.simulated_vehicle import simulated_vehicle
from flightstack_sim.streams import LinkKind
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.link import Link
from mavlink_bridge.requests import set_mode

NAN = float("nan")
SITE = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 5.0
inside = [[-5.0, -4.0], [5.0, -4.0], [5.0, 4.0], [-5.0, 4.0]]
"""


class Rig:
    """A simulated PX4, the router, and a program that speaks as MAVSDK does, all on one clock."""

    def __init__(self, site: Path, vehicle: str | None = None, place: tuple[float, float] | None = None) -> None:
        """`place`: latitude and longitude where the vehicle was when it was asked for them, of a site on the globe."""
        self.believed, _ = files.load_vehicle(vehicle)
        self.now_us = 0
        """Of the router's clock."""
        self.boot()
        options = ShieldOptions(connect="udpin:127.0.0.1:1", serve="udpin:127.0.0.1:2", site=site, vehicle=vehicle)
        self.router = ShieldRouter(*shield_stack(options, place), place)
        self.program = Link(245, 190)
        self.heard: list[Any] = []
        self.to_vehicle: list[bytes] = []
        self.places: list[np.ndarray] = []
        self.say: Callable[[], object | None] = lambda: None
        self.start = np.zeros(3)

    def boot(self) -> None:
        """Another PX4 in its place, on the ground where it was made; its clock begins anew."""
        self.vehicle = simulated_vehicle(self.believed, self.believed, load_grade("mocap"), seed=0)
        self.server = Server(self.vehicle, links=(LinkKind.ONBOARD,))

    def run(self, seconds: float, *, stands: bool = False, cut: bool = False) -> None:
        """So long; the vehicle with its clock stands still, or its link is cut."""
        for _ in range(round(seconds * 250)):
            self.now_us += 4_000
            now_us = self.now_us
            if not stands:
                self.server.advance(4)
            for data in [] if stands else self.server.datagrams(0, 1400):
                if cut:
                    continue
                for kept in self.router.from_vehicle(data, now_us):
                    self.program.receive_datagram(kept, now_us)
            self.heard += [received.message for received in self.program.take_events()]
            message = self.say() if now_us // 4_000 % 5 == 0 else None
            if message is not None:
                self.program.send(message)
            for data in self.program.datagrams_to_send():
                for kept in self.router.from_program(data, now_us):
                    self.to_vehicle.append(kept)
                    if not (stands or cut):
                        self.server.receive(0, kept)
            for data in self.router.step(now_us):
                if not (stands or cut):
                    self.server.receive(0, data)
            self.places.append(self.vehicle.plant.pos_ned_m - self.start)

    def command(self, number: int, *params: float) -> None:
        given = (*params, *(NAN,) * (7 - len(params)))
        self.program.send(m.CommandLong(1, 1, int(number), 0, given))  # type: ignore[arg-type]

    def stop(self, *messages: type) -> None:
        """Streams end, not by the program, whose word would be noticed."""
        somebody = Link(200, 1)
        for message in messages:
            given = float(m.id_of(message)), -1.0, *(NAN,) * 5
            somebody.send(m.CommandLong(1, 1, int(px4.Cmd.SET_MESSAGE_INTERVAL), 0, given))
        for data in somebody.datagrams_to_send():
            self.server.receive(0, data)

    def take_off(self) -> None:
        """As MAVSDK's examples: stream a setpoint, select OFFBOARD, arm."""
        self.say = lambda: position(0.0, 0.0, -2.0)
        self.run(6.0)
        self.start = self.vehicle.plant.pos_ned_m.copy()
        self.command(*(lambda r: (r[0], *r[1]))(set_mode(px4.MODE_OFFBOARD)))
        self.run(0.3)
        self.command(px4.Cmd.COMPONENT_ARM_DISARM, 1.0)
        self.run(5.0)


def position(north: float, east: float, down: float) -> m.SetPositionTargetLocalNed:
    return m.SetPositionTargetLocalNed(0, 1, 1, 1, 0b1001_1111_1000, (north, east, down), (NAN,) * 3, yaw_rad=0.0)


def velocity(north: float, east: float, down: float) -> m.SetPositionTargetLocalNed:
    return m.SetPositionTargetLocalNed(0, 1, 1, 1, 0b1001_1100_0111, (NAN,) * 3, (north, east, down), yaw_rad=0.0)


def rates(roll: float, pitch: float, thrust: float) -> m.SetAttitudeTarget:
    return m.SetAttitudeTarget(0, 1, 1, 128, (1.0, 0.0, 0.0, 0.0), (roll, pitch, 0.0), thrust)


def attitude(pitch: float, thrust: float) -> m.SetAttitudeTarget:
    q = (float(np.cos(0.5 * pitch)), 0.0, float(np.sin(0.5 * pitch)), 0.0)
    return m.SetAttitudeTarget(0, 1, 1, 7, q, (0.0, 0.0, 0.0), thrust)


def inside(places: list[np.ndarray]) -> bool:
    table = np.array(places)
    flat = np.all(np.abs(table[:, :2]) <= [5.0, 4.0])
    return bool(flat and np.all(table[:, 2] <= -0.3) and np.all(table[:, 2] >= -5.0))
