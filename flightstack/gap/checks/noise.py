"""White noise of a signal out of its own samples."""

from __future__ import annotations

import numpy as np

from flightstack.types import F64

_THIRD = float(np.sqrt(20.0))
"""Standard deviation of the third difference of unit white noise: 1 + 9 + 9 + 1 = 20."""
_MAD = 1.4826
_STRIDES = 6
_STRAIGHT, _OFTEN = 1e-3, 0.2
"""A third difference this small against the rms is a straight line; so many of them are no accident."""


def white_noise(values: F64) -> F64:
    """(k,) standard deviation of the white noise on the columns of `values` (N, k).

    From third differences, which leave next to nothing of a smooth motion, by their median absolute value, which a few
    knocks don't move.  Rows filled in by straight lines have next to none; then every second, third
    ... row is taken.  NaN with less than 20 rows.
    """
    columns = values.reshape(len(values), -1)
    columns = columns[np.isfinite(columns).all(axis=1)]
    out = np.full(columns.shape[1], np.nan)
    for stride in range(1, _STRIDES + 1):
        third = np.diff(columns[::stride], n=3, axis=0)
        if len(third) < 20:
            break
        each = np.abs(third)
        out = _MAD * np.median(each, axis=0) / _THIRD
        straight = np.mean(each < _STRAIGHT * np.sqrt(np.mean(third * third, axis=0)), axis=0)
        if straight.max() < _OFTEN:
            break
    return out
