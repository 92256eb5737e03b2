"""A flight under attack, in memory: the product's stack against the simulated vehicle, no sockets and no log.

Everything that decides is the product's: `prepare`, stack, certifier, filter, guard.  What is left out is the wire;
samples and commands are late by the world's link, message by message.  h of the truth is that of the certificate in
force at each tick, at true position and velocity relative to the true start, as a flight's result has it.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections import deque
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack_adversary import Adversary, Seen, Strategy
from benchmarks.attack_certifier import Held, suited, told
from benchmarks.attack_worlds import TICK_MS, World
from flightstack.barrier.lateness import carried_off
from flightstack.barrier.records import Certificate
from flightstack.barrier.shapes import piece_at
from flightstack.cli import files
from flightstack.cli.barrier_score import FALLBACKS, SOLVED, WatchedCertifier
from flightstack.cli.flight import FlyOptions, Setup, prepare
from flightstack.frames import quat_to_matrix
from flightstack.guard import Guard
from flightstack.jit import njit
from flightstack.mission import plan
from flightstack.model import Limiter
from flightstack.predictor import Streams, sampled
from flightstack.seams import NoFilter
from flightstack.stack import StackState
from flightstack.types import F64, Measurement, TickRecord
from flightstack.vehicle import vehicle_to_toml
from flightstack_sim.autopilot.setpoint import ControlKind, ControlSetpoint
from flightstack_sim.simulated_vehicle import simulated_vehicle

HARMLESS = ("", "clip: command beyond its limits")
"""Of the guard: with any other name the companion lands."""
_REST_TICKS = 250
_SETTLING_US = 1_000_000
"""Engaged for so long before the attack begins."""


class Wire:
    """One way of the link: messages wait for their time, in their order."""

    def __init__(self, delay_ms: float, jitter_ms: float, rng: np.random.Generator) -> None:
        self._delay_us, self._jitter_us, self._rng = 1e3 * delay_ms, 1e3 * jitter_ms, rng
        self._queue: deque[tuple[float, Any]] = deque()

    def send(self, message: Any, now_us: int) -> None:
        """Due after the delay, never before the one sent before."""
        due = now_us + self._delay_us
        if self._jitter_us > 0.0:
            due += self._jitter_us * self._rng.uniform()
        last = self._queue[-1][0] if self._queue else 0.0
        self._queue.append((max(due, last), message))

    def arrived(self, now_us: int) -> list[Any]:
        """What has arrived by now."""
        out = []
        while self._queue and self._queue[0][0] <= now_us:
            out.append(self._queue.popleft()[1])
        return out


@dataclass(slots=True)
class Outcome:
    """What came of an attack."""

    ticks: int = 0
    """Of the attack, as planned; those after an early end count as not engaged."""
    engaged: int = 0
    infeasible: int = 0
    intervened: int = 0
    outside: int = 0
    """Engaged ticks at which the true h was below 0."""
    least_h: float = math.inf
    at_s: float = -1.0
    """When that was, since the attack began."""
    ended: str = ""
    """Why it ended early."""
    broken: int = 0
    """Number of the premise whose breach ended the certificate (`barrier.premise_watch.NAMES`); the attack goes on."""
    broken_s: float = -1.0
    falsified: int = 0
    premises: int = 0
    """Ticks of the stack that were engaged, and those of them in which every estimate was as good as declared."""
    premises_true: int = 0
    tilt_rad: float = 0.0
    """Greatest lean of the truth: that it was flown hard."""
    travelled_m: float = 0.0

    @property
    def share(self) -> float:
        """Engaged ticks over planned ones."""
        return self.engaged / self.ticks if self.ticks else 0.0


def setup_of(world: World, seed: int, given: Path | None = None, **more: Any) -> Setup:
    """The product's preparation, from files; InputError where it refuses."""
    believed, _ = files.load_vehicle(world.vehicle)
    with tempfile.TemporaryDirectory(prefix="attack-") as folder:
        paths = [Path(folder) / name for name in ("believed.toml", "truth.toml")]
        for path, vehicle in zip(paths, (world.believed(believed), world.truth(believed)), strict=True):
            path.write_text(vehicle_to_toml(vehicle), encoding="utf-8")
        options = FlyOptions(
            scenario=world.scenario, seed=seed, vehicle=str(paths[0]), truth=str(paths[1]), sensors=world.grade,
            plant=world.plant, certificate=given, **more,
        )  # fmt: skip
        return prepare(options)


