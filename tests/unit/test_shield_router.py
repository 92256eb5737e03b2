"""The shield's router against the simulated PX4, in memory: what passes, what is made safe, who has the last word."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

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

    def __init__(self, site: Path) -> None:
        believed, _ = files.load_vehicle(None)
        self.vehicle = simulated_vehicle(believed, believed, load_grade("mocap"), seed=0)
        self.server = Server(self.vehicle, links=(LinkKind.ONBOARD,))
        options = ShieldOptions(connect="udpin:127.0.0.1:1", serve="udpin:127.0.0.1:2", site=site)
        self.router = ShieldRouter(*shield_stack(options, None))
        self.program = Link(245, 190)
        self.heard: list[Any] = []
        self.to_vehicle: list[bytes] = []
        self.places: list[np.ndarray] = []
        self.say: Callable[[], object | None] = lambda: None
        self.start = np.zeros(3)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 250)):
            self.server.advance(4)
            now_us = self.server.t_us
            for data in self.server.datagrams(0, 1400):
                for kept in self.router.from_vehicle(data, now_us):
                    self.program.receive_datagram(kept, now_us)
            self.heard += [received.message for received in self.program.take_events()]
            message = self.say() if now_us // 4_000 % 5 == 0 else None
            if message is not None:
                self.program.send(message)
            for data in self.program.datagrams_to_send():
                for kept in self.router.from_program(data, now_us):
                    self.to_vehicle.append(kept)
                    self.server.receive(0, kept)
            for data in self.router.step(now_us):
                self.server.receive(0, data)
            self.places.append(self.vehicle.plant.pos_ned_m - self.start)

    def command(self, number: int, *params: float) -> None:
        given = (*params, *(NAN,) * (7 - len(params)))
        self.program.send(m.CommandLong(1, 1, int(number), 0, given))  # type: ignore[arg-type]

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


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("site") / "room.toml"
    path.write_text(SITE)
    return path


@pytest.fixture
def rig(site: Path) -> Rig:
    made = Rig(site)
    made.take_off()
    assert -made.places[-1][2] == pytest.approx(2.0, abs=0.15)
    made.places.clear()
    return made


def inside(places: list[np.ndarray]) -> bool:
    table = np.array(places)
    flat = np.all(np.abs(table[:, :2]) <= [5.0, 4.0])
    return bool(flat and np.all(table[:, 2] <= -0.3) and np.all(table[:, 2] >= -5.0))


@pytest.mark.parametrize(
    "wish",
    [
        velocity(4.0, 2.5, 0.0),
        position(30.0, -20.0, -9.0),
        rates(0.0, -0.3, 0.5),
        attitude(-0.6, 0.55),
    ],
    ids=["velocity", "position", "rates", "attitude"],
)
def test_nothing_that_is_asked_for_leads_out(rig: Rig, wish: object) -> None:
    rig.say = lambda: wish
    rig.run(6.0)
    assert inside(rig.places)
    assert rig.router.score.changed > 0
    assert np.linalg.norm(rig.places[-1] - rig.places[0]) > 0.5


def test_a_program_that_dies_is_stopped_held_and_handed_over(rig: Rig) -> None:
    rig.say = lambda: velocity(2.0, 0.0, 0.0)
    rig.run(1.0)
    rig.say = lambda: None
    rig.run(4.0)
    assert np.linalg.norm(rig.vehicle.plant.vel_ned_mps) < 0.2
    assert rig.server.commander.state.mode.title == "Offboard"
    rig.run(3.0)
    assert rig.router.score.handed_over
    assert rig.server.commander.state.mode.title != "Offboard"
    assert inside(rig.places)


def test_the_pilot_has_it(rig: Rig) -> None:
    """Hold, selected by somebody while the program goes on: the router does not take it back."""
    rig.command(*(lambda r: (r[0], *r[1]))(set_mode(px4.MODE_HOLD)))
    rig.say = lambda: velocity(2.0, 0.0, 0.0)
    rig.run(2.0)
    assert rig.server.commander.state.mode.title != "Offboard"
    assert np.linalg.norm(rig.places[-1] - rig.places[0]) < 0.3


def test_all_but_setpoints_passes_byte_for_byte(rig: Rig) -> None:
    frames = []
    for message in (m.Heartbeat(6, 8, 0, 0, 4), m.ParamRequestRead(1, 1, "THR_MDL_FAC", -1)):
        rig.program.send(message)
    frames = rig.program.datagrams_to_send()
    for data in (*frames, b"no MAVLink at all", b"".join(frames)):
        assert rig.router.from_program(data, rig.server.t_us) == [data]
    rig.program.send(rates(0.0, 0.0, 0.5))
    mixed = frames[0] + rig.program.datagrams_to_send()[0] + frames[1]
    assert rig.router.from_program(mixed, rig.server.t_us) == [frames[0] + frames[1]]
