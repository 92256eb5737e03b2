"""Whether all queries of an axis lie in their nodes' intervals with the chance that the union of single bounds has.

A query fails where its acceleration lies beyond its node's interval, Q(t) each way, t the deviations from its mean
(less or more the remainder) to the interval's end; what is known without data does not fail.  The sum over all
queries and ways bounds the chance that any does, however they go together; it must be no more than 2 Q(k) for each,
as many single bounds of k deviations would have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .intervals import F64
from .reading import Refused

_tail = np.vectorize(lambda t: 0.5 * math.erfc(t / math.sqrt(2.0)), otypes=[np.float64])
_ROUNDED = 5e-4
_TIE_MPS2 = 1e-9
"""An interval that ends at what is known without data ends there but for rounding."""


@dataclass
class Asked:
    """Queries (nodes, n) at one end of the command, all shifted as the interval is."""

    low: F64
    """The interval of each."""
    high: F64
    mean_low: F64
    """Its mean less what does not err at random."""
    mean_high: F64
    deviation: F64
    sure_low: F64
    sure_high: F64


def check_together(asked: list[Asked], lateral: bool, k_queries: float, k: float) -> None:
    """Refused where so few deviations are too few; those of the union over single bounds are enough."""
    if k_queries >= k:
        return
    groups = [Asked(*(np.hstack(both) for both in zip(*(vars(each).values() for each in asked), strict=True)))]
    chance = sum(_outside(each) for each in (groups if lateral else asked))
    allowed = math.erfc(k / math.sqrt(2.0)) * sum(each.low.size for each in asked)
    if not chance <= allowed * (1.0 + _ROUNDED):
        raise Refused(
            f"knowledge.k_queries = {k_queries:.6g}: queries fail in {chance:.3g} of cases, {allowed:.3g} is theirs"
        )


def _outside(asked: Asked) -> float:
    least, most = asked.low.min(axis=1)[:, None], asked.high.max(axis=1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        below = np.where(asked.sure_low >= least - _TIE_MPS2, 0.0, _tail((asked.mean_low - least) / asked.deviation))
        above = np.where(asked.sure_high <= most + _TIE_MPS2, 0.0, _tail((most - asked.mean_high) / asked.deviation))
    return float(below.sum() + above.sum())
