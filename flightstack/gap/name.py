"""Name what is missing: the effects that explain the residuals of these flights, or none.

search (gap.naming.search)  ->  which subset explains most for its price, every one fitted in earnest
verdict (this file)         ->  what of it may be said: significant, constant, better on held-out data, not a proxy
classes (gap.classes)       ->  what else would explain the flights as well
rest (gap.rest)             ->  what is left and on what it depends; too much of it, and nothing is named
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from flightstack.effect_specs import EFFECT_SPECS
from flightstack.gap.classes import (
    POORLY_TOLD,
    alternatives,
    beside_a_poor_model,
    has_gyro,
    in_classes,
    poorly_told,
    splitting_manoeuvre,
)
from flightstack.gap.compare import residual
from flightstack.gap.held import corrected
from flightstack.gap.identify import Identifiable, identify
from flightstack.gap.locate import locate
from flightstack.gap.naming.bench import SimulatorBench, simulator_bench
from flightstack.gap.naming.candidates import negligible, plausible
from flightstack.gap.naming.drift import drifts_better
from flightstack.gap.naming.estimate import Estimates, estimate
from flightstack.gap.naming.evidence import fit_subsets
from flightstack.gap.naming.held_rows import gain, moved
from flightstack.gap.naming.joining import joined
from flightstack.gap.naming.ranged import carried, is_touched
from flightstack.gap.naming.search import LEAST_EVIDENCE, Fit, SelectionState, judged_fit, members, move_to, search
from flightstack.gap.naming.trifles import trifles
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.records import Estimate, Found, Rejected, Samples, Unexplained, Where
from flightstack.gap.remainder import Rest
from flightstack.gap.rest import beside_names, every_rest, loud, telling, unexplained
from flightstack.gap.simulate import unseen, untold, value
from flightstack.vehicle import Vehicle

_LEAST_P = 1e-4
"""After Holm's correction for all candidates."""
_LEAST_SIZES = 3.0
"""Smallest effect that is named, in negligible sizes."""
_NOT_CONSTANT_P = _LEAST_P / len(EFFECT_SPECS)
"""Of an effect's being the same everywhere: as sure as a name must be."""
_ABSTAIN_SHARE = 0.1
"""Of what can be explained, the part that depends on something else than the named effects."""
_EVERYWHERE = ("constant_force", "steady_wind")
"""Effects that no place is without: a jet of air, or another vehicle's wake, looks like one as long as one is in it."""
_ACTS_SHARE = 0.1
"""Of what can be explained in a group, the part from which an effect is taken to act there."""
_LEAST_GAIN = 0.005
"""Of the held-out gap, what a name that joins a poor model must explain: below, the page says 0 %."""
_CI = 1.959964


