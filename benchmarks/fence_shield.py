"""`python -m benchmarks.fence_shield`: random offboard programs behind the shield, in memory.

A program asks for places, velocities, attitudes, body rates, nonsense (NaN, 1e38, other systems, broken frames) at 2 to
250 Hz, changes its mind every second or so, stalls, and in one flight of three dies.  Site, truth (mass 0.8 to 1.5, up
to 0.15 g) and link (0 to 40 ms there and back) are drawn.  An exit is a tick in OFFBOARD, after the chute of take-off
was left, with the true place outside.  One line of the journal per flight; a run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack_worlds import World
from benchmarks.fence_worlds import drawn_site, drawn_world
from flightstack.cli import files
from flightstack.cli.shield import ShieldOptions, shield_stack
from flightstack.cli.shield_router import ShieldRouter
from flightstack.cli.site import TimedSiteFilter, load_site
from flightstack.site.clearance import CHUTE, clear_of, edge_name, packed
from flightstack.site.decide import LEFT, PASSED
from flightstack.types import F64, InputError
from flightstack.vehicle import vehicle_to_toml
from flightstack_sim.grade import load_grade
from flightstack_sim.server import Server
from flightstack_sim.simulated_vehicle import simulated_vehicle
from flightstack_sim.streams import LinkKind
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.link import Link
from mavlink_bridge.requests import set_mode

NAN = float("nan")
_TICK_MS = 4
_CLIMB_S = 6.0


class Program:
    """What a program sends, drawn."""

    def __init__(self, seed: int, reach_m: float) -> None:
        self._rng, self._reach_m = np.random.default_rng([41, seed]), reach_m
        self._until_s = self._next_s = 0.0
        self._kind, self._hz, self._values = "", 50.0, np.zeros(4)
        self.dies_s = float(self._rng.uniform(3.0, 12.0)) if self._rng.uniform() < 1.0 / 3.0 else math.inf

    def say(self, time_s: float) -> object | None:
        """A message, broken bytes, or nothing."""
        if time_s >= self.dies_s or time_s < self._next_s:
            return None
        rng = self._rng
        if time_s >= self._until_s:
            self._until_s = time_s + float(rng.uniform(0.2, 2.5))
            self._kind = str(rng.choice(["place", "velocity", "attitude", "rates", "nonsense", "stall", "jitter"]))
            self._hz, self._values = float(rng.choice([2.5, 10.0, 50.0, 250.0])), rng.normal(size=4)
        self._next_s = time_s + 1.0 / self._hz
        return self._message()

    def _message(self) -> object | None:
        a, b, c, d = self._values.tolist()
        if self._kind == "jitter":
            a, b, c, d = self._rng.normal(size=4).tolist()
        if self._kind == "place":
            return _local(0b1001_1111_1000, (a * self._reach_m, b * self._reach_m, -2.0 + 2.0 * c), (NAN,) * 3)
        if self._kind == "velocity":
            return _local(0b1001_1100_0111, (NAN,) * 3, (4.0 * a, 4.0 * b, c))
        if self._kind == "attitude":
            size = math.sqrt(1.0 + 0.09 * (a * a + b * b))
            q = (1.0 / size, 0.3 * a / size, 0.3 * b / size, 0.0)
            return m.SetAttitudeTarget(0, 1, 1, 7, q, (0.0,) * 3, min(max(0.45 + 0.15 * c, 0.0), 1.0))
        if self._kind in ("rates", "jitter"):
            thrust = min(max(0.45 + 0.2 * d, 0.0), 1.0)
            return m.SetAttitudeTarget(0, 1, 1, 128, (1.0, 0.0, 0.0, 0.0), (a, b, c), thrust)
        return None if self._kind == "stall" else self._nonsense()

    def _nonsense(self) -> object:
        kind = int(self._rng.integers(5))
        if kind == 0:
            return _local(0, (NAN,) * 3, (NAN,) * 3)
        if kind == 1:
            return _local(0b1001_1100_0111, (NAN,) * 3, (1e38, -1e38, 1e38))
        if kind == 2:
            return m.SetAttitudeTarget(0, 1, 1, 128, (NAN,) * 4, (math.inf, NAN, 1e30), NAN)
        if kind == 3:
            return m.SetAttitudeTarget(0, 77, 1, 128, (1.0, 0.0, 0.0, 0.0), (6.0, 6.0, 0.0), 1.0)
        return self._rng.bytes(int(self._rng.integers(1, 80)))


def _local(mask: int, place: tuple[float, ...], speed: tuple[float, ...]) -> m.SetPositionTargetLocalNed:
    return m.SetPositionTargetLocalNed(0, 1, 1, 1, mask, place, speed, yaw_rad=0.0)  # type: ignore[arg-type]


class Delayed:
    """A wire."""

    def __init__(self, late_ms: float) -> None:
        self._late_us, self._waiting = round(1000.0 * late_ms), deque[tuple[int, bytes]]()

    def send(self, data: bytes, now_us: int) -> None:
        """A datagram on its way."""
        self._waiting.append((now_us + self._late_us, data))

    def arrived(self, now_us: int) -> list[bytes]:
        """What is there."""
        found = []
        while self._waiting and self._waiting[0][0] <= now_us:
            found.append(self._waiting.popleft()[1])
        return found


class ShieldFlight:
    """A simulated PX4, the router, and a program that begins as MAVSDK's examples do, all on one clock."""

    def __init__(self, world: World, site: Path, folder: Path) -> None:
        believed, _ = files.load_vehicle(None)
        path = folder / "believed.toml"
        path.write_text(vehicle_to_toml(world.believed(believed)))
        told, _ = files.load_vehicle(str(path))
        self.vehicle = simulated_vehicle(told, world.truth(believed), load_grade(world.grade), seed=world.seed)
        self.server = Server(self.vehicle, links=(LinkKind.ONBOARD,))
        options = ShieldOptions(
            connect="udpin:127.0.0.1:1", serve="udpin:127.0.0.1:2", site=site, vehicle=str(path), sensors=world.grade
        )
        stack, relay, refiner = shield_stack(options, None)
        assert isinstance(stack.filter, TimedSiteFilter)
        self.timed, self.router = stack.filter, ShieldRouter(stack, relay, refiner)
        self.site = load_site(site, None)
        self.flat = packed(self.site, np.zeros((1, 2)), 1.7)
        self.program, self.start = Link(245, 190), np.zeros(3)
        self.down, self.up = Delayed(world.down_ms), Delayed(world.up_ms)
        self.ticks = self.exits = self.offboard = 0
        self.first, self.judged = "", False
        self._disc: F64 = np.zeros((1, 5))

    def run(self, seconds: float, say: Any) -> None:
        """So long, with a program."""
        for k in range(round(1000.0 * seconds / _TICK_MS)):
            self.server.advance(_TICK_MS)
            now_us = self.server.t_us
            for data in self.server.datagrams(0, 1400):
                self.down.send(data, now_us)
            for data in self.down.arrived(now_us):
                self.router.from_vehicle(data, now_us)
            message = say(1e-3 * _TICK_MS * k)
            said = [message] if isinstance(message, bytes) else []
            if message is not None and not said:
                self.program.send(message)
            for data in (*said, *self.program.datagrams_to_send()):
                for kept in self.router.from_program(data, now_us):
                    self.up.send(kept, now_us)
            for data in self.router.step(now_us):
                self.up.send(data, now_us)
            for data in self.up.arrived(now_us):
                self.server.receive(0, data)
            self._judge()

    def _judge(self) -> None:
        record = self.router.record
        if record is None or self.server.commander.state.mode.title != "Offboard":
            return
        self.ticks += 1
        self.offboard += record.filtered.status >= PASSED
        if self.timed.numbers[LEFT] > 0.0:
            self.flat[CHUTE] = -1.0
        place = self.vehicle.plant.pos_ned_m - self.start
        self._disc[0, :3] = place[0], place[1], -place[2]
        clearance, edge = clear_of(self.flat, self._disc, 1, 1.0)
        if clearance < 0.0:
            self.first = self.first or edge_name(self.site, edge)
            self.exits += 1

    def command(self, number: int, *params: float) -> None:
        """A command of the program."""
        given = (*params, *(NAN,) * (7 - len(params)))
        self.program.send(m.CommandLong(1, 1, int(number), 0, given))  # type: ignore[arg-type]

    def take_off(self) -> None:
        """Stream a setpoint, select OFFBOARD, arm, climb."""
        climb = _local(0b1001_1111_1000, (0.0, 0.0, -1.6), (NAN,) * 3)
        self.run(6.0, lambda _: climb)
        self.start = self.vehicle.plant.pos_ned_m.copy()
        number, params = set_mode(px4.MODE_OFFBOARD)
        self.command(number, *params)
        self.run(0.3, lambda _: climb)
        self.command(px4.Cmd.COMPONENT_ARM_DISARM, 1.0)
        self.run(_CLIMB_S, lambda _: climb)


