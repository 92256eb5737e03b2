"""Flights without a wire: the stack against the simulated vehicle, its streams sampled as PX4 sends them.

For tuning and for tests of the stack alone: some ten times faster than the same flight over MAVLink, without its log.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flightstack.mission import plan
from flightstack.model import Limits, Model
from flightstack.predictor import Streams, sampled
from flightstack.scenario import Scenario
from flightstack.stack import Stack
from flightstack.types import F64, TickRecord
from flightstack.vehicle import Vehicle
from flightstack_sim.autopilot.setpoint import ControlKind, ControlSetpoint
from flightstack_sim.grade import load_grade
from flightstack_sim.plant import Truth
from flightstack_sim.simulated_vehicle import SimulatedVehicle, simulated_vehicle

TICK_MS = 4


@dataclass(frozen=True, slots=True)
class ClosedLoopFlight:
    """What came of a flight."""

    errors_m: F64
    """(n, 3) true position less the reference's, NED, for each tick of the track."""
    least_height_m: float
    guards: set[str]
    records: list[TickRecord]
    """Every tick, from take-off on."""
    truths: list[Truth]
    """The simulator's truth at each of them."""

    @property
    def rmse_m(self) -> float:
        """Root mean square of the 3-D error over the track."""
        return float(np.sqrt((self.errors_m**2).sum(axis=1).mean()))

    @property
    def rmse_settled_m(self) -> float:
        """The same over the track's second half."""
        settled = self.errors_m[len(self.errors_m) // 2 :]
        return float(np.sqrt((settled**2).sum(axis=1).mean()))

    @property
    def max_m(self) -> float:
        """Largest 3-D error of the track."""
        return float(np.sqrt((self.errors_m**2).sum(axis=1)).max())


class _Wire:
    """Samples of each stream at PX4's rates (IMU 250, position 125, attitude 200 Hz), a few ticks late."""

    def __init__(self, latency_ticks: int) -> None:
        self.streams = Streams()
        self._queue: list[list[tuple[str, tuple[object, ...]]]] = []
        self._latency = latency_ticks
        self._count = 0

    def sample(self, vehicle: SimulatedVehicle) -> None:
        e, means = vehicle.estimate, vehicle.sensors.mean_imu.tolist()
        sent: list[tuple[str, tuple[object, ...]]] = [
            ("imu", (e.t_us, tuple(means[3:]), tuple(means[:3]))),
            ("motors", (e.t_us, tuple(vehicle.motor_command))),
        ]
        if self._count % 2 == 0:
            sent.append(("position", (e.t_us, e.pos_ned_m, e.vel_ned_mps)))
        if self._count % 10 == 0:
            raw = np.round(vehicle.sensors.raw_accel_frd_mps2, 2)
            sent.append(("raw_imu", (e.t_us, tuple(raw.tolist()))))
        if self._count % 5 != 4:
            sent.append(("attitude", (e.t_us, e.q_ned_frd, e.rate_frd_radps)))
        self._count += 1
        self._queue.append(sent)
        if len(self._queue) > self._latency:
            for name, sample in self._queue.pop(0):
                getattr(self.streams, name)(*sample)


def fly(
    scenario: Scenario,
    believed: Vehicle,
    *,
    seed: int = 0,
    grade: str = "mocap",
    make_stack: Callable[[Model, Limits], Stack] = Stack,
    latency_ticks: int = 1,
    truth: Vehicle | None = None,
    plant: str = "native",
) -> ClosedLoopFlight:
    """Climb, run up and track, all from estimates; the true position is only scored.

    Timed events happen as in `fly`.  `latency_ticks`: how late every sample is.
    """
    limits = dataclasses.replace(scenario.limits, latency_max_us=10_000 + latency_ticks * TICK_MS * 1000)
    stack = make_stack(Model.from_vehicle(believed), limits)
    flies = truth or scenario.truth_vehicle(believed)
    vehicle = simulated_vehicle(believed, flies, load_grade(grade), seed=seed, plant=plant)
    wire = _Wire(latency_ticks)
    for _ in range(20 + latency_ticks):
        vehicle.advance(ControlSetpoint(ControlKind.RATE, thrust_norm=0.0), TICK_MS)
        wire.sample(vehicle)
    first = sampled(wire.streams, vehicle.t_us)
    assert first is not None
    first = stack.carried(None, first, vehicle.t_us)
    mission = plan(scenario, first.pos_ned_m)
    state, start_us = stack.init(first), vehicle.t_us
    events = sorted(scenario.events, key=lambda event: event.time_s)
    errors, heights, records, truths = [], [], [], []
    while mission.phase(t := (vehicle.t_us - start_us) * 1e-6) != "done":
        reference = mission.reference(t)
        seen = sampled(wire.streams, vehicle.t_us)
        measured = seen and stack.carried(state, seen, vehicle.t_us)
        state, command, record = stack.tick(state, measured, reference, vehicle.t_us)
        records.append(record)
        truths.append(vehicle.plant.truth())
        while events and events[0].time_s <= t - mission.track_start_s:
            event = events.pop(0)
            vehicle.plant.set_effect(event.effect, dict(event.values))
        if t >= mission.track_start_s:
            errors.append(vehicle.plant.pos_ned_m - reference.pos_ned_m)
            heights.append(-vehicle.plant.pos_ned_m[2])
        rates = (float(command.rate_frd_radps[0]), float(command.rate_frd_radps[1]), float(command.rate_frd_radps[2]))
        vehicle.advance(ControlSetpoint(ControlKind.RATE, rates, command.thrust_norm), TICK_MS)
        wire.sample(vehicle)
    return ClosedLoopFlight(np.array(errors), min(heights), {r.guard for r in records} - {""}, records, truths)
