"""Windows of a recorded flight: what the learner would have taken as points, for fitting between flights."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from flightstack.learning import sampler as s
from flightstack.learning.learned_row import fits
from flightstack.learning.learner import LearnerConfig
from flightstack.learning.sampler import Sampler
from flightstack.model import Model
from flightstack.types import F64, Command, Measurement


class SampleWindows(NamedTuple):
    """Means of windows of fit samples."""

    x: F64
    """(n, D) inputs, `sampler.INPUTS`."""
    y: F64
    """(n, 3) residual specific force, tilt axes, m/s^2."""
    rate_x: F64
    """(n, 3) body rates that the rate loop's model says, rad/s."""
    rate_y: F64
    """(n, 3) measured less these."""


def windows(
    model: Model, ticks: Iterable[tuple[Measurement, Command]], config: LearnerConfig | None = None
) -> SampleWindows:
    """The windows of one flight; each tick is a measurement and the command sent before it."""
    config = config or LearnerConfig()
    sampler = Sampler(model, config.away_m)
    memory, sample = sampler.init(), np.zeros(s.SAMPLE)
    kept: list[F64] = []
    gathered: list[F64] = []
    for measurement, sent in ticks:
        sampler.step(memory, measurement, sent, sample)
        if sample[s.S_REPEATED] != 0.0:
            continue
        if not fits(sample, config.residual_max_mps2):
            gathered.clear()
            continue
        gathered.append(sample[s.S_INPUT : s.S_APPLIED].copy())
        if len(gathered) == config.window_ticks:
            kept.append(np.mean(gathered, axis=0))
            gathered.clear()
    rows = np.array(kept).reshape(-1, s.S_APPLIED - s.S_INPUT)
    return SampleWindows(*np.split(rows[:, : s.D + 9], (s.D, s.D + 3, s.D + 6), axis=1))
