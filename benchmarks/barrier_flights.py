"""A flight of `campaigns/barrier-filters.toml` over UDP, by the loop of `flightstack certify`, over a worse link.

The datagrams of each tick still go through the sockets; between the two ends they are held back and lost as drawn.
Nothing is written to disk.
"""

from __future__ import annotations

import dataclasses
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.barrier_cases import FLIGHT_S, Adversary, Draw, draw
from flightstack.cli import files
from flightstack.cli.barrier_score import FALLBACKS, WatchedCertifier
from flightstack.cli.certified import counted_mps2, plant_of, vertical
from flightstack.cli.certify import VERTICAL, ExplorationPlanner, prepare_certify
from flightstack.cli.flight import TICK_MS, FlyOptions, Setup, SimulatedFlight, warm_up_all
from flightstack.cli.preparation import Prepared
from flightstack.cli.track import Tape
from flightstack.explore import Explorer
from flightstack.mission import Mission
from flightstack.seams import NoFilter
from flightstack.stack import Stack
from flightstack.types import InputError, TickRecord
from flightstack.vehicle import vehicle_to_toml
from flightstack_sim.shell import ONBOARD
from mavlink_bridge.link import MAX_DATAGRAM
from mavlink_bridge.pace import undisturbed

_LIMIT_S = 120.0
_ROUND_TRIP_MAX_S = 0.1
"""These links are later than what a companion takes off with."""


class Task:
    """The planner of a flight: what is certified is identified first, then the task is flown for its time."""

    def __init__(self, planner: ExplorationPlanner, certifier: WatchedCertifier, task: str) -> None:
        self._planner, self._certifier, self._adverse = planner, certifier, task == "adversary"
        self._since_s = -1.0
        self.begun = False

    def step(self, mission: Mission, t_s: float, record: TickRecord) -> Mission:
        """The explorer's mission, at its end landed; from the first certificate on an adversary's place.

        An explorer's time counts from its first round on: what goes before identifies the vehicle.
        """
        explorer = self._planner.state
        ready = self._adverse or (explorer is not None and bool(explorer.rounds))
        if ready and self._certifier.adopted and self._since_s < 0.0 and t_s >= mission.track_start_s:
            self._since_s = t_s
        waited_s = t_s - self._since_s if self._since_s >= 0.0 else -1.0
        self.begun = self._adverse and waited_s >= 1.0  # the filter has engaged by then
        if waited_s >= FLIGHT_S:
            return mission.stop(t_s)
        if self._adverse and waited_s >= 0.0:
            return mission
        return self._planner.step(mission, t_s, record)


class _Counting(Tape):
    """A log that counts what the filter did."""

    def __init__(self) -> None:
        super().__init__()
        self.infeasible = self.interventions = 0

    def tick(self, record: TickRecord, t_us: int | None = None) -> None:
        """One tick of the stack."""
        super().tick(record)
        self.infeasible += record.filtered.status in FALLBACKS
        self.interventions += record.filtered.intervened == 1.0


class _Wire:
    """One way of the link: datagrams wait for their time, in their order; some never arrive."""

    def __init__(self, delay_ms: float, jitter_ms: float, loss: float, rng: np.random.Generator) -> None:
        self._delay_us, self._jitter_us, self._loss, self._rng = 1e3 * delay_ms, 1e3 * jitter_ms, loss, rng
        self._queue: list[tuple[float, bytes]] = []
        self.flying = False
        """Before the flight nothing is lost: a handshake is no matter of this campaign."""

    def carry(self, datagrams: list[bytes], now_us: int) -> list[bytes]:
        """Take what was sent now; what arrives now."""
        for data in datagrams:
            if self.flying and self._rng.uniform() < self._loss:
                continue
            due = now_us + self._delay_us + self._jitter_us * self._rng.uniform()
            last = self._queue[-1][0] if self._queue else 0.0
            self._queue.append((max(due, last), data))
        if not self._queue or self._queue[0][0] > now_us:
            return []
        arrived = [data for due, data in self._queue if due <= now_us]
        del self._queue[: len(arrived)]
        return arrived


class WorseFlight(SimulatedFlight):
    """A simulated flight whose link is late and lossy, and whose companion speaks every so many ticks only."""

    def __init__(self, setup: Setup, options: FlyOptions, log: Any, planner: Any, world: Draw) -> None:
        super().__init__(setup, options, log, planner)
        rng = np.random.default_rng([6, world.seed])
        self._from_vehicle = _Wire(world.down_ms, world.jitter_ms, world.loss, rng)
        self._to_vehicle = _Wire(world.up_ms, world.jitter_ms, world.loss, rng)
        self._period, self._count = world.period_ticks, 0

    def step(self) -> None:
        """4 ms of the vehicle; the companion's turn where it is one."""
        companion, server = self.companion, self.shell.server
        server.advance(TICK_MS)
        now_us = self.vehicle.t_us
        flying = companion.flight_start_us >= 0
        self._from_vehicle.flying = self._to_vehicle.flying = flying
        arrived = self._from_vehicle.carry(server.datagrams(ONBOARD, MAX_DATAGRAM), now_us)
        for data in self._carry(arrived, self._theirs, self._ours):
            companion.receive_datagram(data, now_us)
        answers: list[bytes] = []
        engaged = companion.flight_start_us
        if self._count % self._period == 0:
            companion.step(now_us)
            answers = companion.link.datagrams_to_send(MAX_DATAGRAM)
        self._count += 1
        for data in self._carry(self._to_vehicle.carry(answers, now_us), self._ours, self._theirs):
            server.receive(ONBOARD, data)
        truth = self.vehicle.plant.truth()
        if engaged != companion.flight_start_us:
            self._true_start_ned_m = truth.pos_ned_m
        self._observe(truth, now_us)


