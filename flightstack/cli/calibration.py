"""The learner of a flight, seen from outside: how long its steps take, and how honest its bounds were."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from flightstack.calibration import conformal_check, coverage, true_residual_frd_mps2
from flightstack.cli.result import NO_GP, percentiles
from flightstack.model import Model
from flightstack.seams import Learner
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement

if TYPE_CHECKING:
    from flightstack_sim.plant import Truth

_ROW = len(Learned.nothing().row)
_COUNTS = ("points", "fed", "refused", "changes")
_NUMBERS = ("thrust_gain", "thrust_gain_sigma", "latency_s")


class TimedLearner:
    """A learner whose steps are timed; the core has no clock, and nothing of this goes into the log."""

    def __init__(self, learner: Learner) -> None:
        self.enabled = learner.enabled
        self.step_ns: list[int] = []
        """Wall time of each step since the last `init`."""
        self._learner = learner

    def init(self) -> object:
        """The learner's own; the steps before it (warming up) are forgotten."""
        self.step_ns = []
        return self._learner.init()

    def step(
        self, state: object, measurement: Measurement, sent: Command, reference: FlatOutput
    ) -> tuple[object, Learned]:
        """The learner's own, timed."""
        began = time.perf_counter_ns()
        after = self._learner.step(state, measurement, sent, reference)
        self.step_ns.append(time.perf_counter_ns() - began)
        return after


def gp_summary(
    learner: Learner, model: Model, last: Learned | None, rows: Sequence[F64], truths: Sequence[Truth]
) -> dict[str, Any]:
    """The JSON's `gp`: of the tracked ticks `rows` (33,) are what was learned and `truths` what was true.

    `last` is what the flight's last tick knew; `truths` is empty where nobody knows the truth.
    """
    if not learner.enabled:
        return dict(NO_GP)
    learned = np.array(rows).reshape(-1, _ROW)
    residual, sigma = learned[:, Learned.residual_frd_mps2.place], learned[:, Learned.sigma_frd_mps2.place]
    conformal = conformal_check(learned[:, Learned.target_frd_mps2.place], residual, sigma)
    summary: dict[str, Any] = {
        "enabled": True,
        "step_us": percentiles([ns * 1e-3 for ns in learner.step_ns] if isinstance(learner, TimedLearner) else []),
        "conformal": None if conformal is None else dataclasses.asdict(conformal),
    }
    if last is not None:
        summary |= {name: round(getattr(last, name)) for name in _COUNTS}
        summary |= {name: value for name in _NUMBERS if math.isfinite(value := getattr(last, name))}
    if truths:
        seen = coverage(_true_residual(model, truths), residual, sigma)
        summary |= {
            "coverage_3sigma": seen.share,
            "coverage_3sigma_axes": list(seen.axes),
            "coverage_simultaneous": seen.simultaneous,
        }
    return NO_GP | summary


def _true_residual(model: Model, truths: Sequence[Truth]) -> F64:
    parts = ("specific_force_frd_mps2", "motor_u", "vel_ned_mps", "q_ned_frd")
    return true_residual_frd_mps2(model, *(np.array([getattr(truth, part) for truth in truths]) for part in parts))
