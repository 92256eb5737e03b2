"""What an autopilot's estimator believes of its accelerometer's bias, where a log has it subtracted already.

A filter with GPS can't tell a level bias from a tilt: what it believes of either wanders, by tenths of a m/s^2 within
some ten seconds, while the two cancel in its own motion.  Of a specific force from which that belief was subtracted the
slow part along the body's level axes is the filter's.  It is estimated beside whatever is named, as a Gauss-Markov
process of a size that the flight itself shows, and no more of it than a filter may believe.  The vertical belief is
pinned by gravity.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flightstack.effects import EFFECTS
from flightstack.gap.decisions import REST_EVIDENCE, SLOW_ERROR_S
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.records import Samples
from flightstack.gap.simulate import prediction_error
from flightstack.gap.sources import FREED
from flightstack.gap.track import COLUMNS, track
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import rotate

LEVEL = (0, 1)
"""Channels of the specific force along the body's level axes."""
_KNOTS_S = 0.95
"""What swings faster than half of this asks is not a filter's: of what a real PX4 believed less than 0.3 % of the
variance lies above 0.35 Hz (`estimator_sensor_bias`); a load sloshes from there on."""
_MOST_KNOTS = 120
_BLOCK_S = 0.25
_SIZES_MPS2 = np.array([0.0, 0.01, 0.02, 0.04, 0.06, 0.09, 0.13, 0.2, 0.3, 0.4])
_LIMIT_MPS2 = 0.4
"""PX4's filter believes no more (EKF2_ABL_LIM)."""
_DOWN_MPS2 = 0.02
"""Of the belief along the body's vertical, on 18 flights of a real PX4."""
_LEAST_MPS2 = 1e-6
_MODES = 8
"""Of what wanders, the slowest shapes: the mean, and down to waves of a quarter of the flight."""
_STEADY = ("constant_force", "steady_wind")
_FEWEST_BLOCKS = 8


def is_freed(samples: Samples) -> bool:
    """Whether an estimator's idea of the bias was subtracted from what the accelerometer said."""
    return FREED in samples.derived


def with_bias(vehicle: Vehicle, samples: Samples) -> Samples:
    """The flight with as much of its slow level force taken for the estimator's as this vehicle leaves."""
    return _with_bias(vehicle, samples) if is_freed(samples) else samples


@lru_cache(maxsize=4)
def _with_bias(vehicle: Vehicle, samples: Samples) -> Samples:
    """`with_bias`, kept: whoever asks again gets the same flight, of which more is kept elsewhere."""
    plain = samples if samples.bias_frd_mps2 is None else replace(samples, bias_frd_mps2=None)
    y = prediction_error(vehicle, plain)[0]
    ok = track(plain).usable
    bias = np.zeros((len(y), 3))
    for axis in LEVEL:
        known = ok & np.isfinite(y[:, axis])
        bias[:, axis] = np.clip(slow_error(y[:, axis], known, samples.dt_s), -_LIMIT_MPS2, _LIMIT_MPS2)
    return replace(plain, bias_frd_mps2=bias) if bias.any() else plain


def mean_level_mps2(samples: Samples) -> float:
    """Of what was taken for the estimator's (`with_bias`), the mean over the flight, in axes of the world or the body.

    A force, a wind or a tilt that is as steady is not told from it; the frame in which it is steadier counts.
    """
    if samples.bias_frd_mps2 is None or not samples.valid.any():
        return 0.0
    in_body = samples.bias_frd_mps2
    in_world = rotate(track(samples).q_ned_frd, in_body)
    return max(float(np.linalg.norm(each[samples.valid, :2].mean(axis=0))) for each in (in_body, in_world))


def moving_level_mps2(samples: Samples) -> float:
    """Of what was taken for the estimator's (`with_bias`), the rms about its mean, in the frame where that is less.

    What swings or comes and goes within some seconds is not told from it.
    """
    if samples.bias_frd_mps2 is None or not samples.valid.any():
        return 0.0
    in_body = samples.bias_frd_mps2
    in_world = rotate(track(samples).q_ned_frd, in_body)
    return min(float(np.linalg.norm(each[samples.valid, :2].std(axis=0))) for each in (in_body, in_world))


def bias_std(vehicle: Vehicle, samples: Samples) -> F64:
    """(3,) how far the estimator's belief is off, one standard deviation; 0 where none of it shows."""
    bias = with_bias(vehicle, samples).bias_frd_mps2
    if bias is None:
        return np.zeros(3)
    std: F64 = np.maximum(np.sqrt(np.mean(bias**2, axis=0)), _LEAST_MPS2)
    std[2] = _DOWN_MPS2
    return std


def columns(vehicle: Vehicle, samples: Samples, every: int) -> F64:
    """(ceil(N / every), 12, 2 M + 1) what the belief may make of every so manieth sample, each of unit size."""
    shapes = _slowest(len(samples.t_s), every, samples.dt_s)
    out = np.zeros((len(shapes), COLUMNS, 2 * _MODES + 1))
    size = bias_std(vehicle, samples)
    for axis in LEVEL:
        begin = axis * _MODES  # a flight of a few seconds has fewer shapes
        out[:, axis, begin : begin + shapes.shape[1]] = size[axis] / np.sqrt(2.0) * shapes
    out[:, 2, -1] = size[2]
    return out