def setup_of(pilot: str, task: str, world: Draw) -> tuple[Setup, Task]:
    """The flight of a pilot, and its task."""
    vehicle, _ = files.load_vehicle(None)
    options = FlyOptions(
        scenario="paper-barrier", seed=world.seed, out=Path("unused"), as_published=pilot == "as-published",
    )  # fmt: skip
    folder = Path(tempfile.mkdtemp(prefix="barrier-"))
    believed, truth = folder / "believed.toml", folder / "truth.toml"
    believed.write_text(vehicle_to_toml(world.believed(vehicle)), encoding="utf-8")
    truth.write_text(vehicle_to_toml(world.truth(vehicle)), encoding="utf-8")
    options = dataclasses.replace(options, vehicle=str(believed), truth=str(truth))
    try:
        held_s = 1e-3 * TICK_MS * world.period_ticks
        setup = prepare_certify(options, dataclasses.replace(VERTICAL, dt_s=held_s + 1e-3 * world.jitter_ms))
    finally:
        shutil.rmtree(folder)
    watched = setup.flight.protection.watched
    assert watched is not None
    planner = Task(ExplorationPlanner(Explorer(), watched), watched, task)
    stack = _stack(setup.flight, pilot, planner, world)
    flight = dataclasses.replace(setup.flight, stack=stack)
    companion = dataclasses.replace(setup.companion, tick_s=held_s, round_trip_max_s=_ROUND_TRIP_MAX_S)
    return dataclasses.replace(setup, flight=flight, companion=companion), planner


def _stack(prepared: Prepared, pilot: str, task: Task, world: Draw) -> Stack:
    """The stack as prepared, with the adversary, without the filter, and with a link's ages allowed for."""
    before = prepared.stack
    late_us = int(1e6 * world.delay_s) + 1000 * TICK_MS * world.period_ticks
    limits = dataclasses.replace(before.limits, latency_max_us=before.limits.latency_max_us + late_us)
    thrust_range = before.model.thrust_range_n(limits)
    controller = Adversary(before.controller, world.seed, thrust_range, lambda: task.begun)
    safety_filter = NoFilter() if pilot == "unfiltered" else before.filter
    return Stack(
        before.model, limits, controller=controller, learner=before.learner, certifier=before.certifier,
        safety_filter=safety_filter, governor=before.governor,
    )  # fmt: skip


def compared(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """A task of a campaign: `pilot` (PILOTS) flies `task` (TASKS) in the world of the seed."""
    pilot, task, world = str(values["pilot"]), str(values["task"]), draw(seed)
    if world.refused:
        raise InputError("less than 0.05 g is left to climb with")
    row: dict[str, Any] = {"draw": dataclasses.asdict(world), "authority_g": world.authority_weights}
    setup, planner = setup_of(pilot, task, world)
    warm_up_all(setup)
    watched = setup.flight.protection.watched
    assert watched is not None
    options = FlyOptions(scenario="paper-barrier", seed=seed)
    tape = _Counting()
    flight = WorseFlight(setup, options, tape, planner, world)
    try:
        with undisturbed():
            while not flight.companion.done and flight.t_us <= _LIMIT_S * 1e6:
                flight.step()
    finally:
        flight.close()
    region = flight.score.region()
    areas = [sum(axis.barrier.area_m2ps for axis in each.axes if axis.axis == 2) for each in watched.adopted]
    left, engaged = bool(region["violations"]), region["engaged_s"] is not None
    sound = pilot == "sound"
    return row | {
        "ended_early": not flight.companion.completed, "why": flight.companion.reason,
        "exits": region["violations"], "left": left and engaged, "left_s": region["left_s"],
        "barrier": {"min_h_truth": region["min_h_truth"]},
        "engaged": engaged, "engaged_s": region["engaged_s"], "infeasible": tape.infeasible, "certificates": len(areas),
        "interventions": tape.interventions,
        "area_first_m2ps": areas[0] if areas else None, "area_last_m2ps": areas[-1] if areas else None,
        "refuted": int(refuted(watched.adopted, setup)),
        "failure": "left the region" if sound and left else "infeasible" if sound and tape.infeasible else "",
    }  # fmt: skip


def refuted(adopted: list[Any], setup: Setup) -> int:
    """How many of the certificates count on more braking than the truth has: physics says that they are wrong."""
    plant = plant_of(setup)
    across = float(np.hypot(*plant.wind_g[:2]))
    up = np.sqrt(max(plant.thrust_max_weights**2 / plant.mass_ratio**2 - across**2, 0.0)) - 1.0 - plant.wind_g[2]
    wrong = 0
    for certificate in adopted:
        axis = vertical(certificate)
        if axis is not None and certificate.mode == "sound":
            wrong += -counted_mps2(axis)[0] > plant.gravity_mps2 * up
    return wrong
