"""Figures of many flights: medians over seeds, paired ratios, shares of the excess removed, pooled coverage."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.learning_cases import BASELINES, FIXED
from flightstack.types import F64

Row = dict[str, Any]
DEMANDED = 0.40
"""Share of a baseline's excess over the floor that learning must remove."""
CLEAR = 1.02
"""Over the floor: below it a baseline counts as being at the floor."""
_RESAMPLES = 10_000
_SEED = 2018


@dataclass(frozen=True, slots=True)
class Interval:
    """A median over seeds with its 95 % interval (percentile bootstrap)."""

    median: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Shares:
    """How much of what the best baseline leaves over the floor learning removes."""

    best: str
    """The baseline with the least median error."""
    floor_m: float
    best_m: float
    learning_m: float
    removed: Interval
    beyond_m: Interval
    """How far learning's error lies beyond the baseline's less DEMANDED of its excess, seed by seed: kept where not."""

    @property
    def clear(self) -> bool:
        """The baseline leaves enough over the floor for a share of it to mean something."""
        return self.best_m > CLEAR * self.floor_m


@dataclass(frozen=True, slots=True)
class Covered:
    """Shares of ticks within three sigma, pooled over flights."""

    ticks: int
    pairs: float
    """Of all pairs of tick and axis."""
    axes: tuple[float, float, float]
    simultaneous: float


def of(rows: Iterable[Row], case: str, pilot: str) -> list[Row]:
    """The flights of one pilot in one case, by seed."""
    return sorted((r for r in rows if r["case"] == case and r["pilot"] == pilot), key=lambda r: int(r["seed"]))


def values(rows: Sequence[Row], key: str = "rmse_settled_m") -> F64:
    """One figure of each flight; a flight that did not complete counts as infinitely bad."""
    return np.array([r[key] if r["completed"] and r[key] is not None else np.inf for r in rows], dtype=np.float64)


def median(rows: Sequence[Row], key: str = "rmse_settled_m") -> float:
    """Over the flights; NaN without one."""
    return float(np.median(values(rows, key))) if rows else float("nan")


def interval(samples: F64) -> Interval:
    """Median and its 95 % interval over seeds."""
    samples = np.asarray(samples, dtype=np.float64)
    draws = np.random.default_rng(_SEED).integers(0, len(samples), (_RESAMPLES, len(samples)))
    low, high = np.quantile(np.median(samples[draws], axis=1), [0.025, 0.975], method="nearest")
    return Interval(float(np.median(samples)), float(low), float(high))


def paired(rows: Sequence[Row], case: str, pilot: str, other: str, key: str = "rmse_settled_m") -> Interval | None:
    """Ratio pilot / other, seed by seed; None where they don't share seeds."""
    mine, theirs = ({r["seed"]: r for r in of(rows, case, name)} for name in (pilot, other))
    seeds = sorted(mine.keys() & theirs.keys())
    if not seeds:
        return None
    return interval(values([mine[s] for s in seeds], key) / values([theirs[s] for s in seeds], key))


def best_baseline(rows: Sequence[Row], case: str, among: Sequence[str] = BASELINES) -> str | None:
    """The one with the least median error in this case; None where none flew."""
    flown = [name for name in among if of(rows, case, name)]
    return min(flown, key=lambda name: median(of(rows, case, name))) if flown else None


def shares(rows: Sequence[Row], case: str, among: Sequence[str] = FIXED) -> Shares | None:
    """Against the best of these baselines; None where somebody did not fly."""
    best = best_baseline(rows, case, among)
    if best is None or not of(rows, case, "exact") or not of(rows, case, "learning"):
        return None
    by_seed = [{r["seed"]: r for r in of(rows, case, name)} for name in (best, "exact", "learning")]
    seeds = sorted(set.intersection(*(set(pilot) for pilot in by_seed)))
    left, floor, learning = (values([pilot[s] for s in seeds]) for pilot in by_seed)
    with np.errstate(divide="ignore", invalid="ignore"):
        removed = interval(np.nan_to_num((left - learning) / (left - floor)))
    beyond = interval(learning - (left - DEMANDED * (left - floor)))
    return Shares(
        best, float(np.median(floor)), float(np.median(left)), float(np.median(learning)), removed, beyond
    )  # fmt: skip


def covered(rows: Iterable[Row]) -> Covered | None:
    """Pooled over these flights; None where none knew the truth and a bound."""
    counts = [r["covered"] for r in rows if r.get("covered") and r["covered"]["ticks"]]
    ticks = sum(c["ticks"] for c in counts)
    if not ticks:
        return None
    axes = np.sum([c["axes"] for c in counts], axis=0) / ticks
    north, east, down = axes.tolist()
    return Covered(ticks, float(axes.mean()), (north, east, down), sum(c["all"] for c in counts) / ticks)


def trace(rows: Sequence[Row]) -> dict[str, Any]:
    """Least, median and greatest error over the flights, m, every tenth of a second from `from_s` of the track on."""
    from_s = max(float(r["trace_from_s"]) for r in rows)
    cut = [r["trace_m"][round(10.0 * (from_s - r["trace_from_s"])) :] for r in rows]
    shortest = min(len(part) for part in cut)
    table = np.array([part[:shortest] for part in cut])
    ends = {"least_m": table.min(axis=0), "median_m": np.median(table, axis=0), "greatest_m": table.max(axis=0)}
    return {"from_s": from_s} | {name: part.round(4).tolist() for name, part in ends.items()}
