"""Name what is missing: the effects that explain the residuals of these flights, or none.

search (gap.naming.search)  ->  which subset explains most for its price, every one fitted in earnest
verdict (gap.judge)         ->  what of it may be said: significant, constant, better on held-out data, not a proxy
classes (gap.classes)       ->  what else would explain the flights as well
rest (gap.rest)             ->  what is left and on what it depends; too much of it, and nothing is named
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap.across import Told, across, by_rows
from flightstack.gap.classes import (
    POORLY_TOLD,
    beside_a_poor_model,
    has_gyro,
    in_classes,
    poorly_told,
    together,
)
from flightstack.gap.compare import residual
from flightstack.gap.decisions import FICKLE_P, GAP_FROM, LEAST_GAIN, NAME_EVIDENCE, TENTH
from flightstack.gap.held import corrected
from flightstack.gap.identify import Identifiable, identify
from flightstack.gap.judge import Judged, better_as_drift, evidence, judge, parameters_of, pruned
from flightstack.gap.locate import locate
from flightstack.gap.naming.bench import SimulatorBench, simulator_bench
from flightstack.gap.naming.candidates import members, plausible
from flightstack.gap.naming.design import design
from flightstack.gap.naming.estimate import CI, Estimates, estimate, parameter_change
from flightstack.gap.naming.evidence import fit_subsets
from flightstack.gap.naming.joining import forward_selection_step
from flightstack.gap.naming.ranged import as_twins_read, carried, is_touched
from flightstack.gap.naming.search import Fit, SelectionState, search
from flightstack.gap.naming.trifles import trifles
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.records import Across, ChannelResidual, IdentifiedEffect, Rejected, Samples, Unexplained
from flightstack.gap.remainder import (
    ResidualTest,
    above_noise,
    residual_tests,
    structured_residuals,
    unexplained,
    unexplained_given,
)
from flightstack.gap.simulate import confounded_with_attitude, missing_signals
from flightstack.vehicle import Vehicle

EVERYWHERE = frozenset({"constant_force", "steady_wind"})
"""Effects that no place is without: a jet of air, or another vehicle's wake, looks like one as long as one is in it."""

DRIFTS = "a thrust that drifts with time explains the flights better"

