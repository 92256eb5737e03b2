"""How many deviations the queries of one axis need for all of them to lie in their nodes' intervals together.

What a certificate counts on is a node's interval, the hull of mean -+ (k sigma + rest) over its queries.  Most queries
lie well inside: with t_j >= k deviations from the mean of query j to the hull's edge, the chance that any of them lies
outside is at most the sum of Q(t_j) over queries and sides, Q the upper tail of the standard normal distribution,
however they are correlated (the union bound of the very events that count).  k is the least for which that sum is what
the union over single bounds would give them, 2 Q(k_union) each.  A side that what is known before take-off bounds by
itself cannot fail.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from flightstack.types import F64

LEAST = 2.0
_HALVINGS = 12
_SHARE = 0.999
"""Of the chance, what is spent: who checks it computes in another way."""
_ROUNDED_MPS2 = 1e-9
"""Where a hull ends at what is sure, its shift there and back leaves it some 1e-16 beside: that is no failure."""


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
        low, high = self.low - k * self.sigma, self.high + k * self.sigma
        apart = np.maximum(low, self.sure_low) > np.minimum(high, self.sure_high)
        return (
            np.where(apart, np.minimum(low, self.sure_low), np.maximum(low, self.sure_low)),
            np.where(apart, np.maximum(high, self.sure_high), np.minimum(high, self.sure_high)),
        )

    def outside(self, k: float) -> float:
        """Most of the chance that any query lies outside its group's hull."""
        low, high = self.at(k)
        least = (low + self.below).min(axis=1, keepdims=True) - self.below
        most = (high + self.above).max(axis=1, keepdims=True) - self.above
        under = np.where(self.sure_low >= least - _ROUNDED_MPS2, 0.0, ndtr((least - self.low) / self.sigma))
        over = np.where(self.sure_high <= most + _ROUNDED_MPS2, 0.0, ndtr((self.high - most) / self.sigma))
        return float(under.sum() + over.sum())


def sigmas(sides: Sides, union: float) -> float:
    """The least k; `union`, that of the union over all single bounds, is always enough."""
    allowed = _SHARE * 2.0 * float(ndtr(-union)) * sides.sigma.size
    low, high = LEAST, union
    if not (union > LEAST and sides.sigma.min() > 0.0):
        return union
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if sides.outside(middle) > allowed else (low, middle)
    return high
