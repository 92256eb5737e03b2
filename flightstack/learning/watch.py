"""Each sample's error of prediction, the alarm that a sudden change raises, and the window that becomes a point.

The noise of a window's mean.  An IMU's noise may be coloured (PX4 reports trapezoidal means), so that differences of
neighbouring samples say little of a mean's: with a lag-1 correlation of 0.5 a third of its variance.  Over some seconds
the structure function S(k), half the mean square difference over k samples, is measured for k up to K.  Noise that does
not correlate over K samples has, as a mean of n,

    (S(K) (2 K - 1) - 2 sum over k < K of S(k)) / n

What correlates longer is not told from force and stays what it may be: doubt of the model, which the stores measure.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import Entry, njit
from flightstack.learning import sampler as s
from flightstack.types import F64

_MEAN_SHARE = 0.2
"""Forgetting of the short mean of errors, a sample: 5 samples, 20 ms at 250 Hz."""
_NOISE_SHARE = 0.001
"""Forgetting of the structure function, a sample: 4 s, which leave a window's variance uncertain by a sixth."""
LAGS = 6
"""K: at 250 Hz noise may correlate over 20 ms."""
_CONFIRM = 8
"""Samples in a row whose short mean must lie beyond the alarm: 32 ms."""
_LEAST_MPS2 = 0.3
_FIRST_VARIANCE = 0.04

# The watch's row: per axis short mean and count; structure function S(1) to S(K) of each axis, how many samples went
# into it, the last K targets (the newest first); then the window's sums.
_W_MEAN, _W_COUNT = 0, 3
_W_STRUCTURE = 6
_W_SAMPLES = _W_STRUCTURE + 3 * LAGS
_W_TARGETS = _W_SAMPLES + 1
_W_RUN = _W_TARGETS + 3 * LAGS
"""Samples since the last one that was not fit."""
_W_SUMS = _W_RUN + 1
_SUMMED = s.S_APPLIED - s.S_INPUT
_WATCH = _W_SUMS + _SUMMED

NO_ALARM, LATERAL, VERTICAL = 0, 1, 2


class Watch:
    """The running window and alarm of one flight; mutable."""

    __slots__ = ("_row", "alarm_sigmas", "error", "held", "surprise", "ticks")

    def __init__(self, ticks: int, alarm_sigmas: float) -> None:
        self.ticks, self.alarm_sigmas = ticks, alarm_sigmas
        self._row = np.zeros(_WATCH)
        self._row[_W_STRUCTURE:_W_SAMPLES] = _FIRST_VARIANCE
        self.error = np.zeros(3)
        """Short mean of the errors of prediction, tilt axes."""
        self.surprise = math.nan
        """The largest of them, in what it may be (1 sigma)."""
        self.held = 0
        """Samples in the window."""

    def step(self, sample: F64, expected: F64, variance: F64) -> int:
        """A fit sample against what was expected (3,) with this calibrated variance (3,): which alarm it raises."""
        alarm: int
        alarm, self.surprise = _STEP.call(self._row, sample, expected, variance, self.alarm_sigmas, self.error)
        self.held += 1
        return alarm

    def reset(self) -> None:
        """Begin the window and the alarm anew."""
        self._row[_W_MEAN:_W_STRUCTURE] = 0.0
        self._row[_W_RUN:] = 0.0
        self.held = 0

    @property
    def full(self) -> bool:
        """The window has all its samples."""
        return self.held >= self.ticks

    @property
    def noise_var(self) -> F64:
        """(3,) variance of the noise of a window's mean target, tilt axes."""
        return np.array([_long_run(self._row, i) for i in range(3)]) / self.ticks

    def take(self) -> F64:
        """The window's mean sample (inputs, targets, rate inputs, rate targets, thrust apart), and a new window."""
        mean: F64 = self._row[_W_SUMS:] / self.held
        self._row[_W_SUMS:] = 0.0
        self.held = 0
        return mean


@njit
def _long_run(row: F64, i: int) -> float:
    """Variance of axis i's mean over n samples, times n, by the structure function; at least a tenth of a sample's."""
    place = _W_STRUCTURE + LAGS * i
    last = row[place + LAGS - 1]
    total = (2.0 * LAGS - 1.0) * last
    for k in range(LAGS - 1):
        total -= 2.0 * row[place + k]
    return float(max(total, 0.1 * last))


@njit
def _step(
    row: F64, sample: F64, expected: F64, variance: F64, alarm_sigmas: float, error: F64
) -> tuple[int, float]:  # fmt: skip
    surprise = 0.0
    alarm = NO_ALARM
    if row[_W_RUN] >= LAGS:
        row[_W_SAMPLES] += 1.0
    share = max(_NOISE_SHARE, 1.0 / max(row[_W_SAMPLES], 1.0))
    for i in range(3):
        target = sample[s.S_TARGET + i]
        structure, past = _W_STRUCTURE + LAGS * i, _W_TARGETS + LAGS * i
        if row[_W_RUN] >= LAGS:
            for k in range(LAGS):
                change = target - row[past + k]
                row[structure + k] += share * (0.5 * change * change - row[structure + k])
        for k in range(LAGS - 1, 0, -1):
            row[past + k] = row[past + k - 1]
        row[past] = target
        row[_W_MEAN + i] += _MEAN_SHARE * (target - expected[i] - row[_W_MEAN + i])
        error[i] = row[_W_MEAN + i]
        noise = max(_long_run(row, i), row[structure + LAGS - 1])
        spread = math.sqrt(noise * _MEAN_SHARE / (2.0 - _MEAN_SHARE) + variance[i])
        sigmas = abs(error[i]) / spread
        surprise = max(surprise, sigmas)
        beyond = sigmas > alarm_sigmas and abs(error[i]) > _LEAST_MPS2
        row[_W_COUNT + i] = row[_W_COUNT + i] + 1.0 if beyond else 0.0
        if row[_W_COUNT + i] >= _CONFIRM:
            alarm |= VERTICAL if i == 2 else LATERAL
    row[_W_RUN] += 1.0
    for j in range(_SUMMED):
        row[_W_SUMS + j] += sample[s.S_INPUT + j]
    return alarm, surprise


_STEP = Entry(_step, "f8[::1], f8[::1], f8[::1], f8[::1], f8, f8[::1]")
