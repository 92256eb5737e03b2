"""A flight in a site under attack, in memory: the product's stack against the simulated vehicle, no sockets, no log.

Everything that decides is the product's: `prepare`, stack, filter, governor, guard.  Samples and commands are late by
the world's link.  The adversary stands where the nominal controller stands; it pushes to lean limits, dithers rates,
gives references far beyond walls, and the wind turns when it wants, up to what was declared.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack_flight import HARMLESS, Wire, _idle
from benchmarks.attack_worlds import TICK_MS, World
from benchmarks.fence_estimate import ErringEstimate, Truth
from benchmarks.fence_worst import WorstForce
from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.cli import files
from flightstack.cli.flight import FlyOptions, prepare
from flightstack.cli.protection import governor_for
from flightstack.cli.sensors import error_statistics
from flightstack.frames import quat_to_matrix
from flightstack.guard import Guard
from flightstack.mission import plan
from flightstack.model import Limiter
from flightstack.predictor import Streams, sampled
from flightstack.site import slide
from flightstack.site.decide import KEPT, OFF, PASSED
from flightstack.site.stopping import HONEST, Told, stopping
from flightstack.stack import StackState
from flightstack.state_observer import StateObserver
from flightstack.trajectory import hover
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement, Proposal, TickRecord
from flightstack.vehicle import vehicle_to_toml
from flightstack_sim.autopilot.setpoint import ControlKind, ControlSetpoint
from flightstack_sim.grade import load_grade
from flightstack_sim.simulated_vehicle import simulated_vehicle

NOMINAL, THROUGH, PUSH, DITHER, RANDOM = "nominal", "through", "push", "dither", "random"
_REST_TICKS = 250
_UNSLID_S = 0.05
_TURNED_S, _JAMMED = 1.5, 50.0


@dataclass(slots=True)
class Attack:
    """What the adversary does from `begins_s` on."""

    kind: str = NOMINAL
    seed: int = 0
    begins_s: float = 4.0
    gusts: bool = True
    """The force turns every second or two, at its full size."""
    pumps: bool = False
    """Instead it is along the velocity at every moment: it drives the loop where that answers most."""
    turns: bool = False
    """Instead it is against the velocity until a way out is followed, and along it from then on: what the observer has
    seen is wrong by twice the force, just where braking leaves least to catch up with."""
    jams: bool = False
    """Once a way out is followed, all of the rates are asked for, outwards: nothing of such a command is let through,
    so that the way is followed on, and the loop can be driven for as long as it takes; with `turns` the force is along
    the velocity from then on."""
    knows: bool = False
    """Instead as `turns`, but while a way out is followed it takes the course that a search of the model finds to drive
    the loop furthest from that way, searched anew from the true state every 0.2 s."""
    errs: bool = False
    """The estimate errs by all that is declared of it, so that the nearest edge seems further away than it is."""
    reference: Any = None
    """A function of the time since the attack began: a FlatOutput relative to the start, flown with NOMINAL."""
    speed_mps: float = 3.0


@dataclass(slots=True)
class Outcome:
    """What came of it."""

    ticks: int = 0
    engaged: int = 0
    exits: int = 0
    deepest_m: float = 0.0
    """How far outside, at most (a lower bound where the polygon was left)."""
    changed: int = 0
    kept: int = 0
    broken: int = 0
    nearest_m: float = math.inf
    """Least clearance of the truth."""
    travelled_m: float = 0.0
    ended: str = ""
    error_m: list[float] = field(default_factory=list)
    """Distance of the truth from the followed reference."""
    safe_acc: list[F64] = field(default_factory=list)
    """(3,) what each sent command steers towards."""
    solve_us: list[float] = field(default_factory=list)
    seen: list[tuple[float, F64, F64]] = field(default_factory=list)
    """Time, true position, true velocity."""


class Adversary:
    """The controller; `inner` flies before the attack and where the attack is one of references."""

    def __init__(self, inner: Any, attack: Attack, thrust_range_n: tuple[float, float], rate_max: F64) -> None:
        self.inner, self.attack, self.range_n, self.rate_max = inner, attack, thrust_range_n, rate_max
        self.rng = np.random.default_rng([17, attack.seed])
        self.on, self.until_s, self.time_s, self.kind = False, -1.0, 0.0, attack.kind
        self.target, self.lean, self.push = np.zeros(3), np.zeros(2), 0.0
        self.hz, self.size = 5.0, np.zeros(3)

    def init(self, now_us: int) -> Any:
        """The inner controller's state."""
        return self.inner.init(now_us)

    def healthy(self, state: Any) -> bool:
        """The inner controller's."""
        return self.inner.healthy(state)  # type: ignore[no-any-return]

    def step(
        self, state: Any, measurement: Measurement, reference: FlatOutput, learned: Learned, sent: Command, now_us: int
    ) -> tuple[Any, Proposal]:
        """The inner controller's proposal, and what the attack makes of it."""
        state, proposal = self.inner.step(state, measurement, reference, learned, sent, now_us)
        if not self.on or self.kind in (NOMINAL, THROUGH):
            return state, proposal
        if self.time_s > self.until_s:
            self._turn()
        row, thrust = proposal.row.copy(), proposal.thrust_n
        rate = row[17:20]
        if self.kind in (PUSH, RANDOM):
            rate[:2] = _leaning(self.lean, measurement.q_ned_frd)
            thrust = thrust if self.push == 0.0 else self.range_n[1 if self.push > 0.0 else 0]
            if not math.isfinite(thrust):
                thrust = self.range_n[1]
        if self.kind in (DITHER, RANDOM):
            rate += self.size * np.sign(np.sin(2.0 * math.pi * self.hz * self.time_s + np.array([0.0, 1.5, 0.7])))
        np.clip(rate, -self.rate_max, self.rate_max, out=rate)
        return state, dataclasses.replace(proposal, row=row, thrust_n=thrust)

    def jam(self, place_ned_m: F64) -> None:
        """All of the rates outwards, for ever; the place is relative to the start."""
        if self.kind != PUSH or self.until_s < math.inf:
            self.kind, self.until_s, self.push = PUSH, math.inf, 0.0
            self.lean = _JAMMED * place_ned_m[:2] / max(float(np.linalg.norm(place_ned_m[:2])), 1e-6)

    def _turn(self) -> None:
        """Another way to push, for a while."""
        rng = self.rng
        self.until_s = self.time_s + rng.uniform(0.3, 4.0)
        angle = rng.uniform(0.0, 2.0 * math.pi)
        self.lean = rng.uniform(0.1, 0.9) * np.array([math.cos(angle), math.sin(angle)])
        self.push = float(rng.choice([-1.0, 0.0, 0.0, 0.0, 1.0]))
        self.hz, self.size = rng.uniform(1.0, 15.0), rng.uniform(0.0, 6.0, 3) * np.array([1.0, 1.0, 0.3])


