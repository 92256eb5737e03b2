"""The learner of a flight, seen from outside: how long its steps take, and how honest its bounds were."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from flightstack.calibration import conformal_check, coverage, true_residual_frd_mps2
from flightstack.cli.column import Column
from flightstack.cli.result import NO_GP, percentiles
from flightstack.model import Model
from flightstack.seams import Learner
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement

if TYPE_CHECKING:
    from flightstack_sim.plant import Truth

_LEARNED = slice(Learned.residual_frd_mps2.place.start, Learned.target_frd_mps2.place.stop)
"""Places of residual, sigma and target in a row of what is learned."""
_TRUTH, _ENDS = 14, (3, 7, 10)
"""Numbers of them, and where they part."""
_COUNTS = ("points", "fed", "refused", "changes")
_NUMBERS = ("thrust_gain", "thrust_gain_sigma", "latency_s")


class TimedLearner:
    """A learner whose steps are timed; the core has no clock, and nothing of this goes into the log."""

    def __init__(self, learner: Learner) -> None:
        self.enabled = learner.enabled
        self.step_ns = Column()
        """Wall time of each step since the last `init`."""
        self._learner = learner

    def init(self) -> object:
        """The learner's own; the steps before it (warming up) are forgotten."""
        self.step_ns = Column()
        return self._learner.init()

    def step(
        self, state: object, measurement: Measurement, sent: Command, reference: FlatOutput
    ) -> tuple[object, Learned]:
        """The learner's own, timed."""
        began = time.perf_counter_ns()
        after = self._learner.step(state, measurement, sent, reference)
        self.step_ns.append(time.perf_counter_ns() - began)
        return after


class LearnedScore:
    """What was learned and what was true, tick by tick on the track."""

    def __init__(self) -> None:
        self._learned, self._truths = Column(_LEARNED.stop - _LEARNED.start), Column(_TRUTH)

    def add(self, learned: Learned, truth: Truth | None) -> None:
        """One tick."""
        self._learned.extend_bytes(learned.row[_LEARNED])
        if truth is not None:
            self._truths.extend((*truth.specific_force_frd_mps2, *truth.motor_u, *truth.vel_ned_mps, *truth.q_ned_frd))

    @property
    def learned(self) -> tuple[F64, F64, F64]:
        """(n, 3) each: expected residual, its deviation, the residual as measured; body FRD, m/s^2."""
        table = self._learned.table()
        parts = (Learned.residual_frd_mps2, Learned.sigma_frd_mps2, Learned.target_frd_mps2)
        residual, sigma, target = (
            table[:, p.place.start - _LEARNED.start : p.place.stop - _LEARNED.start] for p in parts
        )
        return residual, sigma, target

    def true_residual(self, model: Model) -> F64 | None:
        """(n, 3) what the model does not explain of the true specific force, body FRD, m/s^2; None without a truth."""
        if not len(self._truths):
            return None
        return true_residual_frd_mps2(model, *np.split(self._truths.table(), _ENDS, axis=1))


def gp_summary(learner: Learner, model: Model, last: Learned | None, score: LearnedScore) -> dict[str, Any]:
    """The JSON's `gp`; `last` is what the flight's last tick knew."""
    if not learner.enabled:
        return dict(NO_GP)
    residual, sigma, target = score.learned
    conformal = conformal_check(target, residual, sigma)
    summary: dict[str, Any] = {
        "enabled": True,
        "step_us": percentiles([ns * 1e-3 for ns in learner.step_ns] if isinstance(learner, TimedLearner) else []),
        "conformal": None if conformal is None else dataclasses.asdict(conformal),
    }
    if last is not None:
        summary |= {name: round(getattr(last, name)) for name in _COUNTS}
        summary |= {name: value for name in _NUMBERS if math.isfinite(value := getattr(last, name))}
    if (true := score.true_residual(model)) is not None:
        seen = coverage(true, residual, sigma)
        summary |= {
            "coverage_3sigma": seen.share,
            "coverage_3sigma_axes": list(seen.axes),
            "coverage_simultaneous": seen.simultaneous,
        }
    return NO_GP | summary
