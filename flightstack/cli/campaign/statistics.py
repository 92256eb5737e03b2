"""Rates with their intervals, the worst flights, and which factor drives the failures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from flightstack.cli.campaign.outcomes import COMPLETED
from flightstack.types import F64

Entry = Mapping[str, Any]
_BINS = 8
_FEW = 12
"""So many different values or fewer are looked at one by one."""


def clopper_pearson(hits: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact two-sided interval of a share (Clopper and Pearson 1934); (0, 1) of no trials."""
    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if hits == 0 else float(stats.beta.ppf(tail, hits, trials - hits + 1))
    high = 1.0 if hits == trials else float(stats.beta.ppf(1.0 - tail, hits + 1, trials - hits))
    return low, high


def metric(entry: Entry, name: str) -> float | None:
    """A number of fly's JSON by its dotted name; None where it is missing or no finite number."""
    value: Any = entry["result"]
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    usable = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None


def worst(entries: Sequence[Entry], name: str, greatest: bool, count: int) -> list[tuple[int, float]]:
    """(flight, value) of the worst, the worst one first; ties by number."""
    found = [(entry["flight"], value) for entry in entries if (value := metric(entry, name)) is not None]
    return sorted(found, key=lambda each: (-each[1] if greatest else each[1], each[0]))[:count]


@dataclass(frozen=True, slots=True)
class Bin:
    """Flights whose factor has one value, or lies between two."""

    words: str
    flights: int
    failed: int
    ends: tuple[float, float] | None = None
    """Of a number's bin; None: one value."""

    @property
    def ci95(self) -> tuple[float, float]:
        """Of the failures' rate."""
        return clopper_pearson(self.failed, self.flights)


@dataclass(frozen=True, slots=True)
class Influence:
    """How failures depend on one factor."""

    factor: str
    effect: float
    """0 none, 1 all: |2 AUC - 1| of a number, Cramer's V of a choice."""
    p_value: float
    """Mann-Whitney or chi-squared, after Holm's correction for all factors."""
    words: str
    bins: tuple[Bin, ...]


def influences(entries: Sequence[Entry], names: Sequence[str]) -> list[Influence]:
    """Of every factor, the strongest first; empty where all flights ended alike."""
    failed = np.array([entry["outcome"] != COMPLETED for entry in entries], dtype=bool)
    if not failed.any() or failed.all():
        return []
    found = [_influence(name, [_value(entry, name) for entry in entries], failed) for name in names]
    known = [each for each in found if each is not None]
    corrected = holm([each.p_value for each in known])
    known = [
        Influence(each.factor, each.effect, p, each.words, each.bins) for each, p in zip(known, corrected, strict=True)
    ]
    return sorted(known, key=lambda each: (each.p_value, -each.effect, each.factor))


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down correction, in the given order."""
    order = sorted(range(len(p_values)), key=lambda i: p_values[i])
    corrected, highest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(order):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[i]))
        corrected[i] = highest
    return corrected


def _value(entry: Entry, name: str) -> Any:
    return entry["scenario"] if name == "scenario" else entry["values"].get(name)


def _influence(name: str, values: list[Any], failed: np.ndarray) -> Influence | None:
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    distinct = sorted(set(map(_words, values))) if not numbers else sorted(set(values))
    if len(distinct) < 2:
        return None
    if not numbers:
        labels = np.array([_words(v) for v in values])
        table = np.array([[np.sum(failed & (labels == d)), np.sum(~failed & (labels == d))] for d in distinct])
        found = stats.chi2_contingency(table, correction=False)
        v = math.sqrt(found.statistic / (len(values) * (min(table.shape) - 1)))
        bins = tuple(Bin(str(d), int(row.sum()), int(row[0])) for d, row in zip(distinct, table, strict=True))
        most = max(bins, key=lambda each: each.failed / max(each.flights, 1))
        return Influence(name, v, float(found.pvalue), f"most with {most.words}", bins)
    column = np.array(values, dtype=np.float64)
    test = stats.mannwhitneyu(column[failed], column[~failed], alternative="two-sided")
    auc = float(test.statistic) / (failed.sum() * (~failed).sum())
    side = "more at greater values" if auc > 0.5 else "more at smaller values"
    return Influence(name, abs(2.0 * auc - 1.0), float(test.pvalue), side, _bins(column, failed))


def _bins(column: F64, failed: np.ndarray) -> tuple[Bin, ...]:
    distinct = np.unique(column)
    if len(distinct) <= _FEW:
        return tuple(Bin(f"{d:g}", int((column == d).sum()), int(failed[column == d].sum())) for d in distinct)
    edges = np.unique(np.quantile(column, np.linspace(0.0, 1.0, _BINS + 1)))
    place = np.clip(np.searchsorted(edges, column, side="right") - 1, 0, len(edges) - 2)
    return tuple(
        Bin(
            f"{edges[k]:.3g} to {edges[k + 1]:.3g}",
            int((place == k).sum()),
            int(failed[place == k].sum()),
            (float(edges[k]), float(edges[k + 1])),
        )
        for k in range(len(edges) - 1)
    )


def _words(value: Any) -> str:
    return str(value)
