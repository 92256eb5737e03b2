"""What of a search's best fit may be named: significant, of some size, and better on held-out data.

A battery's sag is none where a thrust that only drifts with time explains the flights better.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap.chances import chi2_tail
from flightstack.gap.classes import alternatives, splitting_manoeuvre
from flightstack.gap.decisions import ALIKE_EVIDENCE, CLEAR_EVIDENCE, LEAST_SIZES, NAME_EVIDENCE, NAME_P
from flightstack.gap.naming.candidates import members, negligible, plausible, trifle
from flightstack.gap.naming.estimate import CI, Estimates, estimate, parameter_change
from flightstack.gap.naming.evidence import fit_subsets
from flightstack.gap.naming.in_file import joined
from flightstack.gap.naming.one_scale import by_one_scale
from flightstack.gap.naming.proportion import in_proportion, priced
from flightstack.gap.naming.search import Fit, SelectionState, effects_at_bound, judged_fit, move_to
from flightstack.gap.records import Estimate, IdentifiedEffect
from flightstack.gap.simulate import FreeParameter, value
from flightstack.types import F64


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """The names of a fit, strongest first, and how constant each effect is (p-value)."""

    found: tuple[IdentifiedEffect, ...]
    estimates: Estimates
    constant: Mapping[str, float]


def _chi2_decrease(state: SelectionState, effects: Mapping[str, Mapping[str, float]], gone: str) -> float:
    """How far chi-square falls by one of the effects, the others fitted again, on the columns at the best."""
    point = state.point
    whole = members(point.candidates, effects)
    less = tuple(m for m in whole if point.candidates[m].effect != gone)
    gains = [s.gain for s in fit_subsets(point.gram(), [whole, less], point.columns, point.low, point.high)]
    most, least = (gain if np.isfinite(gain) else 0.0 for gain in gains)
    return float(most - least)


def pruned(state: SelectionState) -> Fit:
    """The fit that is judged: the best, pruned, and one thrust for several effects of the file that are off alike."""
    best = _pruned(state)
    fewer = by_one_scale(state, best)
    return best if fewer is None else _if_all_stay(state, fewer) or best


def _pruned(state: SelectionState) -> Fit:
    """The best fit, less the members whose own evidence is too thin or whose size is trifling.

    Evidence is told by columns taken at the best fit itself: far from there they promise the wrong thing.
    """
    key = state.best_key
    if state.fits[key].vehicle is not state.point.vehicle:
        move_to(state, state.fits[key].vehicle)
    best = _without_the_thin(state, state.fits[key])
    if len(best.effects) < len(key):
        best = _as_good_and_whole(state, key) or best
    fuller = joined(state, best)
    kept = None if fuller is best else _if_all_stay(state, fuller)
    return best if kept is None else kept


def _as_good_and_whole(state: SelectionState, best_key: frozenset[str]) -> Fit | None:
    """Of other fits as good as the best and of as many names, the first of which all stay; None where there is none.

    Mass and inertia both a third too large are a thrust too small beside an inertia that is hardly off, which is too
    thin to be named: the thrust alone would then stand for both.  Which of the two fits is the better is chance.
    """
    most = state.fits[best_key].score + ALIKE_EVIDENCE
    others = [(k, f) for k, f in state.fits.items() if k != best_key and len(k) == len(best_key) and f.score < most]
    for _, fit in sorted(others, key=lambda other: other[1].score):
        if state.excluded & set(fit.effects) or effects_at_bound(state.start, fit, state.rope_most_m):
            continue
        whole = _if_all_stay(state, fit)
        if whole is not None:
            return whole
    return None


def _if_all_stay(state: SelectionState, fit: Fit) -> Fit | None:
    """The fit by columns taken at itself; None, and the state as it was, where one of its members is too thin."""
    before = replace(state, fits=dict(state.fits))
    move_to(state, fit.vehicle)
    whole = judged_fit(state, fit.effects, fit.vehicle, state.point.rest, fit.used)
    if _without_the_thin(state, whole) is whole:
        return whole
    state.point, state.metric, state.fits, state.rope_m = before.point, before.metric, before.fits, before.rope_m
    return None


def _without_the_thin(state: SelectionState, best: Fit) -> Fit:
    while best.effects:
        weakest, drop = "", np.inf
        for effect in best.effects:
            fall = evidence(state, best, effect)
            if _size(state, best, effect) < LEAST_SIZES:
                fall = min(fall, 0.0)
            if fall < drop:
                weakest, drop = effect, fall
        if drop >= state.margin:
            return best
        rest_of = frozenset(best.effects) - {weakest}
        same = [f for f in state.fits.values() if frozenset(f.effects) == rest_of]
        best = min([*same, _refit(state, best, weakest)], key=lambda f: f.chi2)
    return best


def evidence(state: SelectionState, best: Fit, effect: str) -> float:
    """By how much the score would rise without the effect.

    Of one of the file at least what one factor on it says: as far beyond a name's evidence as beyond its own least.
    """
    at = priced(state.point, state.start)
    own = in_proportion(state.point, state.start, best.effects, effect)
    return max(_evidence_in_full(state, best, effect), state.margin + own + at.factor_price - at.least_gain)


def _evidence_in_full(state: SelectionState, best: Fit, effect: str) -> float:
    used = len(best.effects[effect])
    price = used * np.log(max(float(state.metric.rows.sum()), 2.0)) + 2.0 * np.log(len(state.point.candidates))
    return _chi2_decrease(state, best.effects, effect) - float(price)


def _refit(state: SelectionState, best: Fit, gone: str) -> Fit:
    left = {e: v for e, v in best.effects.items() if e != gone}
    made = estimate(state, left)
    effects = {e: dict(made.vehicle.effects[e]) for e in left}
    return judged_fit(state, effects, made.vehicle, made.rows, len(made.slots))


def _size(state: SelectionState, best: Fit, effect: str) -> float:
    """The effect's largest change in negligible sizes."""
    sizes = []
    share = trifle(effect, state.bench.trifles)
    for spec in EFFECTS[effect].params:
        origin = value(state.start, effect, spec.name)
        if not spec.integer and not spec.required and np.isfinite(origin):
            change = abs(best.effects[effect][spec.name] - origin)
            sizes.append(change / (share * negligible(best.vehicle, effect, spec.name)))
    return max(sizes, default=0.0)


