"""Each sample's error of prediction, the alarm that a sudden change raises, and the window that becomes a point."""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit
from flightstack.learning import sampler as s
from flightstack.types import F64

_MEAN_SHARE = 0.2
"""Forgetting of the short mean of errors, a sample: 5 samples, 20 ms at 250 Hz."""
_NOISE_SHARE = 0.01
_CONFIRM = 8
"""Samples in a row whose short mean must lie beyond the alarm: 32 ms."""
_LEAST_MPS2 = 0.3

# The watch's row: per axis short mean, noise variance, last target, count; then the window: count, sums.
_W_MEAN, _W_NOISE, _W_LAST, _W_COUNT = 0, 3, 6, 9
_W_N, _W_SUMS = 12, 13
_SUMMED = s.S_APPLIED - s.S_INPUT
_WATCH = _W_SUMS + _SUMMED

NO_ALARM, LATERAL, VERTICAL = 0, 1, 2


class Watch:
    """The running window and alarm of one flight; mutable."""

    __slots__ = ("_row", "alarm_sigmas", "error", "surprise", "ticks")

    def __init__(self, ticks: int, alarm_sigmas: float) -> None:
        self.ticks, self.alarm_sigmas = ticks, alarm_sigmas
        self._row = np.zeros(_WATCH)
        self._row[_W_NOISE : _W_NOISE + 3] = 0.04
        self.error = np.zeros(3)
        """Short mean of the errors of prediction, tilt axes."""
        self.surprise = math.nan
        """The largest of them, in what it may be (1 sigma)."""

    def step(self, sample: F64, expected: F64, variance: F64) -> int:
        """A fit sample against what was expected (3,) with this calibrated variance (3,): which alarm it raises."""
        alarm, self.surprise = _step(self._row, sample, expected, variance, self.alarm_sigmas, self.error)
        return int(alarm)

    def reset(self) -> None:
        """Begin the window and the alarm anew."""
        self._row[_W_MEAN : _W_MEAN + 3] = 0.0
        self._row[_W_COUNT:] = 0.0

    @property
    def held(self) -> int:
        """Samples in the window."""
        return int(self._row[_W_N])

    @property
    def full(self) -> bool:
        """The window has all its samples."""
        return bool(self._row[_W_N] >= self.ticks)

    @property
    def noise_var(self) -> F64:
        """(3,) noise of a window's mean target, tilt axes, from the differences of successive samples."""
        noise: F64 = self._row[_W_NOISE : _W_NOISE + 3] / self.ticks
        return noise

    def take(self) -> F64:
        """The window's mean sample (inputs, targets, rate inputs, rate targets), and a new window."""
        mean: F64 = self._row[_W_SUMS:] / self._row[_W_N]
        self._row[_W_N:] = 0.0
        return mean


@njit
def _step(
    row: F64, sample: F64, expected: F64, variance: F64, alarm_sigmas: float, error: F64
) -> tuple[int, float]:  # fmt: skip
    surprise = 0.0
    alarm = NO_ALARM
    for i in range(3):
        target = sample[s.S_TARGET + i]
        if row[_W_N] > 0.0:
            change = target - row[_W_LAST + i]
            row[_W_NOISE + i] += _NOISE_SHARE * (0.5 * change * change - row[_W_NOISE + i])
        row[_W_LAST + i] = target
        row[_W_MEAN + i] += _MEAN_SHARE * (target - expected[i] - row[_W_MEAN + i])
        error[i] = row[_W_MEAN + i]
        spread = math.sqrt(row[_W_NOISE + i] * _MEAN_SHARE / (2.0 - _MEAN_SHARE) + variance[i])
        sigmas = abs(error[i]) / spread
        surprise = max(surprise, sigmas)
        beyond = sigmas > alarm_sigmas and abs(error[i]) > _LEAST_MPS2
        row[_W_COUNT + i] = row[_W_COUNT + i] + 1.0 if beyond else 0.0
        if row[_W_COUNT + i] >= _CONFIRM:
            alarm |= VERTICAL if i == 2 else LATERAL
    row[_W_N] += 1.0
    for j in range(_SUMMED):
        row[_W_SUMS + j] += sample[s.S_INPUT + j]
    return alarm, surprise