_HEIGHT_ERROR_M = 1.6
"""Of PX4's own height in a flight, the worst of 69 (docs/limits.md)."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The verdict."""

    found: tuple[IdentifiedEffect, ...]
    """Strongest first; empty where model and flights agree, and where too much stays unexplained."""
    rejected: tuple[Rejected, ...]
    """Every other effect of the table, and why not."""
    vehicle: Vehicle
    """The vehicle with the found effects at their estimates; the given one where nothing was found."""
    unexplained: Unexplained
    where: tuple[ChannelResidual, ...]
    constant: Mapping[str, float]
    """Effect -> p-value of its being the same in all stretches of the flights."""
    identifiable: tuple[Identifiable, ...] = ()
    """What these flights could have shown at all (`gap.identify`)."""
    proposed: tuple[IdentifiedEffect, ...] = ()
    """All that the search found, also what was taken back since as something that depends on more."""
    _behind: tuple[SimulatorBench, SelectionState] | None = None
    """For `without`."""
    across: tuple[Across, ...] = ()
    """Of several flights: what each says alone (`in_each_flight`)."""

    def in_each_flight(self, alone: Sequence[Told]) -> Selection:
        """The verdict with what each of several flights says alone: refined (`alone`), else by one step at a time.

        What was taken back because it differed stays on the list.
        """
        if self._behind is None or not self.found:
            return self
        bench, state = self._behind
        stepped = by_rows(state, estimate(state, _values(self.found)))
        refined = {slot for told in alone for slot in told}
        told = {
            samples.name: {**{slot: e for slot, e in one.items() if slot not in refined}, **more}
            for samples, one, more in zip(bench.flights, stepped, alone, strict=True)
        }
        names = {f.name for f in self.found}
        before = tuple(row for row in self.across if row.effect not in names)
        return replace(self, across=(*across(state.start, self.vehicle, told), *before))

    def as_wide_as_it_varies(self) -> Selection:
        """The verdict with intervals that reach as far as the stretches of the flights differ."""
        if self._behind is None or not self.found:
            return self
        state = self._behind[1]
        made = estimate(state, _values(self.found))
        between = dict(zip(made.slots, made.between.tolist(), strict=True))
        return replace(self, found=tuple(_widened(state.start, f, between) for f in self.found))

    def trifles(self) -> tuple[str, ...]:
        """Of its names, those that hardly change what is left on held-out data (`gap.naming.trifles`)."""
        if self._behind is None or not self.found:
            return ()
        _, state = self._behind
        return trifles(state, estimate(state, _values(self.found)), [f.name for f in self.found])

    def with_unexplained(self, share: float) -> Selection:
        """The verdict where this share of the held-out gap is still open: something is left, and on what it depends."""
        assert self._behind is not None  # a verdict that names something has it
        bench, state = self._behind
        rest_of = unexplained(residual_tests(bench, state.start, estimate(state, _values(self.found))))
        return replace(self, unexplained=Unexplained(True, rest_of.depends_on, share))

    def forward_selection_step(self, of: Collection[str]) -> Selection | None:
        """The verdict with one more name, of these, that earns its place beside a poor model (`gap.naming.joining`)."""
        assert self._behind is not None  # a verdict that names something has it
        bench, state = self._behind
        values = _values(self.found)
        more = forward_selection_step(state, estimate(state, values), values, set(of) - poorly_told(values))
        if more is None:
            return None
        judged = judge(*more)
        mute = any(_is_mute(f) for f in judged.found if f.name not in values)
        if len(judged.found) <= len(values) or mute:
            return None
        kept = in_classes(judged.found, bench.flights)
        return Selection(
            kept,
            tuple(r for r in self.rejected if r.name not in {f.name for f in kept}),
            corrected(state.start, kept),
            unexplained_given(bench, state.start, judged.estimates),
            self.where,
            judged.constant,
            self.identifiable,
            self.proposed,
            (bench, more[0]),
        )

    def with_twins(self, name: str, others: tuple[str, ...]) -> Selection:
        """The verdict where one name can't be told from these others either: it was found in their place."""
        return replace(self, found=tuple(together(f, others) if f.name == name else f for f in self.found))

    def with_guessed_numbers(self) -> Selection:
        """The verdict with what the file only guesses in its intervals, and the common scale's class."""
        if self._behind is None or not self.found:
            return self
        state, told = self._behind[1], self
        if is_touched(state.start, self.found):
            found, vehicle = carried(state, self.found, self.vehicle)
            told = replace(self, found=found, vehicle=vehicle)
        found = as_twins_read(state.start, told.found)
        return told if found is told.found else replace(told, found=found)

    def with_classes_of_a_poor_model(self) -> Selection:
        """The verdict far from the noise, where what a poor model can't tell apart is one class (`gap.classes`)."""
        return replace(self, found=tuple(beside_a_poor_model(f) for f in self.found))

    def without_telling(self, slots: Collection[tuple[str, str]]) -> Selection:
        """The verdict with these parameters as the file has them: the logs can't tell them."""
        found = tuple(
            replace(
                f,
                parameters={
                    p: replace(e, estimate=e.before, told=False) if (f.name, p) in slots else e
                    for p, e in f.parameters.items()
                },
            )
            for f in self.found
        )
        return replace(self, found=found, vehicle=corrected(self.vehicle, found))

    @property
    def left_thin(self) -> bool:
        """Whether another fit has the better score, and was left for the margin that a name needs beyond it."""
        if self._behind is None:
            return False
        scores = {frozenset(fit.effects): fit.score for fit in self._behind[1].fair()}
        said = scores.get(frozenset(f.name for f in self.found), np.inf)
        return min(scores.values(), default=np.inf) < said

    @property
    def can_be_fitted(self) -> bool:
        """Whether anything could be learned from these flights."""
        return self._behind is not None

    def with_only(self, found: Sequence[IdentifiedEffect]) -> Selection:
        """The verdict with just these names, their parameters fitted again; what was left over stays as it was said."""
        assert self._behind is not None  # a verdict that was proposed anything has it
        _, state = self._behind
        made = estimate(state, _values(found))
        names = {f.name for f in found}
        return replace(
            self,
            found=tuple(replace(f, parameters=parameters_of(state, made, f.name)) for f in found),
            rejected=tuple(r for r in self.rejected if r.name not in names),
            vehicle=made.vehicle,
        )

    def without(self, gone: Collection[str], reason: str) -> Selection:
        """The verdict less some of its names: the others fitted again without them, and what then is left unexplained.

        That something is missing stays true, whatever the remainder depends on.
        """
        kept = tuple(f for f in self.found if f.name not in gone)
        back = tuple(Rejected(f.name, f.delta_bic, reason) for f in self.found if f.name in gone)
        assert self._behind is not None  # a verdict that names something has it
        bench, state = self._behind
        made = estimate(state, _values(kept))
        refitted = tuple(replace(f, parameters=parameters_of(state, made, f.name)) for f in kept)
        left = unexplained_given(bench, state.start, made)
        return replace(
            self,
            found=refitted,
            rejected=(*back, *self.rejected),
            vehicle=made.vehicle,
            unexplained=left if kept else replace(left, fraction=1.0),
        )