def _leaning(lean: F64, q_ned_frd: F64) -> tuple[float, float]:
    """Roll and pitch rate towards a lean (tangent north, east) that pushes that way."""
    turn = quat_to_matrix(q_ned_frd)
    north, east = -lean[0], -lean[1]
    size = math.sqrt(1.0 + north * north + east * east)
    x = (turn[0, 0] * north + turn[1, 0] * east + turn[2, 0]) / size
    y = (turn[0, 1] * north + turn[1, 1] * east + turn[2, 1]) / size
    return -6.0 * y, 6.0 * x


class FenceFlight:
    """One flight; `run` flies it."""

    def __init__(
        self,
        world: World,
        site: Path,
        attack: Attack,
        told: Told = HONEST,
        given: Path | None = None,
        unslid: bool = False,
    ) -> None:
        """`told`: of the doubts, what the filter is told; `given`: certificate; `unslid`: the way out alone."""
        self.world, self.attack = world, attack
        believed, _ = files.load_vehicle(world.vehicle)
        with tempfile.TemporaryDirectory(prefix="fence-") as folder:
            paths = [Path(folder) / name for name in ("believed.toml", "truth.toml")]
            for path, vehicle in zip(paths, (world.believed(believed), world.truth(believed)), strict=True):
                path.write_text(vehicle_to_toml(vehicle), encoding="utf-8")
            options = FlyOptions(
                scenario=world.scenario, seed=world.seed, vehicle=str(paths[0]), truth=str(paths[1]),
                sensors=world.grade, plant=world.plant, site=site, certificate=given,
            )  # fmt: skip
            setup = prepare(options)
        prepared, before = setup.flight, setup.flight.stack
        self.scenario, protection = prepared.scenario, prepared.protection
        assert protection.site is not None
        self.plan_of = protection.site
        declared = estimate_bounds(error_statistics(load_grade(world.grade)))
        if told != HONEST:
            governor = governor_for(prepared.believed, before.model, self.scenario.limits, world.grade)
            lie = stopping(prepared.believed, before.model, self.scenario.limits, declared, governor, told=told)
            self.plan_of = dataclasses.replace(self.plan_of, certificate=lie)
        if unslid:  # what is near moves a command only where it is reached
            self.plan_of.certificate.soft[:, [slide.RADIUS, slide.HALF]] = 0.0
            self.plan_of.certificate.soft[:, slide.SLOW_S] = _UNSLID_S
        self.timed = self.plan_of.filter(before.model, self.scenario.limits)
        self.score = self.plan_of.score(self.timed)
        self._erring = ErringEstimate(declared, self.score.packed) if attack.errs else None
        self.vehicle = simulated_vehicle(
            prepared.believed, setup.truth, setup.grade, seed=world.seed, plant=setup.plant
        )
        self._weight_n = setup.truth.weight_n
        late_us = int(1e3 * (world.down_ms + world.up_ms + world.jitter_ms)) + 1000 * TICK_MS * world.period_ticks
        limits = dataclasses.replace(before.limits, latency_max_us=before.limits.latency_max_us + late_us)
        self.adversary = Adversary(
            before.controller, attack, before.model.thrust_range_n(limits), np.array(limits.rate_max_radps)
        )
        self.stack = copy(before)
        self.stack.controller, self.stack.limits, self.stack.filter = self.adversary, limits, self.timed
        self.stack.guard, self.stack.limiter = Guard(before.model, limits), Limiter(before.model, limits)
        self._streams, self._count, self._setpoint = Streams(), 0, _idle()
        errors = setup.companion.estimate
        self._refiner = StateObserver(errors) if errors is not None and errors.independent else None
        rng = np.random.default_rng([9, world.seed])
        self._down, self._up = (Wire(ms, world.jitter_ms, rng) for ms in (world.down_ms, world.up_ms))
        self._wind = np.random.default_rng([19, attack.seed])
        self._wind_until_s = 0.0
        self._worst = WorstForce()
        self._begin()

    def _begin(self) -> None:
        places, first = [], None
        for _ in range(_REST_TICKS + int(self.world.down_ms)):
            self._advance()
            if (seen := self._measured(None)) is not None:
                first = seen
                places.append(seen.pos_ned_m.copy())
        assert first is not None
        self.start_ned_m = self.vehicle.plant.pos_ned_m.copy()
        self.origin = np.mean(places[-_REST_TICKS:], axis=0)
        self.mission = plan(self.scenario, self.origin)
        self.state = self.stack.init(first, self.origin, stands=True)
        self.start_us = self.vehicle.t_us

    def _measured(self, state: StackState | None) -> Measurement | None:
        measured = sampled(self._streams, self.vehicle.t_us, corrected=self._refiner is None)
        if measured is None:
            return None
        measured = measured if self._refiner is None else self._refiner.refine(measured)
        if self._erring is not None and self.adversary.on:
            measured = self._erring.made(measured, self.start_ned_m, self.origin)
        return self.stack.carried(state, measured, self.vehicle.t_us)

    def _advance(self) -> None:
        """4 ms of the vehicle; its samples at PX4's rates."""
        vehicle = self.vehicle
        vehicle.advance(self._setpoint, TICK_MS)
        e, sensors, plant = vehicle.estimate, vehicle.sensors, vehicle.plant
        if self._erring is not None:
            self._erring.saw(
                Truth(vehicle.t_us, plant.pos_ned_m.copy(), plant.vel_ned_mps.copy(), plant.q_ned_frd.copy())
            )
        sent: list[tuple[str, tuple[object, ...]]] = [
            ("imu", (e.t_us, tuple(sensors.accel_frd_mps2), tuple(sensors.gyro_frd_radps))),
            ("motors", (e.t_us, tuple(vehicle.motor_command))),
        ]
        if self._count % 2 == 0:
            sent.append(("position", (e.t_us, e.pos_ned_m, e.vel_ned_mps)))
        if self._count % 5 != 4:
            sent.append(("attitude", (e.t_us, e.q_ned_frd, e.rate_frd_radps)))
        self._count += 1
        self._down.send(sent, vehicle.t_us)
        for samples in self._down.arrived(vehicle.t_us):
            for name, sample in samples:
                getattr(self._streams, name)(*sample)

    def _reference(self, time_s: float) -> FlatOutput:
        if not self.adversary.on:
            return self.mission.reference(time_s)
        attack, since_s = self.attack, time_s - self.attack.begins_s
        if attack.reference is not None:
            point: FlatOutput = attack.reference(since_s)
            row = point.row.copy()
            row[:3] += self.origin
            return FlatOutput(row)
        if attack.kind == THROUGH:
            if since_s > self.adversary.until_s:
                rng = self.adversary.rng
                self.adversary.until_s = since_s + rng.uniform(1.0, 5.0)
                reach = 1.3 * np.abs(self.plan_of.site.inside).max(axis=0)
                top = self.plan_of.site.ceiling_m
                self.adversary.target = np.array([*rng.uniform(-reach, reach), -rng.uniform(-0.5, 1.3) * top])
            return hover(tuple((self.origin + self.adversary.target).tolist())).at(0.0)
        return self.mission.reference(time_s)

    def _blow(self, time_s: float) -> None:
        if not self.attack.gusts or time_s < self._wind_until_s:
            return
        if self.attack.pumps:
            vel = self.vehicle.plant.vel_ned_mps.copy()
            way, self._wind_until_s = vel / max(float(np.linalg.norm(vel)), 1e-6), time_s + 0.02
        elif self.attack.turns:
            way = self._turned_way(time_s)
        elif self.attack.knows:
            way, self._wind_until_s = self._worst.way(self, time_s), time_s + 0.01
        else:
            way = self._drawn_way(time_s)
        size = float(np.linalg.norm(self.world.wind_g))
        force = size * self._weight_n * way / max(float(np.linalg.norm(way)), 1e-6)
        values = {"north_n": float(force[0]), "east_n": float(force[1]), "down_n": float(force[2])}
        self.vehicle.plant.set_effect("constant_force", values)

    def _turned_way(self, time_s: float) -> F64:
        """Against the velocity; once a way is followed along what it was then, for a second and a half, or (`jams`)
        along what it is."""
        vel: F64 = self.vehicle.plant.vel_ned_mps * np.array([1.0, 1.0, 0.0])
        followed = bool(self.timed.numbers[KEPT] > 0.0)
        self._wind_until_s = time_s + (_TURNED_S if followed and not self.attack.jams else 0.02)
        return vel if followed else -vel

    def _drawn_way(self, time_s: float) -> F64:
        """Another direction, for a while."""
        self._wind_until_s = time_s + self._wind.uniform(0.2, 2.5)
        way: F64 = self._wind.normal(size=3) * np.array([1.0, 1.0, 0.6])
        return way

    def run(self, seconds: float, *, keep: bool = False) -> Outcome:
        """Take off, then attack for so long."""
        out = Outcome()
        for _ in range(int(1000 * (seconds + self.attack.begins_s)) // TICK_MS):
            now_us = self.vehicle.t_us
            time_s = 1e-6 * (now_us - self.start_us)
            self.adversary.on = time_s >= self.attack.begins_s
            self.adversary.time_s = time_s
            if self.adversary.on:
                self._blow(time_s)
                if self.attack.jams and self.timed.numbers[KEPT] > 0.0:
                    self.adversary.jam(self.vehicle.plant.pos_ned_m - self.start_ned_m)
            if self._count % self.world.period_ticks == 0:
                record = self._tick(time_s, now_us)
                self._judge(out, record, time_s, keep)
                if out.ended:
                    break
            for setpoint in self._up.arrived(now_us):
                self._setpoint = setpoint
            self._advance()
        out.exits, out.broken = self.score.exits, self.score.broken
        out.solve_us = [1e-3 * ns for ns in self.timed.solve_ns]
        return out

    def _tick(self, time_s: float, now_us: int) -> TickRecord:
        self.state, command, record = self.stack.tick(
            self.state, self._measured(self.state), self._reference(time_s), now_us
        )
        p, q, r = command.rate_frd_radps.tolist()
        self._up.send(ControlSetpoint(ControlKind.RATE, (p, q, r), command.thrust_norm), now_us)
        return record

    def _judge(self, out: Outcome, record: TickRecord, time_s: float, keep: bool) -> None:
        place = self.vehicle.plant.pos_ned_m - self.start_ned_m
        self.score.add(time_s, record)
        self.score.place(time_s, record, place)
        out.nearest_m = min(out.nearest_m, self.score.clearance_m)
        out.deepest_m = max(out.deepest_m, -self.score.clearance_m)
        if not self.adversary.on:
            return
        numbers = self.timed.numbers
        out.ticks += 1
        out.engaged += record.filtered.status >= PASSED
        out.changed += record.filtered.intervened == 1.0
        out.kept += bool(numbers[KEPT] > 0.0)
        out.travelled_m += float(np.linalg.norm(self.vehicle.plant.vel_ned_mps)) * 1e-3 * TICK_MS
        if record.guard not in HARMLESS:
            out.ended = f"guard: {record.guard}"
        if keep:
            followed = self.timed.reference
            if followed is not None:
                out.error_m.append(float(np.linalg.norm(followed.pos_ned_m - self.origin - place)))
            out.safe_acc.append(record.filtered.safe_acc_ned_mps2.copy())
            out.seen.append((time_s, place.copy(), self.vehicle.plant.vel_ned_mps.copy()))


__all__ = ["DITHER", "NOMINAL", "OFF", "PUSH", "RANDOM", "THROUGH", "Attack", "FenceFlight", "Outcome"]
