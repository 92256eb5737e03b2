"""One flight of the learning campaign over UDP, by the very loop of `flightstack fly`, scored against the truth.

Nothing is written to disk: the flight's log goes to a tape that keeps what the scores need.
"""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.learning_cases import CASES, PILOTS, Flight, Pilot
from benchmarks.learning_change import change_summary
from benchmarks.oracle import Oracle
from flightstack.calibration import BOUND_SIGMAS
from flightstack.cli.calibration import TimedLearner
from flightstack.cli.flight import FlyOptions, Setup, SimulatedFlight, prepare
from flightstack.cli.result import percentiles
from flightstack.cli.track import TickTrace, fly_track
from flightstack.control.feedback import FlatnessController
from flightstack.seams import Learner
from flightstack.stack import Stack
from flightstack.types import F64, Learned
from flightstack_sim.plant import NativePlant

TRACE_HZ = 10
_TICKS_PER_TRACE = 250 // TRACE_HZ


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


def _flown(options: FlyOptions, pilot: Pilot) -> tuple[SimulatedFlight, Setup, TickTrace]:
    """Fly to the end over UDP on loopback; every tick of the track."""
    setup = prepare(options)
    oracle = None
    if pilot.exact:
        oracle = Oracle(setup.flight.stack.model, setup.truth)
        setup = _with_parts(setup, learner=oracle)
    elif pilot.confident_share != 1.0:
        setup = _with_parts(setup, confident_share=pilot.confident_share)

    def watch(flown: SimulatedFlight) -> None:
        if oracle is not None:
            assert isinstance(flown.vehicle.plant, NativePlant)
            oracle.watch(flown.vehicle.plant)

    flight, track = fly_track(setup, options, on_ready=watch)
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
    flown, setup, track = _flown(options_of(flight), pilot)
    row: dict[str, Any] = dataclasses.asdict(flight)
    row |= {"completed": flown.companion.completed, "reason": flown.companion.reason}
    row |= {name: value for name, value in flown.score.tracking().items() if name != "of"}
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


def _learned_summary(flown: SimulatedFlight, setup: Setup, track: TickTrace) -> dict[str, Any]:
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
        positions = flown.score.tracked_m()
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