class AttackFlight:
    """One flight; `tick` is 4 ms of both ends."""

    def __init__(self, world: World, seed: int, *, given: Path | None = None, planted: str = "") -> None:
        """`planted` torque: the torque margin is left out, governor and line of the ledger."""
        self.world = world
        setup = setup_of(world, seed, given)
        self.scenario = setup.flight.scenario
        self.vehicle = simulated_vehicle(setup.flight.believed, setup.truth, setup.grade, seed=seed, plant=setup.plant)
        plant, before = self.vehicle.plant, setup.flight.stack
        self.seen = Seen(plant.pos_ned_m.copy(), lambda: (plant.pos_ned_m, plant.vel_ned_mps, plant.q_ned_frd))
        late_us = int(1e3 * (world.down_ms + world.up_ms + world.jitter_ms)) + 1000 * TICK_MS * world.period_ticks
        limits = dataclasses.replace(before.limits, latency_max_us=before.limits.latency_max_us + late_us)
        watched = setup.flight.protection.watched
        assert watched is not None, setup.flight.protection.words
        self.watched: WatchedCertifier = watched
        self.held = Held(told(watched._certifier, lambda config: suited(config, world, planted)), before.model)
        watched._certifier = self.held
        adversary = Adversary(
            before.controller, self.seen, seed, before.model.thrust_range_n(limits), np.array(limits.rate_max_radps)
        )
        self.stack = copy(before)
        self.stack.controller, self.stack.limits = adversary, limits
        self.stack.guard, self.stack.limiter = Guard(before.model, limits), Limiter(before.model, limits)
        self.stack.certifier = self.watched
        self._streams, self._count, self._setpoint = Streams(), 0, _idle()
        errors = getattr(setup.companion, "estimate", None)
        self._refiner: Any = None
        if errors is not None and errors.independent:
            from flightstack.state_observer import StateObserver

            self._refiner = StateObserver(errors)
        rng = np.random.default_rng([9, seed])
        self._down, self._up = (Wire(ms, world.jitter_ms, rng) for ms in (world.down_ms, world.up_ms))
        self._begin()

    def _begin(self) -> None:
        """At rest as long as a companion takes to begin, its place by the mean of what it sees."""
        places, first = [], None
        for _ in range(_REST_TICKS + int(self.world.down_ms)):
            self._advance()
            if (seen := self._measured(None)) is not None:
                first = seen
                places.append(seen.pos_ned_m.copy())
        assert first is not None
        self.seen.origin_ned_m = self.vehicle.plant.pos_ned_m.copy()
        origin = np.mean(places[-_REST_TICKS:], axis=0)
        self.mission = plan(self.scenario, origin)
        self.state: StackState = self.stack.init(first, origin, stands=True)
        self.start_us = self.t_us
        self.record: TickRecord | None = None
        self.ended = ""

    def _measured(self, state: StackState | None) -> Measurement | None:
        """As a companion hands it to the stack."""
        measured = sampled(self._streams, self.t_us, corrected=self._refiner is None)
        if measured is None:
            return None
        measured = measured if self._refiner is None else self._refiner.refine(measured)
        return self.stack.carried(state, measured, self.t_us)

    @property
    def t_us(self) -> int:
        """Simulated time."""
        return self.vehicle.t_us

    @property
    def certificate(self) -> Certificate | None:
        """The one in force."""
        return self.watched.adopted[-1] if self.watched.adopted else None

    def _advance(self) -> None:
        """4 ms of the vehicle; its samples at PX4's rates (IMU 250, position 125, attitude 200 Hz)."""
        vehicle = self.vehicle
        vehicle.advance(self._setpoint, TICK_MS)
        now_us, e, sensors = vehicle.t_us, vehicle.estimate, vehicle.sensors
        sent: list[tuple[str, tuple[object, ...]]] = [
            ("imu", (e.t_us, tuple(sensors.accel_frd_mps2), tuple(sensors.gyro_frd_radps))),
            ("motors", (e.t_us, tuple(vehicle.motor_command))),
        ]
        if self._count % 2 == 0:
            sent.append(("position", (e.t_us, e.pos_ned_m, e.vel_ned_mps)))
        if self._count % 5 != 4:
            sent.append(("attitude", (e.t_us, e.q_ned_frd, e.rate_frd_radps)))
        self._count += 1
        self._down.send(sent, now_us)
        for samples in self._down.arrived(now_us):
            for name, sample in samples:
                getattr(self._streams, name)(*sample)

    def tick(self) -> TickRecord | None:
        """4 ms; the record where it was the stack's turn."""
        now_us = self.t_us
        record = None
        if self._count % self.world.period_ticks == 0:
            reference = self.mission.reference(1e-6 * (now_us - self.start_us))
            measured = self._measured(self.state)
            self.state, command, record = self.stack.tick(self.state, measured, reference, now_us)
            rates = tuple(command.rate_frd_radps.tolist())
            self._up.send(ControlSetpoint(ControlKind.RATE, rates, command.thrust_norm), now_us)
            self.record, self.seen.certificate = record, self.certificate
            if record.guard not in HARMLESS:
                self.ended = f"guard: {record.guard}"
            elif record.filtered.handed_over:
                self.ended = "falsified and handed over"
        for setpoint in self._up.arrived(now_us):
            self._setpoint = setpoint
        self._advance()
        return record

    def reseed(self, seed: int) -> None:
        """Other noise of the sensors from now on, once what was drawn ahead (a second) is used up."""
        sensors = self.vehicle.sensors
        for k, rng in enumerate((sensors._imu_rng, sensors.estimator._rng)):
            rng.bit_generator.state = np.random.PCG64(np.random.SeedSequence([10, seed, k])).state

    def unguard(self) -> None:
        """Without the guard's limit of the tilt from now on, and without the filter before it."""
        stack = self.stack
        stack.guard = Guard(stack.model, dataclasses.replace(stack.limits, tilt_abort_rad=math.pi))
        stack.filter = NoFilter()

    def fly_until_engaged(self, limit_s: float) -> float | None:
        """The nominal flight until the filter has been engaged for a second; the time of the first such tick, s."""
        since_us = None
        while not self.ended and self.t_us - self.start_us < 1e6 * limit_s:
            if (record := self.tick()) is None:
                continue
            if not record.filtered.status >= SOLVED:
                since_us = None
            elif since_us is None:
                since_us = record.t_us
            elif record.t_us - since_us >= _SETTLING_US:
                return 1e-6 * (since_us - self.start_us)
        return None

    def attack(
        self, strategy: Strategy | None, seconds: float, each: Callable[[TickRecord], None] | None = None
    ) -> Outcome:
        """Fly the strategy for so long; None: the nominal controller.  `each` sees every tick of the stack."""
        seen, out, plant = self.seen, Outcome(), self.vehicle.plant
        seen.strategy, seen.since_us = strategy, self.t_us
        count = round(1e3 * seconds / TICK_MS)
        states = np.empty((count, 6))
        errors: list[F64] = []
        in_force, engaged = np.zeros(count, dtype=np.intp), np.zeros(count, dtype=bool)
        out.ticks, flown, status = count, 0, 0.0
        adopted_before = len(self.watched.adopted)
        for k in range(count):
            before = plant.pos_ned_m.copy(), plant.vel_ned_mps.copy(), plant.q_ned_frd.copy()
            record = self.tick()
            if record is not None:
                status = record.filtered.status
                if status >= SOLVED and not self.ended:
                    errors.append(self._estimate_error(record, *before))
                out.infeasible += status in FALLBACKS
                out.intervened += record.filtered.intervened == 1.0
                if not out.broken and (ended_by := getattr(record.filtered, "ended_by", 0.0)) > 0.0:
                    out.broken, out.broken_s = int(ended_by), 1e-3 * TICK_MS * k
                if each is not None:
                    each(record)
            states[k, :3], states[k, 3:] = plant.pos_ned_m, plant.vel_ned_mps
            in_force[k], engaged[k] = len(self.watched.adopted), status >= SOLVED and not self.ended
            q = plant.q_ned_frd
            out.tilt_rad = max(out.tilt_rad, math.acos(min(1.0, 1.0 - 2.0 * float(q[1] * q[1] + q[2] * q[2]))))
            flown = k + 1
            if self.ended:
                break
        seen.strategy = None
        out.ended, out.engaged = self.ended, int(engaged.sum())
        out.falsified = sum("falsified" in c.knowledge for c in self.watched.adopted[adopted_before:])
        out.travelled_m = float(np.linalg.norm(np.diff(states[:flown, :3], axis=0), axis=1).sum())
        out.premises, out.premises_true = len(errors), self._as_declared(errors)
        h = self._true_h(states[:flown], in_force[:flown])
        h[~engaged[:flown]] = np.inf
        if len(h):
            worst = int(np.argmin(h))
            out.least_h, out.at_s, out.outside = float(h[worst]), 1e-3 * TICK_MS * worst, int((h < 0.0).sum())
        return out

    def _estimate_error(self, record: TickRecord, pos: F64, vel: F64, q: F64) -> F64:
        """(9,) errors of position (m), velocity (m/s) and of what thrust along the axis as estimated gives (m/s^2)."""
        seen = record.measurement
        off = (seen.pos_ned_m - self.state.origin_ned_m) - (pos - self.seen.origin_ned_m)
        lean = quat_to_matrix(seen.q_ned_frd)[:, 2] - quat_to_matrix(q)[:, 2]
        thrust_mps2 = float(np.linalg.norm(seen.specific_force_frd_mps2))
        return np.abs(np.concatenate([off, seen.vel_ned_mps - vel, thrust_mps2 * lean]))

    def _as_declared(self, errors: list[F64]) -> int:
        certificate = self.certificate
        if certificate is None or certificate.premises is None or not errors:
            return 0
        most = np.concatenate([*carried_off(certificate), certificate.premises.estimate.acc_mps2])
        return int((np.array(errors) <= most).all(axis=1).sum())

    def _true_h(self, states: F64, in_force: np.ndarray) -> F64:
        h = np.full(len(states), np.inf)
        places = states[:, :3] - self.seen.origin_ned_m
        for count in np.unique(in_force):
            if count == 0:
                continue
            certificate, at = self.watched.adopted[count - 1], np.flatnonzero(in_force == count)
            for axis in certificate.axes:
                i = axis.axis
                values = _values(axis.barrier.rows, places[at, i] - certificate.centre_ned_m[i], states[at, 3 + i])
                h[at] = np.minimum(h[at], values)
        return h


@njit
def _values(rows: F64, e: F64, v: F64) -> F64:
    """(n,) least h over an axis' pieces."""
    h = np.full(len(e), np.inf)
    for k in range(len(e)):
        for i in range(rows.shape[0]):
            h[k] = min(h[k], piece_at(rows[i], e[k], v[k])[0])
    return h


def _idle() -> ControlSetpoint:
    return ControlSetpoint(ControlKind.RATE, thrust_norm=0.0)
