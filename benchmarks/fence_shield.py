"""`python -m benchmarks.fence_shield`: random offboard programs behind the shield, in memory.

A program asks for places (local and on the globe), velocities (also in body frames), accelerations, attitudes, body
rates, random type masks and frames, nonsense (NaN, 1e38, other systems, broken frames), at 2 Hz to 1 kHz; it changes
its mind every second or so, or alternates from message to message, stalls, asks for modes, take-off and landing, and in
one flight of three dies.  One in four begins before the chute was left: how fast it touched the ground is told.  In one
of three a second program speaks as well, in one of three a pilot takes it to Hold and back; messages are signed, of
MAVLink 1, or in pieces; a rover speaks on the vehicle's link.  Site, truth (mass 0.8 to 1.5, a force of up to 0.15 g
that turns), plant and link (0 to 40 ms there and back) are drawn.  An exit is a tick in OFFBOARD, after the chute of
take-off was left, with the true place outside.  One line of the journal per flight; a run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections import deque
from collections.abc import Callable
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
from flightstack.geodesy import PX4_SIH
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
from mavlink_bridge.framing import build_frame
from mavlink_bridge.messages import BY_ID
from mavlink_bridge.requests import set_mode

NAN = float("nan")
_TICK_MS = 4
_CLIMB_S, _SHORT_CLIMB_S, _SHORT_SHARE = 6.0, 1.2, 0.25


class Program:
    """What a program sends, drawn."""

    def __init__(self, seed: int, reach_m: float) -> None:
        self._rng, self._reach_m = np.random.default_rng([41, seed]), reach_m
        self._until_s = self._next_s = 0.0
        self._kind, self._hz, self._values = "", 50.0, np.zeros(4)
        self.dies_s = float(self._rng.uniform(3.0, 12.0)) if self._rng.uniform() < 1.0 / 3.0 else math.inf

    def say(self, time_s: float) -> list[object]:
        """Messages and broken bytes."""
        said: list[object] = []
        rng = self._rng
        if time_s >= self._until_s:
            self._until_s = time_s + float(rng.uniform(0.2, 2.5))
            self._kind = str(rng.choice([*_KINDS, "any", "jitter", "stall", "nonsense", "modes"]))
            self._hz, self._values = float(rng.choice([2.5, 10.0, 50.0, 250.0, 1000.0])), rng.normal(size=4)
        while time_s >= self._next_s and time_s < self.dies_s:
            self._next_s = max(self._next_s + 1.0 / self._hz, time_s - 1e-3 * _TICK_MS)
            message = self._message(self._kind)
            if message is not None:
                said.append(message)
        return said

    def _message(self, kind: str) -> object | None:
        if kind == "modes":
            return self._command()
        if kind in ("any", "jitter"):
            kind = str(self._rng.choice(_KINDS)) if kind == "any" else "rates"
            self._values = self._rng.normal(size=4)
        a, b, c, d = self._values.tolist()
        far = (a * self._reach_m, b * self._reach_m, -2.0 + 2.0 * c)
        if kind == "place":
            return _local(0b1001_1111_1000, far, _UNSET)
        if kind == "globe":
            lat, lon = PX4_SIH.to_globe(far[0], far[1])
            return m.SetPositionTargetGlobalInt(0, 1, 1, 6, 0b1001_1111_1000, lat, lon, -far[2], _UNSET, yaw_rad=0.0)
        if kind == "velocity":
            return _local(0b1001_1100_0111, _UNSET, (4.0 * a, 4.0 * b, c))
        if kind == "body":
            return _local(0b1001_1100_0111, _UNSET, (4.0 * a, 4.0 * b, c), frame=8)
        if kind == "push":
            return _local(0b1001_0011_1111, _UNSET, _UNSET, (5.0 * a, 5.0 * b, 3.0 * c))
        if kind == "mask":
            mask, frame = (int(self._rng.integers(4096)), int(self._rng.choice([1, 1, 7, 8, 9, 12])))
            return _local(mask, far, (4.0 * a, 4.0 * b, c), (a, b, c), frame=frame, yaw_rad=3.0 * d)
        if kind == "attitude":
            size = math.sqrt(1.0 + 0.09 * (a * a + b * b))
            q = (1.0 / size, 0.3 * a / size, 0.3 * b / size, 0.0)
            mask = int(self._rng.choice([7, 3, 0, 64]))
            return m.SetAttitudeTarget(0, 1, 1, mask, q, (a, b, c), min(max(0.45 + 0.15 * c, 0.0), 1.0))
        if kind == "rates":
            thrust = min(max(0.45 + 0.2 * d, 0.0), 1.0)
            return m.SetAttitudeTarget(0, 1, 1, 128, (1.0, 0.0, 0.0, 0.0), (a, b, c), thrust)
        return None if kind == "stall" else self._nonsense()

    def _command(self) -> object:
        """Another mode, or to take off or land; OFFBOARD again as often as not."""
        if self._rng.uniform() < 0.2:
            return _command(int(self._rng.choice(_NAV_LAND_TAKEOFF)), ())
        mode = px4.MODE_OFFBOARD if self._rng.uniform() < 0.5 else int(self._rng.choice(_MODES))
        return _command(*set_mode(mode))

    def _nonsense(self) -> object:
        kind = int(self._rng.integers(7))
        if kind == 0:
            return _local(0, _UNSET, _UNSET)
        if kind == 1:
            return _local(0b1001_1100_0111, _UNSET, (1e38, -1e38, 1e38))
        if kind == 2:
            return m.SetAttitudeTarget(0, 1, 1, 128, (NAN,) * 4, (math.inf, NAN, 1e30), NAN)
        if kind == 3:
            return m.SetAttitudeTarget(0, 77, 1, 128, (1.0, 0.0, 0.0, 0.0), (6.0, 6.0, 0.0), 1.0)
        if kind == 4:
            return _local(0, (1e30, math.inf, -1e30), (math.inf, 0.0, NAN), (-1e30,) * 3, yaw_rad=math.inf)
        if kind == 5:  # a whole setpoint, a little too late for the head before it
            return bytes([0xFD, 5, 0, 0, 0, 0, 0, 0, 0, 0]) + _frame(
                m.SetAttitudeTarget(0, 1, 1, 128, _TURN, _TURN[1:], 1.0)
            )
        return self._rng.bytes(int(self._rng.integers(1, 80)))


_KINDS = ("place", "globe", "velocity", "body", "push", "mask", "attitude", "rates")
_UNSET = (NAN, NAN, NAN)
_NAV_LAND_TAKEOFF = (21, 22)
_MODES = (px4.MODE_HOLD, px4.MODE_LAND, 0x00030000, 0x02040000, 0x05040000)
"""Hold, Land, Position, Takeoff, Return."""
_TURN = (1.0, 0.0, 3.0, 0.0)


def _local(
    mask: int, place: tuple[float, ...], speed: tuple[float, ...], push: tuple[float, ...] = _UNSET,
    frame: int = 1, yaw_rad: float = 0.0,
) -> m.SetPositionTargetLocalNed:  # fmt: skip
    return m.SetPositionTargetLocalNed(0, 1, 1, frame, mask, place, speed, push, yaw_rad)  # type: ignore[arg-type]


def _frame(message: object, flags: int = 0) -> bytes:
    row = BY_ID[m.id_of(type(message))]
    return build_frame(bytes(row.encode(message)), row.id, row.crc_extra, 0, 245, 190, flags) + bytes(13 * flags)


class Pilot:
    """Hold and OFFBOARD again, in one flight of three; and who else speaks."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([43, seed])
        self.flies, self.second = bool(rng.uniform() < 1.0 / 3.0), bool(rng.uniform() < 1.0 / 3.0)
        self.rover, self.flags = bool(rng.uniform() < 0.2), int(rng.uniform() < 0.2)
        self.pieces = bool(rng.uniform() < 0.1)
        self._rng, self._next_s, self._mode = rng, float(rng.uniform(1.0, 8.0)), px4.MODE_HOLD

    def mode(self, time_s: float) -> int | None:
        """To be selected now."""
        if not self.flies or time_s < self._next_s:
            return None
        chosen = self._mode
        self._mode = px4.MODE_OFFBOARD if chosen == px4.MODE_HOLD else px4.MODE_HOLD
        self._next_s = time_s + float(self._rng.uniform(0.02, 4.0))
        return chosen


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
        self.vehicle = simulated_vehicle(
            told, world.truth(believed), load_grade(world.grade), seed=world.seed, plant=world.plant
        )
        self.server = Server(self.vehicle, links=(LinkKind.ONBOARD,))
        options = ShieldOptions(
            connect="udpin:127.0.0.1:1", serve="udpin:127.0.0.1:2", site=site, vehicle=str(path), sensors=world.grade
        )
        stack, relay, refiner = shield_stack(options, None)
        assert isinstance(stack.filter, TimedSiteFilter)
        self.timed, self.router = stack.filter, ShieldRouter(stack, relay, refiner)
        self.site = load_site(site, None)
        self.flat = packed(self.site, np.zeros((1, 2)), self.timed.chute_m)
        self.start, self.pilot = np.zeros(3), Pilot(world.seed)
        self.truth_weight_n = world.truth(believed).weight_n
        self._size_n = float(np.linalg.norm(world.wind_g)) * self.truth_weight_n
        self._wind, self._wind_until_s = np.random.default_rng([44, world.seed]), 0.0
        self.down, self.up = Delayed(world.down_ms), Delayed(world.up_ms)
        self.ticks = self.exits = self.beside = self.offboard = 0
        self.touched_mps = 0.0
        """Fastest within 0.1 m of the ground, in OFFBOARD."""
        self.first, self._is_other = "", False
        self._disc: F64 = np.zeros((1, 5))

    def run(self, seconds: float, say: Callable[[float], list[object]]) -> None:
        """So long, with a program."""
        for k in range(round(1000.0 * seconds / _TICK_MS)):
            time_s = 1e-3 * _TICK_MS * k
            self.server.advance(_TICK_MS)
            now_us = self.server.t_us
            if self.pilot.rover and k % 250 == 0:
                self.router.from_vehicle(_frame_of(5, m.Heartbeat(10, 12, 81, 0, 4)), now_us)
            for data in self.server.datagrams(0, 1400):
                self.down.send(data, now_us)
            for data in self.down.arrived(now_us):
                self.router.from_vehicle(data, now_us)
            for message in say(time_s):
                data = message if isinstance(message, bytes) else _frame(message, self.pilot.flags)
                cut = len(data) // 2 if self.pilot.pieces else len(data)
                for part in (data[:cut], data[cut:]):
                    for kept in self.router.from_program(part, now_us):
                        self.up.send(kept, now_us)
            for data in self.router.step(now_us):
                self.up.send(data, now_us)
            for data in self.up.arrived(now_us):
                self.server.receive(0, data)
            self._judge()

    def attacked(self, seconds: float, programs: list[Program]) -> None:
        """By programs, the pilot and the wind."""

        def say(time_s: float) -> list[object]:
            said = [message for program in programs for message in program.say(time_s)]
            mode = self.pilot.mode(time_s)
            if mode is not None:
                said.append(_command(*set_mode(mode)))
            if time_s >= self._wind_until_s:
                self._wind_until_s = time_s + self._wind.uniform(0.2, 2.5)
                way = self._wind.normal(size=3)
                north, east, down = (self._size_n * way / np.linalg.norm(way)).tolist()
                self.vehicle.plant.set_effect("constant_force", {"north_n": north, "east_n": east, "down_n": down})
            return said

        self.run(seconds, say)

    def _judge(self) -> None:
        """Where it is outside because somebody else flew it there, the shield is not asked; nor is it counted an exit
        where OFFBOARD was entered with no way out clear (`beside`)."""
        record = self.router.record
        if record is None:
            return
        if self.timed.numbers[LEFT] > 0.0:
            self.flat[CHUTE] = -1.0
        place = self.vehicle.plant.pos_ned_m - self.start
        self._disc[0, :3] = place[0], place[1], -place[2]
        clearance, edge = clear_of(self.flat, self._disc, 1, 1.0)
        if self.server.commander.state.mode.title != "Offboard":
            self._is_other = True
            return
        if -place[2] < 0.1:
            self.touched_mps = max(self.touched_mps, float(self.vehicle.plant.vel_ned_mps[2]))
        certain = self.router.flies and record.filtered.status >= PASSED
        self._is_other &= not (certain and clearance >= 0.0)
        self.ticks += 1
        self.offboard += certain
        if clearance < 0.0 and self._is_other:
            self.beside += 1
        elif clearance < 0.0:
            self.first = self.first or edge_name(self.site, edge)
            self.exits += 1

    def take_off(self, climb_s: float) -> None:
        """Stream a setpoint, select OFFBOARD, arm, climb for so long."""
        climb = _local(0b1001_1111_1000, (0.0, 0.0, -1.6), _UNSET)
        self.run(6.0, lambda _: [climb])
        self.start = self.vehicle.plant.pos_ned_m.copy()
        for k in range(3):  # a link may be slow, a message in pieces is none
            cut, self.pilot.pieces = self.pilot.pieces, False
            self.run(0.3, lambda _: [climb, _command(*set_mode(px4.MODE_OFFBOARD))] if _ == 0.0 else [climb])
            if k == 1:
                self.run(0.1, lambda _: [_command(px4.Cmd.COMPONENT_ARM_DISARM, (1.0,))] if _ == 0.0 else [climb])
            self.pilot.pieces = cut
        self.pilot.pieces, cut = False, self.pilot.pieces
        self.run(climb_s, lambda _: [climb])
        self.pilot.pieces = cut


