"""The paper's recursive process over a flown track, timed: figure "recursive GP inference time per iteration".

As the paper has it: q = (position, velocity, roll, pitch, yaw), six outputs, 300 points; at each time step the point
least related to the present one leaves, the present one enters, mean and variance are asked there.  Both recursions
are those of `flightstack.gp`.  What counts is the processor time of each iteration, every one of
them: pauses in which the machine runs other programs are none of its work; the greatest by the clock is told beside it.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from flightstack.cli.track import TickTrace
from flightstack.frames import euler_from_quat
from flightstack.gp import RecursiveGP, SquaredExponential, least_relevant
from flightstack.model import Model
from flightstack.types import F64

POINTS = 300
_NOISE_VAR = 1e-3
_LENGTHSCALES = (1.0, 1.0, 0.5, 1.0, 1.0, 0.5, 0.3, 0.3, 0.3)
"""Metres, metres per second, radians."""


def stream(model: Model, track: TickTrace) -> tuple[F64, F64]:
    """(n, 9) measured states; (n, 6) true unexplained accelerations, and rates less those asked for; a row a tick."""
    measured = [record.measurement for record in track.records]
    euler = np.array([euler_from_quat(each.q_ned_frd) for each in measured])
    states = np.column_stack([[m.pos_ned_m for m in measured], [m.vel_ned_mps for m in measured], euler])
    asked = np.array([record.command.rate_frd_radps for record in track.records])
    rates = np.array([m.rate_frd_radps for m in measured]) - asked
    return states, np.column_stack([track.true_residual(model), rates])


def per_iteration(model: Model, track: TickTrace) -> dict[str, Any]:
    """Milliseconds of each iteration with `POINTS` points: of the processor, and the greatest by the clock."""
    processor, clock = iterations(*stream(model, track))
    every = max(1, len(processor) // 3000)
    p50, p99 = np.percentile(processor, [50, 99])
    return {
        "points": POINTS, "iterations": len(processor), "max_ms": float(processor.max()), "p50_ms": float(p50),
        "p99_ms": float(p99), "clock_max_ms": float(clock.max()),
        "shown_ms": [round(float(processor[k : k + every].max()), 5) for k in range(0, len(processor), every)],
        "shown_every": every,
    }  # fmt: skip


def iterations(x: F64, y: F64) -> tuple[F64, F64]:
    """(n - POINTS,) milliseconds of each iteration, of processor and clock, after one that loads the code."""
    kernel = SquaredExponential(float(y.var(axis=0).max()) + 1e-3, _LENGTHSCALES)
    gp = RecursiveGP(kernel, _NOISE_VAR, input_dim=9, output_dim=6, capacity=POINTS)
    gp.add(x[:POINTS], y[:POINTS])
    _iterate(gp, x[POINTS - 1], y[POINTS - 1])
    spent = np.empty((2, len(x) - POINTS))
    for i in range(POINTS, len(x)):
        began = time.thread_time_ns(), time.perf_counter_ns()
        _iterate(gp, x[i], y[i])
        spent[:, i - POINTS] = time.thread_time_ns() - began[0], time.perf_counter_ns() - began[1]
    return 1e-6 * spent[0], 1e-6 * spent[1]


def _iterate(gp: RecursiveGP, x: F64, y: F64) -> None:
    gp.remove(least_relevant(gp, x))
    gp.add(x, y)
    gp.predict(x)
