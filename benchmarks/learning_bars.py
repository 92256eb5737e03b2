"""What learning must reach, held against a campaign's results: one row a bar."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.learning_cases import BASELINES, FIXED
from benchmarks.learning_stats import (
    DEMANDED,
    Interval,
    Row,
    Shares,
    best_baseline,
    covered,
    median,
    of,
    paired,
    shares,
    values,
)

RATIO_BAR = 0.10
NOTHING_BAR = 1.02
SIH_BAR_M = 0.08
COVERAGE_BAR = (0.990, 0.9995)
NOTICED_BAR_S, LEARNED_BAR_S = 0.3, 2.0
_DEMANDED_CASES = ("rotor-drag", "low-pass")
FAR_M = 4.0
"""Displacement at which the ratio of the two sets of inputs is quoted."""


@dataclass(frozen=True, slots=True)
class Bar:
    """One line of the summary."""

    what: str
    bar: str
    measured: str
    kept: bool | None
    """None: stated, not demanded."""


def spread(found: Interval, scale: float = 1.0, digits: int = 3) -> str:
    """Median and interval as text."""
    low, middle, high = (f"{scale * value:.{digits}f}" for value in (found.low, found.median, found.high))
    return f"{middle} [{low}, {high}]"


def bars(results: dict[str, Any]) -> list[Bar]:
    """Every bar for which flights were flown."""
    found: list[Bar] = []
    for make in _MAKERS:
        found += make(results)
    return found


def _tracking(results: dict[str, Any]) -> list[Bar]:
    rows = results["flights"]
    ratio = paired(rows, "paper-tracking", "learning", "none")
    if ratio is None:
        return []
    words = "paper-tracking: settled error with learning over without"
    found = [Bar(words, f"at most {RATIO_BAR:.2f}", spread(ratio), ratio.median <= RATIO_BAR)]
    best = best_baseline(rows, "paper-tracking", BASELINES)
    if best is not None and best != "none":
        against = paired(rows, "paper-tracking", "learning", best)
        assert against is not None
        words = f"paper-tracking: settled error over the best baseline's ({best})"
        kept = against.low <= 1.0 and against.median <= NOTHING_BAR
        found.append(Bar(words, "not above 1 by more than the seeds' spread", spread(against), kept))
    return found


def _excess(results: dict[str, Any]) -> list[Bar]:
    found = []
    for case in (*_DEMANDED_CASES, "steady-wind", "px4-sih"):
        for among, words in ((FIXED, "the best fixed controller"), (("state-gp",), "the paper's learner")):
            removed = shares(results["flights"], case, among)
            if removed is None:
                continue
            what = f"{case}: share removed of the excess over the floor that {words} ({removed.best}) leaves"
            demanded = case in _DEMANDED_CASES and among is FIXED
            kept = removed.beyond_m.median <= 0.0 if demanded else None
            found.append(Bar(what, f"at least {DEMANDED:.2f}" if demanded else "", removed_words(removed), kept))
    return found


def removed_words(found: Shares) -> str:
    """The share; where the baseline is at the floor there is none, and the three errors themselves say who is ahead."""
    if found.clear:
        return spread(found.removed, digits=2)
    best, floor, learning = (f"{100.0 * error:.2f}" for error in (found.best_m, found.floor_m, found.learning_m))
    return f"no excess: {best} cm, floor {floor} cm, learning {learning} cm"


def _nothing(results: dict[str, Any]) -> list[Bar]:
    found = []
    for case in ("figure8", "hover"):
        for key, words in (("rmse_m", "whole track"), ("rmse_settled_m", "settled half")):
            ratio = paired(results["flights"], case, "learning", "none", key)
            if ratio is not None:
                what = f"{case}, nothing to learn: error with learning over without, {words}"
                found.append(Bar(what, f"at most {NOTHING_BAR:.2f}", spread(ratio), ratio.median <= NOTHING_BAR))
    return found


def _sih(results: dict[str, Any]) -> list[Bar]:
    rows = of(results["flights"], "px4-sih", "learning")
    if not rows:
        return []
    errors = values(rows, "rmse_m")
    text = f"{np.median(errors):.3f} m, worst of {len(rows)} seeds {errors.max():.3f} m"
    what = "px4-sih: rms error over the whole track"
    return [Bar(what, f"at most {SIH_BAR_M:.2f} m", text, bool(errors.max() <= SIH_BAR_M))]


def _change(results: dict[str, Any]) -> list[Bar]:
    changes = [r["change"] for r in of(results["flights"], "payload-drop", "learning") if r.get("change")]
    if not changes:
        return []
    noticed, held, learned = (worst(changes, key) for key in ("noticed_s", "covered_s", "learned_s"))
    count = len(changes)
    return [
        Bar("payload dropped: noticed after", f"{NOTICED_BAR_S:g} s", _worst(noticed, count), noticed <= NOTICED_BAR_S),
        Bar("payload dropped: the bound holds the truth after", f"{NOTICED_BAR_S:g} s (with the notice)",
            _worst(held, count), held <= NOTICED_BAR_S),
        Bar("payload dropped: learned (10 % of the jump left) after", f"{LEARNED_BAR_S:g} s", _worst(learned, count),
            learned <= LEARNED_BAR_S),
    ]  # fmt: skip


def worst(changes: Sequence[Row], key: str) -> float:
    """Largest over the flights; infinite where one never came to it."""
    return max(math.inf if change[key] is None else float(change[key]) for change in changes)


def _worst(seconds: float, count: int) -> str:
    return f"{seconds:.2f} s (worst of {count})" if math.isfinite(seconds) else f"not in every one of {count} flights"


def _coverage(results: dict[str, Any]) -> list[Bar]:
    seen = covered(r for r in results["flights"] if r["pilot"] == "learning")
    if seen is None:
        return []
    low, high = COVERAGE_BAR
    bar = f"{low:.3f} to {high:.4f}"
    axes = ", ".join(f"{share:.4f}" for share in seen.axes)
    return [
        Bar("3-sigma coverage on truth, whole campaign, all axes", bar, f"{seen.pairs:.4f}", low <= seen.pairs <= high),
        Bar("the same for body x, y, z", "", axes, None),
        Bar("the same, all three axes at once", "", f"{seen.simultaneous:.4f}", None),
    ]


def _inputs(results: dict[str, Any]) -> list[Bar]:
    ratios = inputs_ratio(results["inputs"], "air", FAR_M)
    if ratios is None:
        return []
    what = f"error of prediction {FAR_M:g} m away, inputs with position over without"
    return [Bar(what, "stated", f"{np.median(ratios):.1f} times", None)]


def inputs_ratio(rows: Sequence[Row], world: str, displacement_m: float) -> list[float] | None:
    """Error of q over error of q', seed by seed; None where nothing was flown."""

    def errors(name: str) -> dict[int, float]:
        return {
            r["seed"]: r["error_mps2"]
            for r in rows
            if r["world"] == world and r["inputs"] == name and r["displacement_m"] == displacement_m
        }

    full, short = errors("q"), errors("q'")
    seeds = sorted(full.keys() & short.keys())
    return [full[s] / short[s] for s in seeds] if seeds else None


def _floor(results: dict[str, Any]) -> list[Bar]:
    ratio = paired(results["flights"], "paper-tracking", "exact", "none")
    if ratio is None or not of(results["flights"], "right-model", "none"):
        return []
    fed = median(of(results["flights"], "paper-tracking", "exact"))
    right = median(of(results["flights"], "right-model", "none"))
    text = f"{100 * fed:.2f} cm against {100 * right:.2f} cm"
    return [Bar("the floor itself: fed with the exact model against flown with a right one", "", text, None)]


_MAKERS: tuple[Callable[[dict[str, Any]], list[Bar]], ...] = (
    _tracking, _excess, _nothing, _sih, _change, _coverage, _inputs, _floor,
)  # fmt: skip
