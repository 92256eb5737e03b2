"""A flight of which every tick is kept in memory and nothing is written: for studies that look at many flights."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flightstack.calibration import true_residual_frd_mps2
from flightstack.cli.flight import FLIGHT_TIME_LIMIT_S, FlyOptions, Setup, SimulatedFlight, warm_up_all
from flightstack.model import Model
from flightstack.types import F64, Learned, TickRecord
from flightstack_logs.recorder import NoLog
from flightstack_sim.plant import Truth
from mavlink_bridge.pace import undisturbed


class Tape(NoLog):
    """A flight's log (`Recorder`) that keeps the last tick and the last truth."""

    record: TickRecord | None = None
    last_truth: Truth | None = None

    def tick(self, record: TickRecord, t_us: int | None = None) -> None:
        """One tick of the stack."""
        self.record = record

    def truth(self, t_us: int, truth: object) -> None:
        """The simulator's truth."""
        assert isinstance(truth, Truth)
        self.last_truth = truth


@dataclass(slots=True)
class TickTrace:
    """Every tick of the track."""

    before: list[TickRecord]
    """Ticks of the take-off and the run-up, for what must see a flight from its beginning."""
    times_s: list[float]
    records: list[TickRecord]
    truths: list[Truth]
    distances_m: list[float]
    """From the reference, all ticks, `before` and `records`; with sensors of mocap grade the start is known to 1 mm."""

    def take(self, flight: SimulatedFlight, tape: Tape) -> None:
        """The tick that was just flown, where it belongs to the flight up to the track's end."""
        time_s = flight.score.track_s(flight.t_us)
        record, truth = tape.record, tape.last_truth
        if time_s is None or time_s > flight.scenario.duration_s or record is None or truth is None:
            return
        self.distances_m.append(math.dist(truth.pos_ned_m, record.reference.pos_ned_m))
        if time_s < 0.0:
            self.before.append(record)
        else:
            self.times_s.append(time_s)
            self.records.append(record)
            self.truths.append(truth)

    @property
    def learned(self) -> F64:
        """(n, 32) rows of Learned."""
        return np.array([record.learned.row for record in self.records]).reshape(-1, len(Learned.nothing().row))

    def true_residual(self, model: Model) -> F64:
        """(n, 3) what the model does not explain of the true specific force, body FRD, m/s^2."""
        parts = ("specific_force_frd_mps2", "motor_u", "vel_ned_mps", "q_ned_frd")
        return true_residual_frd_mps2(model, *(np.array([getattr(t, part) for t in self.truths]) for part in parts))


def fly_track(
    setup: Setup,
    options: FlyOptions,
    *,
    on_ready: Callable[[SimulatedFlight], None] = lambda flight: None,
    stop_requested: Callable[[], str] = lambda: "",
    on_progress: Callable[[float, str], None] = lambda share, phase: None,
) -> tuple[SimulatedFlight, TickTrace]:
    """Fly to the end over UDP on loopback; every tick of the track.  `on_ready` sees the flight before it begins."""
    warm_up_all(setup)
    tape, track = Tape(), TickTrace([], [], [], [], [])
    flight = SimulatedFlight(setup, options, tape)
    on_ready(flight)
    limit_us = int((flight.scenario.duration_s + FLIGHT_TIME_LIMIT_S) * 1e6)
    ticks = 0
    try:
        with undisturbed(real_time=False):
            while not flight.companion.done and flight.t_us <= limit_us:
                flight.step()
                track.take(flight, tape)
                ticks += 1
                if ticks % 25 == 0:
                    if reason := stop_requested():
                        flight.companion.stop(reason)
                    on_progress(flight.progress, flight.companion.phase)
    finally:
        flight.close()
    return flight, track
