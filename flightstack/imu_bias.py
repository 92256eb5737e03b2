"""The accelerometer bias that the autopilot's filter takes out of what it reports, as another stream gives it away.

PX4 reports HIGHRES_IMU without the accelerometer bias that its filter estimates, and SCALED_IMU with it, in whole mG.
The two samples of one time differ by just that bias, b = raw - reported: fixed to the body, slow.  Their stamps are of
different moments of PX4's work, so of the newest reported samples the one is taken whose difference from the raw one is
nearest to b as known; noise makes any other pair unlike.  b follows over a second.

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
_NEAR_MPS2 = 0.15
"""A pair whose difference is farther from b than this is none; the limit grows while none is found."""
_GROWTH_MPS3 = 0.1
_MOST_MPS2 = 1.0
"""No filter takes more out (PX4's EKF2_ABL_LIM is 0.4)."""

_BIAS, _LAST_S, _HEAD, _FILLED, _SAMPLES = 0, 3, 4, 5, 6
_ROW = _SAMPLES + 3 * _RING


class ImuBias:
    """What is known of one vehicle's b; mutable, one row of numbers."""

    __slots__ = ("_row",)

    def __init__(self) -> None:
        self._row = np.zeros(_ROW)
        self._row[_LAST_S] = -1.0

    @property
    def bias_frd_mps2(self) -> F64:
        """(3,) b, body axes; zero where only one of the streams is heard."""
        return self._row[_BIAS : _BIAS + 3].copy()

    def reported(self, accel_frd_mps2: Tuple3) -> None:
        """A sample without the bias."""
        _keep(self._row, *accel_frd_mps2)

    def raw(self, t_us: int, accel_frd_mps2: Tuple3) -> None:
        """A sample with it, and the vehicle's stamp; what is not finite changes nothing."""
        _compare(self._row, 1e-6 * t_us, *accel_frd_mps2)


@njit
def _keep(row: F64, x: float, y: float, z: float) -> None:
    head = int(row[_HEAD])
    place = _SAMPLES + 3 * head
    row[place], row[place + 1], row[place + 2] = x, y, z
    row[_HEAD] = (head + 1) % _RING
    row[_FILLED] = min(row[_FILLED] + 1.0, float(_RING))


@njit
def _compare(row: F64, t: float, x: float, y: float, z: float) -> None:
    if not math.isfinite(t + x + y + z):
        return
    since = 0.0 if row[_LAST_S] < 0.0 else t - row[_LAST_S]
    if row[_LAST_S] < 0.0:
        row[_LAST_S] = t
    limit = _NEAR_MPS2 + _GROWTH_MPS3 * max(since, 0.0)
    nearest, best = limit * limit, -1
    for k in range(int(row[_FILLED])):
        place = _SAMPLES + 3 * k
        a, b, c = x - row[place] - row[0], y - row[place + 1] - row[1], z - row[place + 2] - row[2]
        apart = a * a + b * b + c * c
        if apart < nearest:
            nearest, best = apart, place
    if best < 0:
        return
    share = min(max(since, 0.0) / _FOLLOW_S, 1.0)
    for i, value in enumerate((x, y, z)):
        moved = row[i] + share * (value - row[best + i] - row[i])
        row[i] = min(max(moved, -_MOST_MPS2), _MOST_MPS2)
    row[_LAST_S] = t