def _command(number: int, params: tuple[float, ...]) -> m.CommandLong:
    return m.CommandLong(1, 1, int(number), 0, (*params, *(NAN,) * (7 - len(params))))  # type: ignore[arg-type]


def _frame_of(system: int, message: object) -> bytes:
    row = BY_ID[m.id_of(type(message))]
    return build_frame(bytes(row.encode(message)), row.id, row.crc_extra, 0, system, 1)


def flown(seed: int, seconds: float, folder: Path) -> dict[str, Any]:
    """One flight."""
    path, world = folder / f"site-{seed}.toml", drawn_world(seed, folder)
    path.write_text(drawn_site(seed))
    world = replace(world, grade="mocap")
    try:
        flight = ShieldFlight(world, path, folder)
    except InputError as error:
        return {"seed": seed, "refused": str(error).partition(": ")[2]}
    is_short = float(np.random.default_rng([45, seed]).uniform()) < _SHORT_SHARE
    flight.take_off(_SHORT_CLIMB_S if is_short else _CLIMB_S)
    reach_m = float(np.abs(flight.site.inside).max())
    programs = [Program(seed + 1_000_000 * k, reach_m) for k in range(1 + flight.pilot.second)]
    flight.attacked(seconds, programs)
    score, pilot = flight.router.score, flight.pilot
    return {
        "seed": seed, "ticks": flight.ticks, "engaged": flight.offboard, "exits": flight.exits,
        "first": flight.first, "beside": flight.beside, "short": is_short, "touched_mps": round(flight.touched_mps, 2),
        "changed": score.changed, "stopped": score.stopped, "handed_over": score.handed_over,
        "died": all(program.dies_s < seconds for program in programs), "plant": world.plant, "pilot": pilot.flies,
        "second": pilot.second, "rover": pilot.rover, "signed": pilot.flags, "pieces": pilot.pieces,
        "armed": flight.server.commander.state.armed,
        "height_m": round(-float(flight.vehicle.plant.pos_ned_m[2]), 2),
    }  # fmt: skip


def main() -> None:
    """Fly what is left and say what came of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=300_000, help="seed to begin with")
    parser.add_argument("--flights", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--journal", type=Path, default=Path("runs/fence-shield.jsonl"))
    given = parser.parse_args()
    given.journal.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in given.journal.read_text().splitlines()] if given.journal.exists() else []
    done, began = {row["seed"] for row in rows}, time.monotonic()
    with tempfile.TemporaryDirectory(prefix="shield-") as folder, given.journal.open("a") as journal:
        for seed in range(given.first, given.first + given.flights):
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
    beside = sum(row["beside"] > 0 for row in flights)
    print(f"engaged in {100.0 * engaged:.1f} % of the ticks in OFFBOARD; {died} programs died, {handed} handed over")
    print(f"{beside} entered OFFBOARD outside, or left it after they entered it with no way out clear")
    short, fastest = sum(row["short"] for row in flights), max((row["touched_mps"] for row in flights), default=0.0)
    print(f"{short} began before the chute was left; the ground was touched in OFFBOARD at {fastest} m/s at most")


if __name__ == "__main__":
    main()