def judge(state: SelectionState, best: Fit) -> Judged:
    """Which effects of this fit may be named, with all that is known of them."""
    made = estimate(state, best.effects)
    if not best.effects:
        return Judged((), made, {})
    found = []
    for effect in best.effects:
        fall = evidence(state, best, effect)
        p_value = _p_value(state, best, effect)
        others = alternatives(state, best, effect)
        held = gain(state, made, effect)
        if p_value > NAME_P or held <= 0.0:
            continue
        found.append(
            (
                fall,
                IdentifiedEffect(
                    effect,
                    parameters_of(state, made, effect),
                    -fall,
                    held,
                    p_value,
                    others,
                    splitting_manoeuvre((effect, *others)) if others else "",
                ),
            )
        )
    if len(found) < len(best.effects):
        left = {f.name: best.effects[f.name] for _, f in found}
        made = estimate(state, left)
    found.sort(key=lambda item: -item[0])
    constant: dict[str, float] = {}
    for (effect, _), p in zip(made.slots, made.spread, strict=True):
        constant[effect] = min(constant.get(effect, 1.0), float(p))
    return Judged(tuple(f for _, f in found), made, constant)


def _p_value(state: SelectionState, best: Fit, effect: str) -> float:
    """Likelihood ratio of the effect against trifles of all others, by chance one of all effects.

    Of one of the file at most that of one factor, by chance one of those that the file has.
    """
    fall = _chi2_decrease(state, best.effects, effect)
    in_full = chi2_tail(max(len(best.effects[effect]), 1), fall) * len(EFFECTS)
    at = priced(state.point, state.start)
    own = in_proportion(state.point, state.start, best.effects, effect) + at.factor_price
    return min(in_full, chi2_tail(1, own) * len(at.factor) if own > 0.0 else np.inf)


