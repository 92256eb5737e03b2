"""Which points to hold: the one that tells least about a place, and a set that tells most about a region.

A tracking set follows the vehicle: `least_relevant` names the point to let go.  A certificate set stays: `spread`
chooses it from all that was seen.  Kept apart, what the first forgets the second still knows.
"""

from __future__ import annotations

import numpy as np

from flightstack.gp.recursive import RecursiveGP
from flightstack.types import F64, I64, InputError


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


def spread(points: F64, count: int) -> I64:
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
    choice = Spread(points, count)
    while choice.carry_on():
        pass
    return choice.chosen()


class Spread:
    """`spread` in small steps, for points that stay as they are meanwhile: `carry_on` until it says False."""

    __slots__ = ("_count", "_directions", "_each", "_ends", "_z")

    def __init__(self, points: F64, count: int) -> None:
        scale = points.std(axis=0)
        moving = scale > 1e-9 * (1.0 + np.abs(points).max(axis=0))
        self._z = (points[:, moving] - points[:, moving].mean(axis=0)) / scale[moving]
        self._count = count
        inputs = self._z.shape[1]
        pairs = [(i, j, sign) for i in range(inputs) for j in range(i) for sign in (1.0, -1.0)]
        self._directions = [*((i, i, 0.0) for i in range(inputs)), *pairs]
        """One input plus so many times another one."""
        self._each = 3 * count // (5 * 2 * max(len(self._directions), 1))
        self._ends: list[I64] = []

    def carry_on(self) -> bool:
        """The extremes of one more direction; whether there was one."""
        if len(self._ends) == len(self._directions):
            return False
        i, j, sign = self._directions[len(self._ends)]
        along = self._z[:, i] + sign * self._z[:, j]
        order = np.argpartition(along, (self._each, len(along) - self._each - 1))
        self._ends.append(np.concatenate([order[: self._each], order[len(along) - self._each :]]))
        return True

    def chosen(self) -> I64:
        """The indices, in order."""
        size = len(self._z)
        chosen = np.unique(np.concatenate(self._ends)) if self._ends else np.arange(0)
        rest = np.setdiff1d(np.arange(size), chosen)
        evenly = np.round(np.linspace(0, len(rest) - 1, self._count - len(chosen))).astype(np.int64)
        return np.sort(np.concatenate([chosen, rest[evenly]]))


def _some(gp: RecursiveGP) -> None:
    if len(gp) == 0:
        raise InputError("relevance: no point is held; add one first")
