"""The learner of a flight, seen from outside: how long its steps take, and how honest its bounds were."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

from flightstack.calibration import conformal_check, coverage, true_residual_frd_mps2
from flightstack.cli.column import Column
from flightstack.cli.result import NO_GP, percentiles
from flightstack.cli.ticks import TickTable
from flightstack.model import Model
from flightstack.seams import Learner
from flightstack.types import Command, FlatOutput, Learned, Measurement

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


def gp_summary(learner: Learner, model: Model, last: Learned | None, flown: TickTable) -> dict[str, Any]:
    """The JSON's `gp`; `last` is what the flight's last tick knew, the ticks of the track count."""
    if not learner.enabled:
        return dict(NO_GP)
    residual, sigma, target = (each[flown.tracked] for each in flown.learned)
    conformal = conformal_check(target, residual, sigma)
    summary: dict[str, Any] = {
        "enabled": True,
        "step_us": percentiles([ns * 1e-3 for ns in learner.step_ns] if isinstance(learner, TimedLearner) else []),
        "conformal": None if conformal is None else dataclasses.asdict(conformal),
    }
    if last is not None:
        summary |= {name: round(getattr(last, name)) for name in _COUNTS}
        summary |= {name: value for name in _NUMBERS if math.isfinite(value := getattr(last, name))}
    if flown.motion is not None and flown.tracked.any():
        true = true_residual_frd_mps2(model, *(each[flown.tracked] for each in flown.motion))
        seen = coverage(true, residual, sigma)
        summary |= {
            "coverage_3sigma": seen.share,
            "coverage_3sigma_axes": list(seen.axes),
            "coverage_simultaneous": seen.simultaneous,
        }
    return NO_GP | summary
