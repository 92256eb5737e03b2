"""What an effect of the file costs where all its parameters are off by one factor: that factor, and no choice.

That a size of the file is off in proportion is the least that can be wrong with a model.  A drag of another day or
another frame is one coefficient, not three, and need not be chosen among all candidates first.  Beside each candidate
that the file has stands one more, of a single column: its columns times their values in the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.chances import chi2_limit
from flightstack.gap.decisions import NAME_P
from flightstack.gap.naming.candidates import has, members
from flightstack.gap.naming.design import Linearised
from flightstack.gap.naming.evidence import Gram, Subset, fit_subsets, score
from flightstack.types import F64
from flightstack.vehicle import Vehicle


@dataclass(frozen=True, slots=True, eq=False)
class Priced:
    """The evidence at one point with a single factor on each effect of the file as a further candidate."""

    gram: Gram
    columns: list[NDArray[np.int64]]
    low: F64
    high: F64
    factor: Mapping[int, int]
    """Candidate of the file -> the candidate that is its factor."""
    count: int
    """Candidates without the factors."""

    @property
    def least_gain(self) -> float:
        """How far chi-square must fall for a factor to be a name: by chance one of them gains as much with NAME_P."""
        return chi2_limit(1, NAME_P / max(len(self.factor), 1))

    @property
    def factor_price(self) -> float:
        """Of one factor in a score."""
        return float(np.log(max(self.gram.rows, 2.0)))

    def ways(self, subset: Sequence[int]) -> Iterator[tuple[int, ...]]:
        """The subset with factors in place of what the file has, of some or of all."""
        found = product(*((m, self.factor[m]) if m in self.factor else (m,) for m in subset))
        next(found)  # itself
        return found

    def price(self, fitted: Subset) -> float:
        """What its score has beside chi-square at nothing; infinite where a member has no coefficient left."""
        names = sum(m < self.count for m in fitted.members)
        return float(score(fitted.gain, fitted.used, names, self.gram.rows, self.count))

    def least(self, subsets: Sequence[tuple[int, ...]]) -> list[float]:
        """The least price of each subset with factors; infinite where the file has none of it."""
        ways = [(i, way) for i, subset in enumerate(subsets) for way in self.ways(subset)]
        found = fit_subsets(self.gram, [way for _, way in ways], self.columns, self.low, self.high)
        least = [np.inf] * len(subsets)
        for (i, _), fitted in zip(ways, found, strict=True):
            least[i] = min(least[i], self.price(fitted))
        return least


def priced(point: Linearised, start: Vehicle) -> Priced:
    """At one design; `start` is the vehicle as its file has it."""
    if "priced" not in point._known:
        point._known["priced"] = _priced(point, start)
    found: Priced = point._known["priced"]
    return found


def _priced(point: Linearised, start: Vehicle) -> Priced:
    gram, columns, low, high = point.gram(), list(point.columns), point.low, point.high
    known = [m for m, c in enumerate(point.candidates) if has(start, c.effect) and len(columns[m])]
    x, factor = np.eye(len(gram.b)), dict[int, int]()
    for m in known:
        own = columns[m]
        origin = np.array([point.slots[i].origin for i in own])
        along = np.zeros(len(gram.b))
        along[own] = origin
        moved = origin != 0.0
        ends = np.sort(np.stack([low[own], high[own]])[:, moved] / origin[moved], axis=0)
        factor[m] = len(columns)
        columns.append(np.array([x.shape[1]]))
        x = np.column_stack([x, along])
        low, high = np.append(low, ends[0].max()), np.append(high, ends[1].min())
    return Priced(
        Gram(x.T @ gram.k @ x, x.T @ gram.b, gram.c, gram.rows), columns, low, high, factor, len(point.candidates)
    )


def spared(point: Linearised, start: Vehicle, effects: Mapping[str, Mapping[str, float]]) -> float:
    """How much less these effects cost where one factor does for what the file has of them; by columns as they are."""
    if not any(has(start, effect) for effect in effects):
        return 0.0
    at = priced(point, start)
    subset = members(point.candidates, effects)
    whole = at.price(fit_subsets(at.gram, [subset], at.columns, at.low, at.high)[0])
    least = at.least([subset])[0]
    return max(whole - least, 0.0) if np.isfinite(whole) else 0.0


def in_proportion(point: Linearised, start: Vehicle, effects: Mapping[str, Mapping[str, float]], effect: str) -> float:
    """Evidence of one factor on an effect of the file beside these effects (less itself); -inf: not in the file."""
    if not has(start, effect):
        return -np.inf
    at = priced(point, start)
    base = tuple(m for m in members(point.candidates, effects) if point.candidates[m].effect != effect)
    own = [at.factor[m] for m, c in enumerate(point.candidates) if c.effect == effect and m in at.factor]
    if not own:
        return -np.inf
    less, more = fit_subsets(at.gram, [base, (*base, own[0])], at.columns, at.low, at.high)
    return more.gain - less.gain - at.factor_price
