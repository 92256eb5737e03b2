"""Which of two measured velocities errs, told by a third: the side force that a rotorcraft feels as it moves.

Through still air a body feels a side force in proportion to its velocity (Martin, Salaun, IEEE ICRA 2010: the true role
of accelerometers).  Regressed at low frequencies on the velocity and on the slow disagreement of position and velocity,
it says by how much of that disagreement the velocity must be mended, whatever the drag is: the disagreement's
coefficient by the velocity's own.  A steady wind and what tilts the sensor have columns of their own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.decisions import TENTH
from flightstack.types import F64
from flightstack_logs.turn import rotate_inverse

BAND_HZ = 0.5
_LEAST_ROWS = 12
"""Of one axis, a row each second: a column less than half of that."""
_LASTS = 6
"""Rows, of a second each, for which slow errors last."""
_STILL_MPS = 0.01
"""A disagreement too small to matter."""


def velocity_share(
    disagreement: F64, velocity: F64, q_ned_frd: F64, force_frd: F64, rows: NDArray[np.bool_], dt_s: float
) -> tuple[float, float]:
    """The share of the level disagreement by which the velocity errs, and its standard deviation; inf if untold.

    All (N, 3) through a low-pass of `BAND_HZ`, the first two NED; `rows` are to be looked at.
    """
    at = np.flatnonzero(rows)
    at = at[:: max(1, round(0.5 / (BAND_HZ * dt_s)))]
    if len(at) < _LEAST_ROWS or np.sqrt(np.mean(disagreement[at, :2] ** 2)) < _STILL_MPS:
        return 0.0, np.inf
    q = q_ned_frd[at]
    own, other = rotate_inverse(q, velocity[at]), rotate_inverse(q, disagreement[at])
    north, east = (rotate_inverse(q, np.tile(axis, (len(at), 1))) for axis in np.eye(3)[:2])
    total, weight = 0.0, 0.0
    for axis in range(2):
        columns = (own, other, north, east)
        x = np.stack([*(each[:, axis] for each in columns), force_frd[at, 2], np.ones(len(at))], axis=1)
        y = force_frd[at, axis]
        inverse = np.linalg.pinv(x.T @ x)
        b = inverse @ (x.T @ y)
        variance = np.diag(inverse @ _lasting(x * (y - x @ b)[:, None]) @ inverse)
        if variance[0] < TENTH**2 * b[0] ** 2:
            precision = b[0] ** 2 / max(float(variance[1]), 1e-12)
            total, weight = total + precision * float(b[1] / b[0]), weight + precision
    return (total / weight, weight**-0.5) if weight > 0.0 else (0.0, np.inf)


def _lasting(scores: F64) -> F64:
    """(k, k) variance of the sum of scores (N, k) that resemble those of some seconds before (Newey, West 1987)."""
    out = scores.T @ scores
    for lag in range(1, _LASTS + 1):
        each = scores[lag:].T @ scores[:-lag]
        out += (1.0 - lag / (_LASTS + 1)) * (each + each.T)
    return np.asarray(out * len(scores) / (len(scores) - scores.shape[1]))
