"""Which points to hold: the one that tells least about a place, and a set that tells most about a region.

A tracking set follows the vehicle: `least_relevant` names the point to let go.  A certificate set stays: `spread`
chooses it from all that was seen.  Kept apart, what the first forgets the second still knows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flightstack.gp.recursive import RecursiveGP
from flightstack.types import F64, InputError


def least_relevant(gp: RecursiveGP, query: F64) -> int:
    """Index of the held point with the least |k(x, query)|, query (D,); of equals the oldest.

    The paper's rule: what the kernel calls unrelated to where the vehicle is now, is let go.  Raises InputError where
    nothing is held.
    """
    _some(gp)
    return gp.least_covariant(query)


def oldest(gp: RecursiveGP) -> int:
    """Index of the point that has been held longest; raises InputError where nothing is held."""
    _some(gp)
    return gp.oldest()


def spread(points: F64, count: int) -> NDArray[np.int64]:
    """Indices of `count` of the points (N, D), in order, that reach as far as all of them do.

    Three fifths are the extremes of every input and of every two inputs' sum and difference (each input by its
    deviation), so that what is linear in them is known in every corner where anything is; the rest lies evenly
    between.  Values are not looked at, which would bias what is learned from them.  Costs some N D^2.
    """
    if not count >= 0:
        raise InputError(f"spread: count = {count} is not allowed; it must be at least 0")
    if not np.isfinite(points).all():
        raise InputError("spread: points must be finite")
    if count >= len(points):
        return np.arange(len(points))
    scale = points.std(axis=0)
    moving = scale > 1e-9 * (1.0 + np.abs(points).max(axis=0))
    z = (points[:, moving] - points[:, moving].mean(axis=0)) / scale[moving]
    pairs = [(i, j) for i in range(z.shape[1]) for j in range(i)]
    along = [z, *(z[:, [i]] + sign * z[:, [j]] for i, j in pairs for sign in (1.0, -1.0))]
    directions = np.hstack(along)
    each = 3 * count // (5 * 2 * max(directions.shape[1], 1))
    ends = np.concatenate([np.arange(each), np.arange(len(points) - each, len(points))])
    chosen = np.unique(np.argpartition(directions, (each, len(points) - each - 1), axis=0)[ends])
    rest = np.setdiff1d(np.arange(len(points)), chosen)
    evenly = np.round(np.linspace(0, len(rest) - 1, count - len(chosen))).astype(np.int64)
    return np.sort(np.concatenate([chosen, rest[evenly]]))


def _some(gp: RecursiveGP) -> None:
    if len(gp) == 0:
        raise InputError("relevance: no point is held; add one first")