@lru_cache(maxsize=2)
def _slowest(count: int, every: int, dt_s: float) -> F64:
    """(ceil(count / every), M) the slowest shapes of what wanders at every so manieth sample."""
    t_s = np.arange(0, count, every) * dt_s
    root = _root(float(t_s[-1]))
    before, share = _place(t_s, float(t_s[-1]), len(root))
    gram = np.zeros(root.shape)
    for down, up, weight in ((0, 0, (1.0 - share) ** 2), (1, 1, share**2), (0, 1, share * (1.0 - share))):
        np.add.at(gram, (before + down, before + up), weight)
    gram = root.T @ (gram + np.triu(gram, 1).T) @ root
    return _between(t_s, float(t_s[-1]), root @ np.linalg.eigh(gram)[1][:, : -_MODES - 1 : -1])


def lost(flights: Sequence[Samples], effects: Collection[str]) -> set[tuple[str, str]]:
    """Parameters of steady forces that windows of half a second would tell too well: they know of no wander."""
    if not any(is_freed(s) for s in flights):
        return set()
    return {(effect, p.name) for effect in _STEADY if effect in effects for p in EFFECTS[effect].params}


def slow_error(y: F64, ok: Mask, dt_s: float) -> F64:
    """(N,) the slow part of an error (N,) by its means over quarters of a second; nothing where it may be chance."""
    size = max(1, round(_BLOCK_S / dt_s))
    block = np.arange(len(y)) // size
    count = np.bincount(block, weights=ok)
    full = count > 0.5 * size
    if full.sum() < _FEWEST_BLOCKS:
        return np.zeros(len(y))
    mean = np.bincount(block, weights=np.where(ok, y, 0.0))[full] / count[full]
    noise = max(float(np.median(np.abs(np.diff(mean, n=2)))) / 0.6745 / np.sqrt(6.0), 1e-9)
    span_s = len(y) * dt_s
    x, along, power = _principal(full.tobytes(), size * dt_s, span_s)
    shown, power = along.T @ (x.T @ mean) / noise**2, power / noise**2
    size_mps2 = likeliest(shown / np.sqrt(power), power)
    coefficients = along @ (shown * size_mps2**2 / (1.0 + power * size_mps2**2))
    return _between(np.arange(len(y)) * dt_s, span_s, _root(span_s) @ coefficients)


@lru_cache(maxsize=4)
def _principal(full: bytes, block_s: float, span_s: float) -> tuple[F64, F64, F64]:
    """What wanders (R, K) at these blocks' middles, directions (K, k) that it shows there, and the power (k,) of each.

    The same for every vehicle and mostly for both axes.
    """
    x = _between(block_s * (np.flatnonzero(np.frombuffer(full, np.bool_)) + 0.5), span_s, _root(span_s))
    power, along = np.linalg.eigh(x.T @ x)
    told = power > 1e-9 * power[-1]
    return x, along[:, told], power[told]


@lru_cache(maxsize=4)
def _root(span_s: float) -> F64:
    """(K, K) at knots over the span: columns of unit size whose sum wanders as a filter's belief does.

    Round a mean as large, from 0 on: the root of the covariance of a Gauss-Markov process.
    """
    knots = np.linspace(0.0, span_s, min(_MOST_KNOTS, max(2, round(span_s / _KNOTS_S) + 1)))
    covariance = 1.0 + np.exp(-np.abs(knots[:, None] - knots) / SLOW_ERROR_S)
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _place(t_s: NDArray[np.floating[Any]], span_s: float, knots: int) -> tuple[NDArray[np.int64], F64]:
    """(N,) the knot before each time within the span, and the share of the way (N,) to the next."""
    at = t_s * ((knots - 1) / span_s)
    before = np.clip(at.astype(np.int64), 0, knots - 2)
    return before, np.asarray(at - before, dtype=np.float64)


def _between(t_s: NDArray[np.floating[Any]], span_s: float, values: F64) -> F64:
    """(N, ...) what stands at the knots (K, ...), along straight lines between them."""
    before, share = _place(t_s, span_s, len(values))
    share = share.reshape(-1, *([1] * (values.ndim - 1)))
    return np.asarray((1.0 - share) * values[before] + share * values[before + 1])


def likeliest(shown: F64, power: F64) -> float:
    """The size of what wanders that is likeliest, 0 where that is no better than none.

    Rows are of unit noise: `shown` (k,) is what they show along each direction, `power` (k,) its share of size 1.
    """
    gain = _SIZES_MPS2[:, None] ** 2 * power
    likelihood = 0.5 * np.sum(shown**2 * gain / (1.0 + gain) - np.log1p(gain), axis=1)
    best = int(np.argmax(likelihood))
    return float(_SIZES_MPS2[best]) if likelihood[best] >= REST_EVIDENCE else 0.0