def parameters_of(state: SelectionState, made: Estimates, effect: str) -> dict[str, Estimate]:
    """An effect's parameters with their intervals; what the fit left as it was is not told."""
    found: dict[str, Estimate] = {}
    for spec in EFFECTS[effect].params:
        before = value(state.start, effect, spec.name)
        now = value(made.vehicle, effect, spec.name)
        if spec.integer:
            found[spec.name] = Estimate(before, now, now, now)
            continue
        low, high = plausible(state.start, effect, spec.name)
        if (effect, spec.name) not in made.slots:
            found[spec.name] = Estimate(before, now, low, high, told=False)
            continue
        i = made.slots.index((effect, spec.name))
        reach = CI * float(np.sqrt(max(made.covariance[i, i], 0.0)))
        if reach > 0.0:
            low, high = max(now - reach, low), min(now + reach, high)
        found[spec.name] = Estimate(before, now, min(low, now), max(high, now))
    return found


def gain(state: SelectionState, made: Estimates, effect: str) -> float:
    """Share of the explainable held-out gap that falls when the effect joins the others: 0 or less where it does harm.

    NaN where held-out rows hardly hold it (a low pass that only the learned part has): they can't speak for or against.
    """
    layout = state.point.layout
    held = layout.keep & layout.held
    mine = [i for i, (e, _) in enumerate(made.slots) if e == effect]
    own = made.x[held][:, mine] @ parameter_change(state, made)[mine]
    if float(own @ own) < CLEAR_EVIDENCE:
        return float("nan")
    before, after = layout.stack(state.bench.residual(state.start))[held], made.rows[held]
    whole = float(before @ before) - float(after @ after)
    lost = float((after + own) @ (after + own)) - float(after @ after)
    return lost / max(whole + 1e-9, lost, 1e-9)


def better_as_drift(state: SelectionState, made: Estimates) -> tuple[str, ...]:
    """The battery's sag, and what leans on it, where a thrust that only drifts with time explains the flights better.

    A sag that a drift passes for may have brought a curve and a payload with it to bend the voltage's way into the
    drift's, so each of the other names may go with it.  What beside the drift has no name's evidence leans on the sag.
    """
    layout = state.point.layout
    thrust = state.bench.columns(made.vehicle, [FreeParameter("thrust_scale", "scale")])
    drift = layout.stack(
        [np.concatenate([np.nan_to_num(x), _along(len(x)) * np.nan_to_num(x)], axis=2) for x in thrust]
    )
    without = made.rows + made.x @ parameter_change(state, made)
    k, b = state.metric.normal(np.hstack([drift, made.x]), without)
    whole = state.metric.chi2(without)
    price = np.log(max(float(state.metric.rows.sum()), 2.0))
    others = [name for name in dict.fromkeys(effect for effect, _ in made.slots) if name != "battery_sag"]

    def score(away: set[str]) -> float:
        used = [0, 1] + [2 + i for i, (effect, _) in enumerate(made.slots) if effect not in away]
        explained = float(b[used] @ np.linalg.lstsq(k[np.ix_(used, used)], b[used], rcond=1e-10)[0])
        return float(whole - explained + price * len(used))

    tried = [{"battery_sag", *leaning} for size in range(len(others) + 1) for leaning in combinations(others, size)]
    gone = min(tried, key=score)
    if score(gone) >= state.metric.chi2(made.rows) + price * len(made.slots):
        return ()
    chances = NAME_EVIDENCE + 2.0 * np.log(len(state.point.candidates))
    while thin := [name for name in others if name not in gone and score(gone | {name}) - score(gone) < chances]:
        gone = gone | {min(thin, key=lambda name: score(gone | {name}))}
    return tuple(sorted(gone))


def _along(count: int) -> F64:
    """(N, 1, 1) from -1 to 1 along a flight."""
    return np.linspace(-1.0, 1.0, count)[:, None, None]
