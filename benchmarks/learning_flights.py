"""One flight of the learning campaign over UDP, by the very loop of `flightstack fly`, scored against the truth.

Nothing is written to disk: the flight's log goes to a tape that keeps what the scores need.
"""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from app.calibration import TimedLearner
from app.flight import FLIGHT_TIME_LIMIT_S, FlyOptions, Setup, SimulatedFlight, prepare, warm_up_all
from app.result import percentiles
from benchmarks.learning_cases import CASES, PILOTS, Flight, Pilot
from benchmarks.learning_change import change_summary
from benchmarks.oracle import Oracle
from flightstack.calibration import BOUND_SIGMAS, true_residual_frd_mps2
from flightstack.control.feedback import FlatnessController
from flightstack.model import Model
from flightstack.seams import Learner
from flightstack.stack import Stack
from flightstack.types import F64, Learned, TickRecord
from logs import scene as viewer
from mavlink_bridge.pace import undisturbed
from sim.plant import NativePlant, Truth

TRACE_HZ = 10
_TICKS_PER_TRACE = 250 // TRACE_HZ


class Tape:
    """A flight's log that keeps the last tick and the last truth."""

    failed: str | None = None

    def __init__(self) -> None:
        self.record: TickRecord | None = None
        self.last_truth: Truth | None = None

    def tick(self, record: TickRecord) -> None:
        """One tick of the stack."""
        self.record = record

    def truth(self, t_us: int, truth: object) -> None:
        """The simulator's truth."""
        assert isinstance(truth, Truth)
        self.last_truth = truth

    def write(self, topic: str, t_us: int, record: object) -> None:
        """Not kept."""

    def mavlink(self, direction: str, t_us: int, data: bytes) -> None:
        """Not kept."""

    def event(self, t_us: int, name: str, text: str, severity: str = "info") -> None:
        """Not kept."""

    def statustext(self, t_us: int, severity: int, text: str) -> None:
        """Not kept."""

    def location(self, t_us: int, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        """Not kept."""

    def scene(self, t_us: int, view: viewer.Scene) -> None:
        """Not kept."""

    def close(self) -> None:
        """Nothing to finish."""


@dataclasses.dataclass(slots=True)
class Track:
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


def options_of(flight: Flight) -> FlyOptions:
    """What `flightstack fly` would be asked for."""
    case, pilot = CASES[flight.case], PILOTS[flight.pilot]
    return FlyOptions(
        scenario=case.scenario,
        vehicle=case.vehicle,
        truth=case.truth,
        sensors=case.sensors,
        seed=flight.seed,
        controller=pilot.controller,
        learning=pilot.learning and not pilot.exact,
        out=Path("unused"),
    )


def fly_track(options: FlyOptions, pilot: Pilot | None = None) -> tuple[SimulatedFlight, Setup, Track]:
    """Fly to the end over UDP on loopback; every tick of the track."""
    setup = prepare(options)
    oracle = None
    if pilot is not None and pilot.exact:
        oracle = Oracle(setup.flight.stack.model, setup.truth)
        setup = _with_parts(setup, learner=oracle)
    elif pilot is not None and pilot.confident_share != 1.0:
        setup = _with_parts(setup, confident_share=pilot.confident_share)
    warm_up_all(setup)
    tape, track = Tape(), Track([], [], [], [], [])
    flight = SimulatedFlight(setup, options, tape)
    if oracle is not None:
        assert isinstance(flight.vehicle.plant, NativePlant)
        oracle.watch(flight.vehicle.plant)
    limit_us = int((flight.scenario.duration_s + FLIGHT_TIME_LIMIT_S) * 1e6)
    try:
        with undisturbed():
            while not flight.companion.done and flight.t_us <= limit_us:
                flight.step()
                track.take(flight, tape)
    finally:
        flight.close()
    return flight, setup, track


def _with_parts(setup: Setup, *, learner: Learner | None = None, confident_share: float = 1.0) -> Setup:
    """The same flight with another learner, or its flatness controller with a gain schedule."""
    prepared = setup.flight
    before = prepared.stack
    assert isinstance(before.controller, FlatnessController)
    gains = dataclasses.replace(before.controller.gains, confident_share=confident_share)
    controller = FlatnessController(before.model, gains, before.limits)
    stack = Stack(before.model, before.limits, controller=controller, learner=learner or before.learner)
    return dataclasses.replace(setup, flight=dataclasses.replace(prepared, stack=stack))


def fly_scored(flight: Flight) -> dict[str, Any]:
    """One row of the results."""
    pilot = PILOTS[flight.pilot]
    began = time.perf_counter()
    flown, setup, track = fly_track(options_of(flight), pilot)
    row: dict[str, Any] = dataclasses.asdict(flight)
    row |= {"completed": flown.companion.completed, "reason": flown.companion.reason}
    row |= {name: value for name, value in flown.score.tracking.summary().items() if name != "of"}
    row["track_s"] = flown.scenario.duration_s
    row["guards"] = sorted({record.guard for record in track.records} - {""})
    row["saturated"] = float(np.mean([record.thrust_saturated for record in track.records])) if track.records else None
    if setup.flight.stack.learner.enabled and not pilot.exact and track.records:
        row |= _learned_summary(flown, setup, track)
    first = len(track.before) % _TICKS_PER_TRACE
    row["trace_m"] = _decimated(np.asarray(track.distances_m[first:]))
    row["trace_from_s"] = -(len(track.before) // _TICKS_PER_TRACE) / TRACE_HZ
    row["wall_s"] = time.perf_counter() - began
    return row


def _learned_summary(flown: SimulatedFlight, setup: Setup, track: Track) -> dict[str, Any]:
    rows, truth = track.learned, track.true_residual(setup.flight.stack.model)
    mean, sigma = rows[:, Learned.residual_frd_mps2.place], rows[:, Learned.sigma_frd_mps2.place]
    known = np.isfinite(mean).all(axis=1) & np.isfinite(sigma).all(axis=1)
    inside = np.abs(truth - mean)[known] <= BOUND_SIGMAS * sigma[known]
    last = track.records[-1].learned
    summary: dict[str, Any] = {
        "fed": round(last.fed),
        "points": round(last.points),
        "refused": round(last.refused),
        "changes": round(last.changes),
        "latency_s": last.latency_s,
        "thrust_gain": last.thrust_gain,
        "step_us": _step_us(setup),
        "covered": {
            "ticks": int(known.sum()),
            "axes": inside.sum(axis=0).tolist(),
            "all": int(inside.all(axis=1).sum()),
        },
        "residual_rms_mps2": float(np.sqrt((truth**2).sum(axis=1).mean())),
        "residual_error_mps2": float(np.sqrt(((truth - mean)[known] ** 2).sum(axis=1).mean())) if known.any() else None,
    }
    events = flown.scenario.events
    if events:
        positions = np.asarray(flown.score.tracking.distances_m)
        summary["change"] = change_summary(
            events[0].time_s, np.asarray(track.times_s), rows, truth, positions[: len(rows)]
        )
    return summary


def _step_us(setup: Setup) -> dict[str, float | None]:
    """Wall time of a learner's steps, the flight's own machine and neighbours included."""
    learner = setup.flight.stack.learner
    return percentiles([ns * 1e-3 for ns in learner.step_ns] if isinstance(learner, TimedLearner) else [])


def _decimated(distances_m: F64) -> list[float]:
    """Root mean square over each tenth of a second, metres, to 0.1 mm."""
    count = len(distances_m) // _TICKS_PER_TRACE
    blocks = distances_m[: count * _TICKS_PER_TRACE].reshape(count, _TICKS_PER_TRACE)
    return [round(float(value), 4) for value in np.sqrt((blocks**2).mean(axis=1))]
