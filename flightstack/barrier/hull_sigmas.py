"""How many deviations the queries of one axis need for all of them to lie in their nodes' intervals together.

What a certificate counts on is a node's interval, the hull of mean -+ (k sigma + rest) over its queries.  Most queries
lie well inside: with t_j >= k deviations from the mean of query j to the hull's edge, the chance that any of them lies
outside is at most the sum of Q(t_j) over queries and sides, Q the upper tail of the standard normal distribution,
however they are correlated (the union bound of the very events that count).  k is the least for which that sum is what
the union over single bounds would give them, 2 Q(k_union) each.  A side that what is known before take-off bounds by
itself cannot fail.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.jit import njit, njit_called
from flightstack.types import F64

LEAST = 2.0
_HALVINGS = 12
_SHARE = 0.999
"""Of the chance, what is spent: who checks it computes in another way."""
_ROUNDED_MPS2 = 1e-9
"""Where a hull ends at what is sure, its shift there and back leaves it some 1e-16 beside: that is no failure."""
_ROOT_HALF = math.sqrt(0.5)


class Sides(NamedTuple):
    """The queries of an axis, (groups, queries): those of a group share one interval."""

    low: F64
    """Mean less rest."""
    high: F64
    """Mean and rest."""
    sigma: F64
    sure_low: F64
    """What is known without data; -inf where nothing is."""
    sure_high: F64
    below: F64
    """Added to the low side of each interval."""
    above: F64

    def at(self, k: float) -> tuple[F64, F64]:
        """Each query's interval: mean -+ k sigma cut with what is sure; where they are apart, their hull."""
        low, high = _intervals(self.grouped(1), k)
        return low.reshape(self.sigma.shape), high.reshape(self.sigma.shape)

    def grouped(self, groups: int) -> Sides:
        """The same queries in so many groups, one after the other."""
        return Sides(*(np.ascontiguousarray(part, np.float64).reshape(groups, -1) for part in self))

    def outside(self, k: float) -> float:
        """Most of the chance that any query lies outside its group's hull."""
        return float(_outside(self.grouped(len(self.sigma)), k))


@njit_called
def _intervals(sides: Sides, k: float) -> tuple[F64, F64]:
    groups, each = sides.sigma.shape
    low, high = np.empty((groups, each)), np.empty((groups, each))
    for i in range(groups):
        for j in range(each):
            least, most = sides.low[i, j] - k * sides.sigma[i, j], sides.high[i, j] + k * sides.sigma[i, j]
            sure_low, sure_high = sides.sure_low[i, j], sides.sure_high[i, j]
            apart = max(least, sure_low) > min(most, sure_high)
            low[i, j] = min(least, sure_low) if apart else max(least, sure_low)
            high[i, j] = max(most, sure_high) if apart else min(most, sure_high)
    return low, high


@njit_called
def _outside(sides: Sides, k: float) -> float:
    low, high = _intervals(sides, k)
    total = 0.0
    for i in range(low.shape[0]):
        least, most = np.inf, -np.inf
        for j in range(low.shape[1]):
            least, most = min(least, low[i, j] + sides.below[i, j]), max(most, high[i, j] + sides.above[i, j])
        for j in range(low.shape[1]):
            under, over = least - sides.below[i, j], most - sides.above[i, j]
            if sides.sure_low[i, j] < under - _ROUNDED_MPS2:
                total += _tail((sides.low[i, j] - under) / sides.sigma[i, j])
            if sides.sure_high[i, j] > over + _ROUNDED_MPS2:
                total += _tail((over - sides.high[i, j]) / sides.sigma[i, j])
    return total


@njit
def _tail(t: float) -> float:
    """Q, the upper tail of the standard normal distribution."""
    return 0.5 * math.erfc(t * _ROOT_HALF)


def sigmas(sides: Sides, union: float) -> float:
    """The least k; `union`, that of the union over all single bounds, is always enough."""
    sides = sides.grouped(len(sides.sigma))
    allowed = _SHARE * 2.0 * _tail(union) * sides.sigma.size
    low, high = LEAST, union
    if not (union > LEAST and sides.sigma.min() > 0.0):
        return union
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _outside(sides, middle) > allowed else (low, middle)
    return high