@dataclass(frozen=True, slots=True, eq=False)
class Naming:
    """The verdict."""

    found: tuple[Found, ...]
    """Strongest first; empty where model and flights agree, and where too much stays unexplained."""
    rejected: tuple[Rejected, ...]
    """Every other effect of the table, and why not."""
    vehicle: Vehicle
    """The vehicle with the found effects at their estimates; the given one where nothing was found."""
    unexplained: Unexplained
    where: tuple[Where, ...]
    constant: Mapping[str, float]
    """Effect -> p-value of its being the same in all stretches of the flights."""
    identifiable: tuple[Identifiable, ...] = ()
    """What these flights could have shown at all (`gap.identify`)."""
    proposed: tuple[Found, ...] = ()
    """All that the search found, also what was taken back since as something that depends on more."""
    _behind: tuple[SimulatorBench, SelectionState] | None = None
    """For `without`."""

    def trifles(self) -> tuple[str, ...]:
        """Of its names, those that hardly change what is left on held-out data (`gap.naming.trifles`)."""
        if self._behind is None or not self.found:
            return ()
        _, state = self._behind
        return trifles(state, estimate(state, _values(self.found)), [f.name for f in self.found])

    def with_a_rest(self, share: float) -> Naming:
        """The verdict where this share of the held-out gap is still open: something is left, and on what it depends."""
        assert self._behind is not None  # a verdict that names something has it
        bench, state = self._behind
        rest_of = unexplained(every_rest(bench, state.start, estimate(state, _values(self.found))))
        return replace(self, unexplained=Unexplained(True, rest_of.depends_on, share))

    def joined(self, of: Collection[str]) -> Naming | None:
        """The verdict with one more name, of these, that earns its place beside a poor model (`gap.naming.joining`)."""
        assert self._behind is not None  # a verdict that names something has it
        bench, state = self._behind
        values = _values(self.found)
        more = joined(state, estimate(state, values), values, set(of) - poorly_told(values))
        if more is None:
            return None
        judged = _judge(*more)
        new = [f for f in judged.found if f.name not in values]
        if len(judged.found) <= len(values) or any(_is_thin(f) for f in new):
            return None
        kept = in_classes(judged.found, bench.flights)
        return Naming(
            kept,
            tuple(r for r in self.rejected if r.name not in {f.name for f in kept}),
            corrected(state.start, kept),
            beside_names(bench, state.start, judged.estimates),
            self.where,
            judged.constant,
            self.identifiable,
            self.proposed,
            (bench, more[0]),
        )

    def with_guessed_numbers(self) -> Naming:
        """The verdict with what the file only guesses in its intervals, and the common scale's class."""
        if self._behind is None or not is_touched(self._behind[1].start, self.found):
            return self
        found, vehicle = carried(self._behind[1], self.found, self.vehicle)
        return replace(self, found=found, vehicle=vehicle)

    def with_classes_of_a_poor_model(self) -> Naming:
        """The verdict far from the noise, where what a poor model can't tell apart is one class (`gap.classes`)."""
        return replace(self, found=tuple(beside_a_poor_model(f) for f in self.found))

    @property
    def can_be_fitted(self) -> bool:
        """Whether anything could be learned from these flights."""
        return self._behind is not None

    def with_only(self, found: Sequence[Found]) -> Naming:
        """The verdict with just these names, their parameters fitted again; what was left over stays as it was said."""
        assert self._behind is not None  # a verdict that was proposed anything has it
        _, state = self._behind
        made = estimate(state, _values(found))
        names = {f.name for f in found}
        return replace(
            self,
            found=tuple(replace(f, parameters=_parameters(state, made, f.name)) for f in found),
            rejected=tuple(r for r in self.rejected if r.name not in names),
            vehicle=made.vehicle,
        )

    def without(self, gone: Collection[str], reason: str) -> Naming:
        """The verdict less some of its names: the others fitted again without them, and what then is left unexplained.

        That something is missing stays true, whatever the remainder depends on.
        """
        kept = tuple(f for f in self.found if f.name not in gone)
        back = tuple(Rejected(f.name, f.delta_bic, reason) for f in self.found if f.name in gone)
        assert self._behind is not None  # a verdict that names something has it
        bench, state = self._behind
        made = estimate(state, _values(kept))
        refitted = tuple(replace(f, parameters=_parameters(state, made, f.name)) for f in kept)
        left = beside_names(bench, state.start, made)
        return replace(
            self,
            found=refitted,
            rejected=(*back, *self.rejected),
            vehicle=made.vehicle,
            unexplained=left if kept else replace(left, fraction=1.0),
        )


def _is_thin(found: Found) -> bool:
    """Whether its evidence alone would not do for a name, or held-out data hold next to nothing of it."""
    return found.delta_bic > -LEAST_EVIDENCE or found.holdout_gain < _LEAST_GAIN


def _values(found: Sequence[Found]) -> dict[str, dict[str, float]]:
    return {f.name: {p: e.estimate for p, e in f.parameters.items()} for f in found}


