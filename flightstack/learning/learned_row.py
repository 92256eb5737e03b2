"""The row that a learner says each tick, compiled: feed-forward at the reference, the residual and its bound.

In come the predictions of both stores in tilt axes, out goes a `Learned` row in body axes.  The bound is the stores'
own variance and what no store knows: the estimate's attitude turns what was learned in world axes, and a rotor's drag
goes with its speed.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import Entry, njit
from flightstack.learning import sampler as s
from flightstack.learning.store import INFLATION
from flightstack.learning.tilt import tilt_axes
from flightstack.rows import (
    L_APPLIED,
    L_CHANGES,
    L_CONFIDENCE,
    L_DELAY,
    L_FED,
    L_GAIN,
    L_GAIN_SIGMA,
    L_LATENCY,
    L_POINTS,
    L_REFUSED,
    L_RESIDUAL,
    L_SIGMA,
    L_STAGE,
    L_SURPRISE,
)
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

SLOPE = 3
"""Of what a store says: the error of thrust itself."""
_SURE, _JERK, _TILT, _HEADING = 3, 4, 5, 6
"""Of the limits."""


@njit
def relax(row: F64, jerk_max: float, fed_forward: F64) -> None:
    """Clip the row's jerk, and move `fed_forward` (6,) half way to the row's: what the thrust axis is worked out with.

    Acceleration fed forward depends on the thrust axis and the axis on it; half steps make the fixed point attractive
    even where it depends so steeply that whole ones would run away.  What is not finite is nothing.
    """
    for i in range(6):
        if not math.isfinite(row[i]):
            row[i] = 0.0
        if i >= 3:
            row[i] = min(max(row[i], -jerk_max), jerk_max)
        fed_forward[i] += 0.5 * (row[i] - fed_forward[i])


@njit
def calibrated(posterior: F64, lateral: F64, vertical: F64, out: F64) -> None:
    """(3,) calibrated variances, tilt axes, into `out`: the posteriors' (2,) and the excess of both stores."""
    out[0] = INFLATION * INFLATION * (posterior[0] + lateral[0])
    out[1] = INFLATION * INFLATION * (posterior[0] + lateral[1])
    out[2] = INFLATION * INFLATION * (posterior[1] + vertical[0])


@njit
def _turned(expected: F64, variance: F64, tilt_rad: float, heading_rad: float, out: F64) -> None:
    """(3,) variances, tilt axes, with what errors of tilt and heading make of the expected residual: a turn of it."""
    x, y, z = expected[0] * expected[0], expected[1] * expected[1], expected[2] * expected[2]
    tilt, heading = tilt_rad * tilt_rad, heading_rad * heading_rad
    out[0] = variance[0] + heading * y + tilt * z
    out[1] = variance[1] + heading * x + tilt * z
    out[2] = variance[2] + tilt * (x + y)


@njit
def _with_rotor_speed(expected: F64, thrust_ratio: float, out: F64) -> None:
    """Add that a rotor's drag goes with its speed, the square root of thrust: the lateral kernel has no thrust."""
    share = math.sqrt(max(thrust_ratio, 0.0)) - 1.0
    for i in range(2):
        out[i] += share * share * expected[i] * expected[i]


@njit
def carried(forward: F64, dt_s: float, out: F64) -> None:
    """(2, 4) mean and rate into `out`, the mean carried along its rate."""
    for i in range(4):
        out[0, i] = forward[0, i] + forward[1, i] * dt_s
        out[1, i] = forward[1, i]


@njit
def weighed(
    sample: F64, most: float, posterior: F64, excess: tuple[F64, F64], variance: F64, calm: tuple[F64, F64],
    calm_variance: F64,
) -> bool:  # fmt: skip
    """As `LearnerState.weigh` says."""
    calibrated(posterior, excess[0], excess[1], variance)
    calibrated(posterior, calm[0], calm[1], calm_variance)
    return fits(sample, most)


@njit
def fits(sample: F64, most: float) -> bool:
    """Whether the sample may be learned from."""
    inside = sample[s.S_OK] != 0.0
    for i in range(3):
        inside = inside and abs(sample[s.S_TARGET + i]) <= most
    return bool(inside)