def _is_mute(found: IdentifiedEffect) -> bool:
    """Whether it is a force of which held-out data hold next to nothing."""
    return EFFECTS[found.name].kind == "force" and found.holdout_gain < LEAST_GAIN


def _widened(start: Vehicle, found: IdentifiedEffect, between: Mapping[tuple[str, str], float]) -> IdentifiedEffect:
    parameters = dict(found.parameters)
    for p, e in found.parameters.items():
        variance = between.get((found.name, p), 0.0)
        if variance > 0.0 and e.told:
            low, high = plausible(start, found.name, p)
            down, up = (
                float(np.hypot(side, CI * np.sqrt(variance))) for side in (e.estimate - e.low, e.high - e.estimate)
            )
            parameters[p] = replace(
                e, low=max(e.estimate - down, min(low, e.low)), high=min(e.estimate + up, max(high, e.high))
            )
    return replace(found, parameters=parameters)


def _values(found: Sequence[IdentifiedEffect]) -> dict[str, dict[str, float]]:
    return {f.name: {p: e.estimate for p, e in f.parameters.items()} for f in found}


def name(
    vehicle: Vehicle,
    flights: Sequence[Samples],
    fit: Sequence[Mask],
    holdout: Sequence[Mask],
    *,
    closely: bool = False,
    margin: float = NAME_EVIDENCE,
) -> Selection:
    """Name the missing effects of `vehicle` from flights; masks (N,) by flight: samples to learn from, to judge by.

    The masks must leave a guard of two seconds between them.  Samples that are not `valid` are never used.  Nothing
    raises on odd data: what can't be judged is not named.  `closely`: trifles are a tenth of what they else are.
    `margin`: evidence that a name needs beyond the price of its coefficients.
    """
    valid = [s.valid for s in flights]
    bench = simulator_bench(
        vehicle,
        flights,
        [m & v for m, v in zip(fit, valid, strict=True)],
        [m & v for m, v in zip(holdout, valid, strict=True)],
        trifles=TENTH if closely else 1.0,
    )
    residuals = [residual(vehicle, s) for s in flights]
    where = locate(residuals, flights)
    if not any(m.any() for m in bench.fit):
        return Selection((), (), vehicle, Unexplained(False), where, {})
    apart = () if has_gyro(flights) else POORLY_TOLD
    raw = design(bench, vehicle, vehicle)
    highest_m = _highest_m(flights)
    state = search(bench, raw, apart, steady=closely, rope_most_m=highest_m, margin=margin)
    best = pruned(state)
    if not (closely or best.effects) and any(each.rms >= GAP_FROM * each.expected_noise for each in where):
        state = search(bench, raw, apart, steady=True, rope_most_m=highest_m, margin=margin)
        best = pruned(state)
    judged = judge(state, best)
    rests = residual_tests(bench, vehicle, judged.estimates)
    told = structured_residuals(bench, judged.estimates, rests)
    seen = identify(state.point, vehicle, {f.name for f in judged.found})
    doubtful = {e for group in told for e in _confounded_terms(state, judged, rests, group)}
    left = unexplained(above_noise(bench, vehicle, told))
    sagging = any(f.name == "battery_sag" for f in judged.found)
    drifting = better_as_drift(state, judged.estimates) if sagging else ()
    if drifting:
        doubtful |= set(drifting)
        left = Unexplained(True, ("time", "battery"), 1.0)
    doubtful |= {f.name for f in judged.found if all(confounded_with_attitude(s, f.name) for s in bench.flights)}
    kept = in_classes(tuple(f for f in judged.found if f.name not in doubtful), bench.flights)
    rejected = _rejected(bench, state, best, tuple(f.name for f in kept), doubtful)
    rejected = tuple(replace(r, reason=DRIFTS) if r.name in drifting else r for r in rejected)
    behind = (bench, state)
    return Selection(kept, rejected, corrected(vehicle, kept), left, where, judged.constant, seen, judged.found, behind)