def name(vehicle: Vehicle, flights: Sequence[Samples], fit: Sequence[Mask], holdout: Sequence[Mask]) -> Naming:
    """Name the missing effects of `vehicle` from flights; masks (N,) by flight: samples to learn from, to judge by.

    The masks must leave a guard of two seconds between them.  Samples that are not `valid` are never used.  Nothing
    raises on odd data: what can't be judged is not named.
    """
    valid = [s.valid for s in flights]
    bench = simulator_bench(
        vehicle,
        flights,
        [m & v for m, v in zip(fit, valid, strict=True)],
        [m & v for m, v in zip(holdout, valid, strict=True)],
    )
    residuals = [residual(vehicle, s) for s in flights]
    where = locate(residuals, flights)
    if not any(m.any() for m in bench.fit):
        return Naming((), (), vehicle, Unexplained(False), where, {})
    state = search(bench, vehicle, () if has_gyro(flights) else POORLY_TOLD)
    best = _pruned(state)
    judged = _judge(state, best)
    rests = every_rest(bench, vehicle, judged.estimates)
    told = telling(bench, judged.estimates, rests)
    seen = identify(state.point)
    doubtful = {e for group in told for e in _touched(state, judged, rests, group)}
    left = unexplained(loud(bench, vehicle, told))
    sagging = any(f.name == "battery_sag" for f in judged.found)
    if sagging and drifts_better(state, judged.estimates, moved(state, judged.estimates)):
        names = [f.name for f in judged.found]  # strongest first: what is weaker leans on it
        doubtful |= set(names[names.index("battery_sag") :])
        left = Unexplained(True, ("time", "battery"), 1.0)
    doubtful |= {f.name for f in judged.found if all(untold(s, f.name) for s in bench.flights)}
    kept = in_classes(tuple(f for f in judged.found if f.name not in doubtful), bench.flights)
    rejected = _rejected(bench, state, best, tuple(f.name for f in kept), doubtful)
    behind = (bench, state)
    return Naming(kept, rejected, corrected(vehicle, kept), left, where, judged.constant, seen, judged.found, behind)


def _touched(state: SelectionState, judged: _Judged, rests: Mapping[str, Rest], group: str) -> set[str]:
    """Named effects that may only stand for what this group's remainder depends on: they act there, and it is large.

    An effect acts where it does most: a weight is not doubted for what is left of the side force.  One that changes
    from stretch to stretch is given less leave, and so is one that is the same everywhere where something depends on
    the place.
    """
    r = rests[group]
    power = {name: _power(state, judged.estimates, each) for name, each in rests.items()}
    explained = max(r.before - r.after, 0.0) + r.driven
    out = set()
    for effect, mine in power[group].items():
        fickle = judged.constant.get(effect, 1.0) < _NOT_CONSTANT_P
        elsewhere = effect in _EVERYWHERE and "position" in r.drivers
        most = max(each.get(effect, 0.0) for each in power.values())
        acts = mine > _ACTS_SHARE * explained and (fickle or mine >= most)
        if acts and (fickle or elsewhere or r.share > _ABSTAIN_SHARE):
            out.add(effect)
    return out


def _power(state: SelectionState, made: Estimates, r: Rest) -> dict[str, float]:
    """What each effect brings to a group, mean square in units of the noise."""
    out: dict[str, float] = {}
    if r.by_column:
        for (effect, _), size, shift in zip(made.slots, r.by_column, moved(state, made), strict=True):
            out[effect] = out.get(effect, 0.0) + size * shift**2
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    found: tuple[Found, ...]
    estimates: Estimates
    constant: Mapping[str, float]


def _fall(state: SelectionState, effects: Mapping[str, Mapping[str, float]], gone: str) -> float:
    """How far chi-square falls by one of the effects, the others fitted again, on the columns at the best."""
    point = state.point
    whole = members(point.candidates, effects)
    less = tuple(m for m in whole if point.candidates[m].effect != gone)
    gains = [s.gain for s in fit_subsets(point.gram(), [whole, less], point.columns, point.low, point.high)]
    most, least = (gain if np.isfinite(gain) else 0.0 for gain in gains)
    return float(most - least)


def _pruned(state: SelectionState) -> Fit:
    """The best fit, less the members whose own evidence is too thin or whose size is trifling.

    Evidence is told by columns taken at the best fit itself: far from there they promise the wrong thing.
    """
    key = state.best_key
    if state.fits[key].vehicle is not state.point.vehicle:
        move_to(state, state.fits[key].vehicle)
    best = state.fits[key]
    while best.effects:
        weakest, drop = "", np.inf
        for effect in best.effects:
            fall = _evidence(state, best, effect)
            if _size(state, best, effect) < _LEAST_SIZES:
                fall = min(fall, 0.0)
            if fall < drop:
                weakest, drop = effect, fall
        if drop >= LEAST_EVIDENCE:
            return best
        rest_of = frozenset(best.effects) - {weakest}
        same = [f for f in state.fits.values() if frozenset(f.effects) == rest_of]
        best = min([*same, _refit(state, best, weakest)], key=lambda f: f.chi2)
    return best