@njit
def assemble(
    limits: F64, query: F64, looked: F64, carry_s: float, forward: F64, weight: float, stage: int, sample: F64,
    expected: F64, variance: F64, fit: int, rate_mean: F64, rate_sigma: F64, points: int, fed: int, refused: int,
    changes: int, surprise: float, fed_forward: F64, usual_thrust: float, gain_variance: float, excess: F64, row: F64,
) -> None:  # fmt: skip
    """A Learned row (33,): feed-forward at the reference, residual at the state, counters.

    What was `looked` up ahead, (2, 4), is carried along over `carry_s`, into `forward`; `excess` (1,): the vertical
    store's.
    """
    carried(looked, carry_s, forward)
    most, gain_least, gain_most = limits[0], limits[1], limits[2]
    if not math.isfinite(forward.sum()):
        forward[:] = 0.0
    tilt, later = np.empty((3, 3)), np.empty((3, 3))
    step = 1e-3
    # A gain beyond its range is cut; what that takes from the force at the present thrust is left to the constant part.
    gain = min(max(1.0 - weight * forward[0, SLOPE] / STANDARD_GRAVITY_MPS2, gain_least), gain_most)
    row[L_GAIN] = gain
    if weight > 0.0:
        cut = forward[0, SLOPE] - (1.0 - gain) * STANDARD_GRAVITY_MPS2 / weight
        forward[0, 2] += cut * sample[s.S_INPUT + s.THRUST]
    tilt_axes(query[0, s.AXIS_N], query[0, s.AXIS_E], tilt)
    tilt_axes(query[0, s.AXIS_N] + step * query[1, s.AXIS_N], query[0, s.AXIS_E] + step * query[1, s.AXIS_E], later)
    for i in range(3):
        acc = rate = 0.0
        for k in range(3):
            acc += tilt[i, k] * forward[0, k]
            rate += tilt[i, k] * forward[1, k] + (later[i, k] - tilt[i, k]) / step * forward[0, k]
        inside = abs(acc) <= most
        row[i] = weight * min(max(acc, -most), most)
        row[3 + i] = weight * rate if inside else 0.0
    c, sine = sample[s.S_HEADING], sample[s.S_HEADING + 1]
    row[L_RESIDUAL] = c * expected[0] + sine * expected[1]
    row[L_RESIDUAL + 1] = c * expected[1] - sine * expected[0]
    row[L_RESIDUAL + 2] = expected[2]
    told = np.empty(3)
    _turned(expected, variance, limits[_TILT], limits[_HEADING], told)
    _with_rotor_speed(expected, sample[s.S_INPUT + s.THRUST] / usual_thrust, told)
    row[L_SIGMA] = math.sqrt(c * c * told[0] + sine * sine * told[1])
    row[L_SIGMA + 1] = math.sqrt(c * c * told[1] + sine * sine * told[0])
    row[L_SIGMA + 2] = math.sqrt(told[2])
    gain_sigma = INFLATION * math.sqrt(gain_variance + excess[0])
    row[L_GAIN_SIGMA] = (gain_sigma if gain_sigma > row[L_SIGMA + 2] else row[L_SIGMA + 2]) / STANDARD_GRAVITY_MPS2
    for i in range(3):
        row[15 + i] = sample[s.S_TARGET_FRD + i] if fit else math.nan
    row[L_APPLIED] = sample[s.S_APPLIED]
    row[L_LATENCY], row[L_DELAY] = sample[s.S_LATENCY], sample[s.S_DELAY]
    sure = -1.0
    if not math.isnan(told[0] + told[1] + told[2]):
        sure = 1.0 - 3.0 * math.sqrt(max(told[0], told[1], told[2])) / limits[_SURE]
    row[L_CONFIDENCE] = weight * sure if sure > 0.0 else 0.0
    row[L_STAGE] = stage
    for i in range(3):
        row[19 + i] = rate_mean[i]
        row[22 + i] = rate_sigma[i]
    row[L_POINTS], row[L_FED], row[L_REFUSED], row[L_CHANGES], row[L_SURPRISE] = points, fed, refused, changes, surprise
    relax(row, limits[_JERK], fed_forward)


WEIGHED = Entry(weighed, "f8[::1], f8, f8[::1], UniTuple(f8[::1], 2), f8[::1], UniTuple(f8[::1], 2), f8[::1]")
ASSEMBLE = Entry(
    assemble,
    "f8[::1], f8[:, ::1], f8[:, ::1], f8, f8[:, ::1], f8, i8, f8[::1], f8[::1], f8[::1], i8, f8[::1], f8[::1], "
    "i8, i8, i8, i8, f8, f8[::1], f8, f8, f8[::1], f8[::1]",
)
