"""Velocity out of three measurements: the velocity itself, the position's derivative, the integrated acceleration.

Each is good at other frequencies: the position below some, the acceleration above another, the velocity between.
Their three differences hold nothing of the motion, only their errors; if these are independent, the differences'
spectra say how large each one's are (the three-cornered hat: Gray and Allan, Proc. 28th Symposium on Frequency
Control, 1974).  The two crossovers are those, of a few, that leave the least error.  Nothing here knows the vehicle.

A filter's velocity is that same acceleration, integrated: they err alike, and what is slow passes for the position's
error.  But a position's error is bounded, its derivative's fades towards low frequencies: where the disagreement of
the two does not, it is the velocity's, and the position is taken instead.  Where the body feels a side force as it
moves, that force says which of the two errs (`gap.side_force`), and overrules both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flightstack.gap import filters
from flightstack.gap.chances import chi2_limit
from flightstack.gap.decisions import CHANCE_P, CLEAR_SHARE, HALF, MOSTLY, SLOW_ERROR_S, SURE_ERRORS, TENTH
from flightstack.gap.filters import spectrum
from flightstack.gap.side_force import BAND_HZ, velocity_share
from flightstack.types import F64

CROSSOVER_HZ = 0.4
"""Below, velocity is the measured one; above, that of the integrated accelerometer."""
_LEAST_FUSED_S = 24.0
"""A shorter flight's spectra don't say which errs."""
_SEGMENT_S = 16.0
_POSITION_BELOW_HZ = (0.0, 0.04, 0.08, 0.16, 0.32)
_INERTIA_ABOVE_HZ = (0.1, 0.2, 0.4, 0.8, 1.6)
_USUAL_HZ = (0.0, CROSSOVER_HZ)
_BOUNDED_HZ = 0.16
"""Below this the position is taken where the velocity errs slowly."""
_MENDED_HZ = 0.32
"""And below this where the side force says so: above, an autopilot's velocity errs by less than its position moves."""
_SLOW_S = SLOW_ERROR_S / 4.0
"""Means of the disagreement: of the power of the shorter's, one of white noise keeps a quarter in the longer's."""


def fused(
    velocity: F64, position: F64 | None, acceleration: F64, dt_s: float, body: tuple[F64, F64, NDArray[np.bool_]]
) -> tuple[F64, F64]:
    """Velocity (N, 3) out of all that measures it, and the standard deviation (3,) of its error, 0 where nothing says.

    `body`: attitude, specific force FRD and the rows to be looked at.
    """
    if position is None:
        return complementary(velocity, acceleration, CROSSOVER_HZ, dt_s), np.zeros(3)
    apart = np.gradient(position, dt_s, axis=0) - velocity
    slow = slow_part(apart, _MENDED_HZ, dt_s)
    if len(velocity) * dt_s < _LEAST_FUSED_S:
        chosen, std = [_USUAL_HZ] * 3, np.sqrt(np.mean(slow**2, axis=0))
    else:
        chosen, std = crossovers(velocity, position, acceleration, dt_s)
    share, error = _by_side_force(velocity, apart, body, dt_s)
    shares = np.full(3, np.nan)
    if error < HALF / SURE_ERRORS:
        now = np.array([_part(apart[:, axis], slow[:, axis], low, dt_s) for axis, (low, _) in enumerate(chosen)])
        differs = np.abs(share - now) > SURE_ERRORS * error
        differs[2] = differs[2] and share > now[2]
        shares[differs] = share
    out = np.empty_like(velocity)
    for axis, (low, high) in enumerate(chosen):
        own = slice(axis, axis + 1)
        mended = velocity[:, own]
        if np.isfinite(shares[axis]):
            mended = mended + shares[axis] * slow[:, own]
            known = HALF if axis == 2 else max(share * (1.0 - share), TENTH * MOSTLY) + error**2
            std[axis] = np.sqrt(known * np.mean(slow[:, axis] ** 2))
        elif low > 0.0:
            mended = mended + slow_part(apart[:, own], low, dt_s)
        out[:, own] = complementary(mended, acceleration[:, own], high, dt_s)
    return out, std


def _by_side_force(
    velocity: F64, apart: F64, body: tuple[F64, F64, NDArray[np.bool_]], dt_s: float
) -> tuple[float, float]:
    """By which share of the slow disagreement the velocity errs, 0 to 1, and its standard deviation."""
    q, force, rows = body
    apart, velocity, force = (slow_part(each, BAND_HZ, dt_s) for each in (apart, velocity, force))
    share, error = velocity_share(apart, velocity, q, force, rows, dt_s)
    return min(max(share, 0.0), 1.0), error


def _part(apart: F64, slow: F64, low_hz: float, dt_s: float) -> float:
    """Of the slow disagreement (N,), what a crossover gives to the position."""
    if low_hz == 0.0:
        return 0.0
    below = slow_part(apart[:, None], low_hz, dt_s)[:, 0]
    return min(1.0, float(below @ slow) / max(float(slow @ slow), 1e-12))


