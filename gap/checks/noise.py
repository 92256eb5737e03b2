"""White noise of a signal out of its own samples."""

from __future__ import annotations

import numpy as np

from flightstack.types import F64

_THIRD = float(np.sqrt(20.0))
"""Standard deviation of the third difference of unit white noise: 1 + 9 + 9 + 1 = 20."""
_MAD = 1.4826


def white_noise(values: F64) -> F64:
    """(k,) standard deviation of the white noise on the columns of `values` (N, k).

    From third differences, which leave next to nothing of a smooth motion, by their median absolute value, which a few
    knocks don't move; NaN with less than 20 rows.
    """
    columns = values.reshape(len(values), -1)
    third = np.diff(columns, n=3, axis=0)
    third = third[np.isfinite(third).all(axis=1)]
    if len(third) < 20:
        return np.full(columns.shape[1], np.nan)
    return np.asarray(_MAD * np.median(np.abs(third), axis=0) / _THIRD)