def flown(seed: int, seconds: float, folder: Path) -> dict[str, Any]:
    """One flight."""
    path, world = folder / f"site-{seed}.toml", drawn_world(seed, folder)
    path.write_text(drawn_site(seed))
    world = replace(world, grade="mocap", plant="native")
    try:
        flight = ShieldFlight(world, path, folder)
    except InputError as error:
        return {"seed": seed, "refused": str(error).partition(": ")[2]}
    flight.take_off()
    program = Program(seed, float(np.abs(flight.site.inside).max()))
    flight.run(seconds, program.say)
    score = flight.router.score
    return {
        "seed": seed, "ticks": flight.ticks, "engaged": flight.offboard, "exits": flight.exits, "first": flight.first,
        "changed": score.changed, "stopped": score.stopped, "handed_over": score.handed_over,
        "died": program.dies_s < seconds, "height_m": round(-float(flight.vehicle.plant.pos_ned_m[2]), 2),
    }  # fmt: skip


def main() -> None:
    """Fly what is left and say what came of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--journal", type=Path, default=Path("runs/fence-shield.jsonl"))
    given = parser.parse_args()
    given.journal.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in given.journal.read_text().splitlines()] if given.journal.exists() else []
    done, began = {row["seed"] for row in rows}, time.monotonic()
    with tempfile.TemporaryDirectory(prefix="shield-") as folder, given.journal.open("a") as journal:
        for seed in range(300_000, 300_000 + given.flights):
            if seed not in done and time.monotonic() - began < 60.0 * given.minutes:
                rows.append(flown(seed, given.seconds, Path(folder)))
                print(json.dumps(rows[-1]), file=journal, flush=True)
    flights = [row for row in rows if "refused" not in row]
    left = [row["seed"] for row in flights if row["exits"]]
    engaged = sum(row["engaged"] for row in flights) / max(sum(row["ticks"] for row in flights), 1)
    died, handed = sum(row["died"] for row in flights), sum(row["handed_over"] for row in flights)
    print(
        f"{len(rows)} drawn, {len(rows) - len(flights)} refused, {len(flights)} flown, {len(left)} left ({left[:20]})"
    )
    print(f"engaged in {100.0 * engaged:.1f} % of the ticks in OFFBOARD; {died} programs died, {handed} handed over")


if __name__ == "__main__":
    main()
