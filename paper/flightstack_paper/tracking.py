"""The paper's first example as parts: its tracking flight with and without learning, and with the baselines.

Every flight is `flightstack fly paper-tracking --no-filter`: simulator and companion in one process, every message
over MAVLink/UDP, lockstep.  Its ticks are kept in memory.  Over those of the flight that learns, the paper's recursive
process is run and timed (`inference`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.cli.flight import FlyOptions, Setup, prepare
from flightstack.cli.track import TickTrace, fly_track
from flightstack.types import F64, Learned
from flightstack_paper.inference import per_iteration
from flightstack_paper.work import PartContext, PartFailed

TRACE_HZ = 10
_TICKS = 250 // TRACE_HZ
_CONTROLLERS = {"learning": "flatness", "none": "flatness"}
"""Pilots whose controller has another name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingFlight:
    """One flight."""

    plant: str
    pilot: str
    seed: int
    duration_s: float
    timed: bool = False
    """The paper's recursive process is run over its ticks and timed."""

    @property
    def options(self) -> FlyOptions:
        """What `fly` would be asked for."""
        return FlyOptions(
            scenario="paper-tracking", seed=self.seed, plant=self.plant, duration_s=self.duration_s,
            controller=_CONTROLLERS.get(self.pilot, self.pilot), learning=self.pilot != "none", filtering=False,
            out=Path("unused"),
        )  # fmt: skip


def fly(flight: TrackingFlight, bench: PartContext) -> dict[str, Any]:
    """Distance from the reference, and what the figures need; PartFailed where the flight did not complete."""
    setup = prepare(flight.options)
    flown, track = fly_track(setup, flight.options, stop_requested=bench.stop_requested, on_progress=bench.on_progress)
    if not flown.companion.completed:
        raise PartFailed(f"the flight did not complete: {flown.companion.reason}")
    found: dict[str, Any] = {**flown.score.tracking(), **trace(track)}
    if flight.pilot in ("learning", "none"):
        found["picture"] = picture(setup, track)
    if flight.pilot == "learning":
        last = track.records[-1].learned
        found |= {
            "points": round(last.points), "fed": round(last.fed), "thrust_gain": last.thrust_gain,
            "residual": _residual(setup, track),
        }  # fmt: skip
        if flight.timed:
            found["inference"] = per_iteration(setup.flight.stack.model, track)
    return found


def trace(track: TickTrace) -> dict[str, Any]:
    """The distance from the reference, rms over each tenth of a second, and when that begins on the path's clock."""
    first = len(track.before) % _TICKS
    distance = np.asarray(track.distances_m[first:])
    count = len(distance) // _TICKS
    blocks = distance[: count * _TICKS].reshape(count, _TICKS)
    return {
        "trace_m": [round(float(each), 5) for each in np.sqrt((blocks**2).mean(axis=1))],
        "trace_from_s": -(len(track.before) // _TICKS) / TRACE_HZ,
    }


def picture(setup: Setup, track: TickTrace) -> dict[str, Any]:
    """The flown path, its reference, some poses of the true vehicle, and the force that acts on it."""
    truths = track.truths
    pos = np.array([truth.pos_ned_m for truth in truths])
    reference = np.array([record.reference.pos_ned_m for record in track.records])
    poses = [truths[round(k)] for k in np.linspace(0.06, 0.94, 5) * (len(truths) - 1)]
    force = setup.truth.effects.get("constant_force", {})
    return {
        "pos_ned_m": _rounded(pos[::_TICKS]),
        "reference_ned_m": _rounded(reference[::_TICKS]),
        "poses": [{"pos_ned_m": list(pose.pos_ned_m), "q_ned_frd": list(pose.q_ned_frd)} for pose in poses],
        "rotors_frd_m": _rounded(setup.truth.rotors.position_m),
        "force_n": [float(force.get(f"{name}_n", 0.0)) for name in ("north", "east", "down")],
        "mass_kg": setup.truth.mass_kg,
    }


def _residual(setup: Setup, track: TickTrace) -> dict[str, float]:
    """How large the unexplained specific force is, and how far the expected one is off."""
    rows, truth = track.learned, track.true_residual(setup.flight.stack.model)
    mean = rows[:, Learned.residual_frd_mps2.place]
    known = np.isfinite(mean).all(axis=1)
    return {"rms_mps2": _rms(truth[known]), "error_rms_mps2": _rms((truth - mean)[known])}


def _rms(vectors: F64) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _rounded(points: F64) -> list[list[float]]:
    return [[round(float(value), 4) for value in row] for row in points]
