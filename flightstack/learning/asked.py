"""Thrust that a reference asks for, and thrust that answers errors of the estimate.

The learner regresses a target on thrust, and thrust is feedback, too: an error of the velocity changes it, and the same
error is in the target (by drag that is taken for another than it is, and by the noise that accelerometer and velocity
share).  A regression takes that for a smaller gain of thrust.  What the reference asks for answers nothing: it is the
instrument of an instrumental-variable regression (J. M. Wooldridge, Econometric Analysis of Cross Section and Panel
Data, 2nd ed. 2010, chapter 5).  Asked for is

    level * size of (gravity - acceleration of the reference - drag - what is learned), lagged as the rotors are

with the ratio of thrust and this, both as means over ten seconds, as level: mass and gain are in it.
"""

from __future__ import annotations

import math

from flightstack.jit import njit
from flightstack.types import F64

_MEAN_S = 10.0
"""Longer than an estimator's errors last."""

# The row: asked for now, weights; lagged; means of the lagged and of the applied; over how long.
NOW, _LAGGED, _MEAN, _APPLIED, SEEN_S = range(5)
ROW = 5


@njit
def apart(row: F64, applied: float, dt: float, lag_s: float) -> float:
    """Applied thrust less what is asked for after another `dt`, weights; 0 where no reference asks for any."""
    if row[NOW] <= 0.0:
        return 0.0
    keep = math.exp(-dt / lag_s) if row[SEEN_S] > 0.0 else 0.0
    row[_LAGGED] = row[NOW] + keep * (row[_LAGGED] - row[NOW])
    row[SEEN_S] = min(row[SEEN_S] + dt, _MEAN_S)
    share = dt / row[SEEN_S]
    row[_MEAN] += share * (row[_LAGGED] - row[_MEAN])
    row[_APPLIED] += share * (applied - row[_APPLIED])
    return float(applied - row[_LAGGED] * row[_APPLIED] / row[_MEAN])