def crossovers(velocity: F64, position: F64, acceleration: F64, dt_s: float) -> tuple[list[tuple[float, float]], F64]:
    """For each axis (position below, inertia above) in Hz, and the standard deviation (3,) of the error then left.

    All in one frame, over ground: (N, 3) m/s, m, m/s^2 without gaps.
    """
    inertial = np.zeros_like(velocity)
    inertial[1:] = np.cumsum(0.5 * dt_s * (acceleration[1:] + acceleration[:-1]), axis=0)
    by_position = np.gradient(position, dt_s, axis=0) - velocity
    by_inertia = inertial - velocity
    chosen, std = [], np.zeros(3)
    share = _white_share(max(1, len(velocity) // round(SLOW_ERROR_S / dt_s)))
    for axis in range(3):
        hz, errors = _errors(by_position[:, axis], by_inertia[:, axis], dt_s)
        left = {
            (low, high): _left(hz, errors, low, high)
            for low in _POSITION_BELOW_HZ
            for high in _INERTIA_ABOVE_HZ
            if low < high
        }
        best = min(left, key=lambda key: left[key])
        if left[best] > CLEAR_SHARE**2 * left[_USUAL_HZ]:
            best = _USUAL_HZ
        slow, slower = (_mean_power(by_position[:, axis], round(s / dt_s)) for s in (_SLOW_S, SLOW_ERROR_S))
        least = left[best]
        if slower > max(least, share * slow):
            best = max(best[0], _BOUNDED_HZ), max(best[1], _USUAL_HZ[1])
            slower *= 0.5  # of two that differ by so much, each errs by half the power
        chosen.append(best)
        std[axis] = np.sqrt(least + slower)
    return chosen, std


def _white_share(means: int) -> float:
    """Of the shorter means' power, what so many of the longer hold of white noise at most, but for chance."""
    return max(1.0 / 3.0, _SLOW_S / SLOW_ERROR_S * chi2_limit(means, CHANCE_P) / means)


def _mean_power(x: F64, block: int) -> float:
    """Mean square of the means over blocks of so many samples."""
    return float(np.mean([np.mean(part) ** 2 for part in np.array_split(x, max(1, len(x) // block))]))


def _left(hz: F64, errors: F64, low_hz: float, high_hz: float) -> float:
    """Variance that the filters of these crossovers leave of the three errors."""
    slow = 1.0 / (1.0 + (hz / high_hz) ** 4)
    slower = 1.0 / (1.0 + (hz / low_hz) ** 4) if low_hz > 0.0 else np.zeros_like(hz)
    shares = np.stack([slow * (1.0 - slower), slow * slower, 1.0 - slow])
    return float(max(np.trapezoid(np.sum(shares**2 * errors, axis=0)[1:], hz[1:]), 1e-12))


def _errors(by_position: F64, by_inertia: F64, dt_s: float) -> tuple[F64, F64]:
    """Frequencies (n,) and the error spectra (3, n) of velocity, position's derivative and integrated acceleration."""
    each = min(len(by_position), round(_SEGMENT_S / dt_s))
    hz, first = spectrum(by_position, by_position, dt_s, each, linear=True)
    second = spectrum(by_inertia, by_inertia, dt_s, each, linear=True)[1]
    shared = spectrum(by_position, by_inertia, dt_s, each, linear=True)[1]
    least = 1e-3 * np.minimum(first, second)
    return hz, np.maximum(np.stack([shared, first - shared, second - shared]), least)


def integrated(rate: F64, dt_s: float) -> F64:
    """Integral along the first axis from 0, trapezoidal."""
    out = np.zeros_like(rate)
    out[1:] = np.cumsum(0.5 * dt_s * (rate[1:] + rate[:-1]), axis=0)
    return out


def complementary(slow: F64, rate: F64, crossover_hz: float, dt_s: float) -> F64:
    """`slow` below the crossover, the integral of `rate` above it: no phase, no drift by a constant error."""
    inertial = integrated(rate, dt_s)
    return inertial + slow_part(slow - inertial, crossover_hz, dt_s)


def slow_part(x: F64, cutoff_hz: float, dt_s: float) -> F64:
    """Zero-phase low-pass of a noisy signal that may drift: its ends' own noise must not bend what lies near them."""
    at = np.linspace(-1.0, 1.0, len(x))[:, None]
    trend = x.mean(axis=0) + at * (np.sum(at * x, axis=0) / np.sum(at * at))
    pad = min(len(x) - 1, int(2.0 / (cutoff_hz * dt_s)) + 3)
    return np.asarray(trend + filters.both_ways(filters.lowpass(cutoff_hz, dt_s), x - trend, pad, even=True))