def _evidence(state: SelectionState, best: Fit, effect: str) -> float:
    """By how much the score would rise without the effect."""
    used = len(best.effects[effect])
    price = used * np.log(max(float(state.metric.rows.sum()), 2.0)) + 2.0 * np.log(len(state.point.candidates))
    return _fall(state, best.effects, effect) - float(price)


def _refit(state: SelectionState, best: Fit, gone: str) -> Fit:
    left = {e: v for e, v in best.effects.items() if e != gone}
    made = estimate(state, left)
    effects = {e: dict(made.vehicle.effects[e]) for e in left}
    return judged_fit(state, effects, made.vehicle, made.rows, len(made.slots))


def _size(state: SelectionState, best: Fit, effect: str) -> float:
    """The effect's largest change in negligible sizes."""
    sizes = []
    for spec in EFFECT_SPECS[effect].params:
        origin = value(state.start, effect, spec.name)
        if not spec.integer and not spec.required and np.isfinite(origin):
            change = abs(best.effects[effect][spec.name] - origin)
            sizes.append(change / negligible(best.vehicle, effect, spec.name))
    return max(sizes, default=0.0)


def _judge(state: SelectionState, best: Fit) -> _Judged:
    made = estimate(state, best.effects)
    if not best.effects:
        return _Judged((), made, {})
    found = []
    count = len(EFFECT_SPECS)
    for effect in best.effects:
        fall = _evidence(state, best, effect)
        p_value = _p_value(state, best, effect)
        others = alternatives(state, best, effect)
        held = gain(state, made, effect)
        if p_value * count > _LEAST_P or held <= 0.0:
            continue
        found.append(
            (
                fall,
                Found(
                    effect,
                    _parameters(state, made, effect),
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
    return _Judged(tuple(f for _, f in found), made, constant)


def _p_value(state: SelectionState, best: Fit, effect: str) -> float:
    """Likelihood ratio of the effect against trifles of all others."""
    fall = _fall(state, best.effects, effect)
    return float(chdtrc(max(len(best.effects[effect]), 1), max(fall, 0.0)))


def _parameters(state: SelectionState, made: Estimates, effect: str) -> dict[str, Estimate]:
    found: dict[str, Estimate] = {}
    for spec in EFFECT_SPECS[effect].params:
        before = value(state.start, effect, spec.name)
        now = value(made.vehicle, effect, spec.name)
        if spec.integer:
            found[spec.name] = Estimate(before, now, now, now)
            continue
        i = made.slots.index((effect, spec.name))
        reach = _CI * float(np.sqrt(max(made.covariance[i, i], 0.0)))
        low, high = plausible(state.start, effect, spec.name)
        if reach > 0.0:
            low, high = max(now - reach, low), min(now + reach, high)
        found[spec.name] = Estimate(before, now, min(low, now), max(high, now))
    return found


def _rejected(
    bench: SimulatorBench, state: SelectionState, best: Fit, found: tuple[str, ...], doubtful: set[str]
) -> tuple[Rejected, ...]:
    """Every effect that was not named with what it would change on top of those that were."""
    point = state.point
    gram = point.gram()
    base = members(point.candidates, best.effects)
    without = fit_subsets(gram, [base], point.columns, point.low, point.high)[0]
    out = []
    for effect in EFFECT_SPECS:
        if effect in found:
            continue
        if effect in best.effects:
            reason = "what it explains depends on something else as well" if effect in doubtful else "too thin"
            out.append(Rejected(effect, -_evidence(state, best, effect), reason))
            continue
        if effect in bench.mute or all(unseen(s, effect) for s in bench.flights):
            out.append(Rejected(effect, 0.0, "this log can't show it"))
            continue
        tried = [tuple(sorted((*base, m))) for m, c in enumerate(point.candidates) if c.effect == effect]
        if not tried:
            out.append(Rejected(effect, 0.0, "this log can't show it"))
            continue
        subsets = fit_subsets(gram, tried, point.columns, point.low, point.high)
        gains = [s.gain - without.gain - (s.used - without.used) * np.log(gram.rows) for s in subsets]
        gain = max((g for g in gains if np.isfinite(g)), default=0.0)
        out.append(Rejected(effect, float(-gain), "explains nothing more"))
    return tuple(out)
