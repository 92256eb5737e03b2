"""A wind that is another one from some moment on, as a rival of gusts.

A wind that begins in mid-flight correlates over all that comes after it, as gusts of a great length do; what tells the
two apart is that on either side of the moment it is the same wind.  Its law has few columns (drag before, drag after,
and in every block while it changes), so that its likelihood costs next to nothing beside that of gusts.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flightstack.types import F64

_MOMENTS = 48
"""Into how many spans the flights are cut, in each of which the wind may change."""
_MOST_STEPS = 2
"""A wind that begins and ends."""


def stepping_wind(y: F64, beside: F64, drag: F64, flight: NDArray[np.int64], t_s: F64, ratios: F64) -> float:
    """Log likelihood ratio against noise of the best wind with one or two steps, less what the choice is worth.

    y (3 B,), the columns beside it (3 B, K) and drag (B, 3, wind axis) in units of the noise; flight and time of each
    block; ratios (R,) of variances.  The likelihood is `gap.gusts`' own.
    """
    columns, best = drag.reshape(len(y), -1), -np.inf
    edges = np.unique(np.linspace(0, len(t_s), _MOMENTS + 1).astype(int))
    for step in range(1, _MOST_STEPS + 1):
        tried = []
        for first, end in pairwise(edges[1:-1]):
            after = (flight == flight[first]) & (t_s >= t_s[first])
            after[first:end] = False
            own = np.eye(len(t_s), dtype=bool)[first:end]  # while it changes, each block has a wind of its own
            blown = [(drag * rows[:, None, None]).reshape(len(y), -1) for rows in (*own, after)]
            made = np.hstack([columns, *blown])
            tried.append((_likelihood(y, beside, made, ratios), made))
        gain, columns = max(tried, key=lambda each: each[0], default=(-np.inf, columns))
        best = max(best, gain - step * np.log(_MOMENTS))
    return float(best)


def _likelihood(y: F64, x: F64, z: F64, ratios: F64) -> float:
    """The greatest restricted log likelihood ratio of I + r z z' against I, over the ratios r."""
    size = np.linalg.norm(x, axis=0)
    x = x[:, size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)]
    x = x / np.linalg.norm(x, axis=0)
    u, s, _ = np.linalg.svd(z, full_matrices=False)
    along, across = u.T @ y, u.T @ x
    r = np.concatenate([[0.0], ratios])
    grown = r[:, None] * s**2
    shrunk = grown / (1.0 + grown)
    gram = x.T @ x + 1e-12 * np.eye(x.shape[1]) - np.einsum("mi,rm,mj->rij", across, shrunk, across, optimize=True)
    seen = x.T @ y - (shrunk * along) @ across
    theta = np.einsum("rij,rj->ri", np.linalg.inv(gram + 1e-12 * np.eye(x.shape[1])), seen)
    n = len(y) - x.shape[1]
    power = y @ y - shrunk @ along**2 - np.einsum("ri,ri->r", theta, seen)
    scale = np.maximum(power, 1e-300) / n
    logs = -0.5 * (n * np.log(scale) + np.log1p(grown).sum(axis=1) + np.linalg.slogdet(gram)[1])
    return float((logs[1:] - logs[0]).max())