def _highest_m(flights: Sequence[Samples]) -> float:
    """How high over the ground all flew at some time, the lowest of several; infinite where none says."""
    heights = [s.height_m[s.valid & np.isfinite(s.height_m)] for s in flights]
    return min((float(np.max(h)) + _HEIGHT_ERROR_M for h in heights if len(h)), default=np.inf)


def _confounded_terms(state: SelectionState, judged: Judged, rests: Mapping[str, ResidualTest], group: str) -> set[str]:
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
        fickle = judged.constant.get(effect, 1.0) < FICKLE_P
        elsewhere = effect in EVERYWHERE and "position" in r.drivers
        most = max(each.get(effect, 0.0) for each in power.values())
        acts = mine > TENTH * explained and (fickle or mine >= most)
        if acts and (fickle or elsewhere or r.share > TENTH):
            out.add(effect)
    return out


def _power(state: SelectionState, made: Estimates, r: ResidualTest) -> dict[str, float]:
    """What each effect brings to a group, mean square in units of the noise."""
    out: dict[str, float] = {}
    if r.by_column:
        for (effect, _), size, shift in zip(made.slots, r.by_column, parameter_change(state, made), strict=True):
            out[effect] = out.get(effect, 0.0) + size * shift**2
    return out


def _rejected(
    bench: SimulatorBench, state: SelectionState, best: Fit, found: tuple[str, ...], doubtful: set[str]
) -> tuple[Rejected, ...]:
    """Every effect that was not named with what it would change on top of those that were."""
    point = state.point
    gram = point.gram()
    base = members(point.candidates, best.effects)
    without = fit_subsets(gram, [base], point.columns, point.low, point.high)[0]
    out = []
    for effect in EFFECTS:
        if effect in found:
            continue
        if effect in best.effects:
            fall = evidence(state, best, effect)
            reason = "too thin" if fall < NAME_EVIDENCE else "no better on data not used before"
            if effect in doubtful:
                reason = "what it explains depends on something else as well"
            out.append(Rejected(effect, -fall, reason))
            continue
        if effect in bench.mute or all(missing_signals(s, effect) for s in bench.flights):
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
