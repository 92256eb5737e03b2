"""The accelerometer bias that the autopilot's filter takes out of what it reports, as another stream gives it away.

PX4 reports HIGHRES_IMU without the accelerometer bias that its filter estimates, and SCALED_IMU with it, in whole mG.
The two samples of one time differ by just that bias, b = raw - reported: fixed to the body, slow.  Their stamps are of
different moments of PX4's work, so which of the newest reported samples belongs to a raw one is told by the differences
themselves: those of two raw samples in a row with their own partners are both b, and agree within what rounding leaves,
in all three axes; with any other sample noise makes them unlike.  What is known of b has no say in it: a rule that
takes the difference nearest to the b believed finds one near any b, and wanders.  A vehicle where most raw samples find
no partner (the two streams of two sensors) is told nothing.  b follows over a second.

A learner takes -b for a force where the bias is not there.  Whether it is, nothing on the link says: an estimator whose
velocity contradicts its own position is not believed (`EstimateObserver.weight`, its greatest axis), one that agrees
with itself is.  What it is not believed of b is added to the specific force again.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit
from flightstack.types import F64, Tuple3

_RING = 8
"""Reported samples that a raw one may belong to: 32 ms at 250 Hz."""
_FOLLOW_S = 1.0
_ALIKE_MPS2 = 0.03
"""Two differences that are both b are no farther apart (length of a vector): rounding to whole mG leaves 0.0098 an
axis, and between two raw samples a b that moves by 0.25 m/s^2 in a second 0.01."""
_PAIRED = 0.5
"""Share of the raw samples of the last second that must have had a partner."""
_MOST_MPS2 = 1.0
"""No filter takes more out (PX4's EKF2_ABL_LIM is 0.4)."""

_BIAS, _LAST_S, _HEAD, _FILLED, _SHARE, _COMPARED, _SAMPLES = 0, 3, 4, 5, 6, 7, 8
_BEFORE = _SAMPLES + 3 * _RING  # the raw sample before this one less each of the reported ones then
_ROW = _BEFORE + 3 * _RING


class ImuBias:
    """What is known of one vehicle's b; mutable, one row of numbers."""

    __slots__ = ("row",)

    def __init__(self) -> None:
        self.row = np.zeros(_ROW)
        self.row[_LAST_S] = -1.0

    @property
    def bias_frd_mps2(self) -> F64:
        """(3,) b, body axes; zero where only one of the streams is heard."""
        return self.row[_BIAS : _BIAS + 3].copy()

    def reported(self, accel_frd_mps2: Tuple3) -> None:
        """A sample without the bias."""
        keep_reported(self.row, np.array(accel_frd_mps2))

    def raw(self, t_us: int, accel_frd_mps2: Tuple3) -> None:
        """A sample with it, and the vehicle's stamp; what is not finite changes nothing."""
        _compare(self.row, 1e-6 * t_us, *accel_frd_mps2)


@njit
def add_bias(row: F64, share: float, force: F64) -> None:
    """Add a share of b to a specific force (3,), in place."""
    for i in range(3):
        force[i] += share * row[_BIAS + i]


@njit
def keep_reported(row: F64, force: F64) -> None:
    """A sample (3,) without the bias."""
    head = int(row[_HEAD])
    place = _SAMPLES + 3 * head
    row[place : place + 3] = force
    row[_HEAD] = (head + 1) % _RING
    row[_FILLED] = min(row[_FILLED] + 1.0, float(_RING))


@njit
def _compare(row: F64, t: float, x: float, y: float, z: float) -> None:
    if not math.isfinite(t + x + y + z):
        return
    since = min(max(t - row[_LAST_S], 0.0), _FOLLOW_S) if row[_LAST_S] >= 0.0 else 0.0
    row[_LAST_S] = t
    filled, compared = int(row[_FILLED]), int(row[_COMPARED])
    differences = np.empty((_RING, 3))
    nearest, best = _ALIKE_MPS2 * _ALIKE_MPS2, -1
    for k in range(filled):
        place = _SAMPLES + 3 * k
        a, b, c = x - row[place], y - row[place + 1], z - row[place + 2]
        differences[k, 0], differences[k, 1], differences[k, 2] = a, b, c
        for j in range(compared):
            old = _BEFORE + 3 * j
            apart = (a - row[old]) ** 2 + (b - row[old + 1]) ** 2 + (c - row[old + 2]) ** 2
            if apart < nearest:
                nearest, best = apart, k
    row[_BEFORE : _BEFORE + 3 * filled] = differences[:filled].ravel()
    row[_COMPARED] = row[_FILLED]
    share = since / _FOLLOW_S
    row[_SHARE] += share * ((1.0 if best >= 0 else 0.0) - row[_SHARE])
    if best < 0 or row[_SHARE] < _PAIRED:
        return
    for i in range(3):
        moved = row[i] + share * (differences[best, i] - row[i])
        row[i] = min(max(moved, -_MOST_MPS2), _MOST_MPS2)
