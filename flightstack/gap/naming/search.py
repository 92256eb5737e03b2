"""The search: which subset of the candidates explains the flights best, each judged where it really is.

All subsets of up to three are scored on columns at the vehicle as given; the best of each size are then fitted in
earnest, residual and columns taken anew at every step (Gauss-Newton).  Round the best of those the columns are taken
anew as well, and its neighbours tried (one member less, up to two more or others), until none is better.  A greedy
search would take a proxy first and never let go of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from flightstack.effects import EFFECTS
from flightstack.gap.decisions import ALIKE_EVIDENCE, LINE_ERROR, LINE_ERROR_SHARE, NAME_EVIDENCE
from flightstack.gap.naming.candidates import Candidate, at_end, at_physical_end, fitted, members
from flightstack.gap.naming.design import Bench, Linearised, RawDesign, linearise, whitened
from flightstack.gap.naming.evidence import Subset, all_subsets, fit_subsets, nothing, score
from flightstack.gap.naming.metric import Metric, bounded_step, metric_of
from flightstack.gap.naming.proportion import priced, spared
from flightstack.gap.simulate import FreeParameter, value, with_value
from flightstack.types import F64
from flightstack.vehicle import Vehicle

MOST = 3
_SHORTLIST = {1: 4, 2: 4, 3: 3}
_NEIGHBOURS = 6
_ONE_LINE = ((("motor_lag", "time_constant_s"), ("transport_delay", "delay_s")),)
"""To first order alike, at tens of milliseconds not at all: each is fitted in the other's place."""
_HUNG = (("payload", "mass_kg"), ("slung_load", "mass_kg"))
"""Its weight is all that a line shows of a load on a rope: one is hung in a payload's place."""
_STUCK = 6.0
_ROUNDS = 3
_STEPS = 4
_CHORDS = 2
"""Steps with the same columns."""
_CONVERGED = 0.1
"""Chi-square that another step would gain."""
_HALVINGS = 3
_ROPES_M = np.geomspace(0.2, 4.0, 14)
_NEAR_ROPES = (0.88, 1.0, 1.14)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """One subset, fitted in earnest."""

    effects: Mapping[str, Mapping[str, float]]
    """Effect -> all its parameters, as they stand in `vehicle`."""
    vehicle: Vehicle
    rows: F64
    """(R,) whitened residual at `vehicle`."""
    chi2: float
    used: int  # coefficients fitted
    score: float
    pressed: frozenset[str] = frozenset()
    """Effects at a value that may be true but that the flights would clearly go beyond."""


@dataclass(slots=True, eq=False)
class SelectionState:
    """State of one search: where the columns are, and all that has been fitted."""

    bench: Bench
    start: Vehicle
    point: Linearised
    metric: Metric
    fits: dict[frozenset[str], Fit] = field(default_factory=dict)
    """By candidate keys."""
    excluded: set[str] = field(default_factory=set)
    """Effects that ran to the end of what is plausible where they fitted best: they are not tried again."""
    apart: Sequence[tuple[str, str]] = ()
    """Pairs of effects that these flights can't tell apart: never named together."""
    rope_m: float = 0.0
    """Length of the rope that was best with the present columns, 0 before any was looked for."""
    rope_most_m: float = np.inf
    """How high the vehicle flew: a load on a longer rope would have lain on the ground."""
    margin: float = NAME_EVIDENCE
    """Evidence that a name needs beyond the price of its coefficients."""

    @property
    def best(self) -> Fit:
        """The fit with the least score, of those that stand at no end of what is plausible."""
        return self.fits[self.best_key]

    def fair(self) -> list[Fit]:
        """The fits that stand at no end of what is plausible."""
        return [fit for fit in self.fits.values() if self._is_fair(fit)]

    def _is_fair(self, fit: Fit) -> bool:
        return not (self.excluded & set(fit.effects) or effects_at_bound(self.start, fit, self.rope_most_m))

    @property
    def best_key(self) -> frozenset[str]:
        """By which it is kept; what adds less than a name needs is not followed, of others as good the fewest names."""
        fair = {key: fit.score for key, fit in self.fits.items() if self._is_fair(fit)}
        best = min(fair, key=lambda key: fair[key])
        as_good = [
            k for k in fair if fair[k] <= fair[best] + (self.margin if k <= best else min(ALIKE_EVIDENCE, self.margin))
        ]
        fewest = min(len(key) for key in as_good)
        as_good = [key for key in as_good if key <= best or len(key) == fewest]
        return min(as_good, key=lambda key: (len(key), fair[key]))


def effects_at_bound(start: Vehicle, fit: Fit, rope_most_m: float = np.inf) -> set[str]:
    """Its effects that stand at an end of what is plausible, and not merely where the true value may lie."""
    lying = {e for e, values in fit.effects.items() if e == "slung_load" and values["length_m"] > rope_most_m}
    ends = {e: [(p, x) for p, x in values.items() if at_end(start, e, p, x)] for e, values in fit.effects.items()}
    return lying | {
        e for e, at in ends.items() if any(e in fit.pressed or not at_physical_end(start, e, *each) for each in at)
    }


def _exclude_at_bound(state: SelectionState) -> bool:
    """Bar what is strained in the fit that else were the best; whether there was any."""
    fair = [fit for fit in state.fits.values() if not state.excluded & set(fit.effects)]
    at_ends = effects_at_bound(state.start, min(fair, key=lambda fit: fit.score), state.rope_most_m)
    state.excluded |= at_ends
    return bool(at_ends)


def search(
    bench: Bench,
    raw: RawDesign,
    apart: Sequence[tuple[str, str]] = (),
    *,
    steady: bool = False,
    rope_most_m: float = np.inf,
    margin: float = NAME_EVIDENCE,
) -> SelectionState:
    """The subsets worth a look, fitted; `raw` is of the vehicle as its file has it; `apart`: never together.

    `steady`: the noise's colour takes no means with it from the beginning (of a hover a mean is all there is).
    `rope_most_m`, `margin`: of `SelectionState`.
    """
    start, point = raw.vehicle, whitened(bench, raw, at_start=not steady)
    state = SelectionState(bench, start, point, metric_of(point), apart=apart, rope_most_m=rope_most_m, margin=margin)
    _fit_all(state, [nothing(len(point.slots))])
    subsets = all_subsets(len(point.candidates), MOST, [c.effect for c in point.candidates])
    scored = _scored(state, [s for s in subsets if _allowed(state, s)])
    _fit_all(state, _shortlist(scored))
    while _exclude_at_bound(state):
        _fit_all(state, _shortlist([(value_, s) for value_, s in scored if _allowed(state, s.members)]))
    swaps = (*_ONE_LINE, *(pair[::-1] for pair in _ONE_LINE), _HUNG)
    _swap(state, swaps)
    for _ in range(_ROUNDS):
        best = state.best
        if best.vehicle is state.point.vehicle:
            break
        move_to(state, best.vehicle)
        _fit_all(state, _neighbours(state))
        while _exclude_at_bound(state):
            _fit_all(state, _neighbours(state))
        _swap(state, swaps)
    return state


def _allowed(state: SelectionState, members: Sequence[int]) -> bool:
    effects = {state.point.candidates[m].effect for m in members}
    return not state.excluded & effects and not any(effects.issuperset(pair) for pair in state.apart)


def move_to(state: SelectionState, vehicle: Vehicle) -> None:
    """Take all columns and the noise anew at this vehicle and measure all fits by the new metric."""
    state.point = linearise(state.bench, vehicle, state.start)
    state.metric = metric_of(state.point)
    state.rope_m = 0.0
    for key, fit in state.fits.items():
        rows = state.point.layout.stack(state.bench.residual(fit.vehicle))
        state.fits[key] = judged_fit(state, fit.effects, fit.vehicle, rows, fit.used, fit.pressed)


def _shortlist(scored: list[tuple[float, Subset]]) -> list[Subset]:
    """The best of each size, and of those only what comes near the best of all: columns taken elsewhere err."""
    best, floor = scored[0]
    margin = LINE_ERROR + LINE_ERROR_SHARE * floor.gain
    return [
        s
        for size, count in _SHORTLIST.items()
        for rank, (value_, s) in enumerate([item for item in scored if len(item[1].members) == size][:count])
        if rank < 1 or value_ < best + margin
    ]


def _scored(state: SelectionState, subsets: Sequence[tuple[int, ...]]) -> list[tuple[float, Subset]]:
    """Subsets with their scores on the columns as they are, best first."""
    point = state.point
    gram = point.gram()
    count = len(point.candidates)
    found = fit_subsets(gram, subsets, point.columns, point.low, point.high)
    gain, used = np.array([s.gain for s in found]), np.array([s.used for s in found])
    sizes = np.array([len(s.members) for s in found])
    values = np.asarray(gram.c + score(gain, used, sizes, gram.rows, count))
    at = priced(point, state.start)
    mixed = [i for i, s in enumerate(subsets) if at.factor.keys() & set(s)]
    values[mixed] = np.minimum(values[mixed], gram.c + np.array(at.least([subsets[i] for i in mixed])))
    return [(float(values[i]), found[i]) for i in np.argsort(values, kind="stable") if np.isfinite(values[i])]


def _neighbours(state: SelectionState) -> list[Subset]:
    """Subsets one member less and up to two more than the best, where they come near it."""
    point, effects = state.point, state.best.effects
    inside = members(point.candidates, effects)
    outside = [m for m, c in enumerate(point.candidates) if c.effect not in effects and _allowed(state, (m,))]
    kept = [inside] + [tuple(m for m in inside if m != gone) for gone in inside]
    subsets = {
        tuple(sorted(base + more))
        for base in kept
        for size in range(3)
        for more in combinations(outside, size)
        if len({point.candidates[m].effect for m in more}) == size and _allowed(state, base + more)
    }
    scored = _scored(state, sorted(subsets))
    best = state.best.score
    found = []
    for value_, s in scored:
        # more on top of the best is told well by these columns, something else in its place is not
        near = best - 0.5 * NAME_EVIDENCE if set(inside) <= set(s.members) else best + LINE_ERROR
        if value_ < min(near, _beaten(state, s)):
            found.append(s)
    return found[:_NEIGHBOURS]


def _swap(state: SelectionState, swaps: Sequence[tuple[tuple[str, str], tuple[str, str]]]) -> None:
    """Fit the best with what a straight line hardly tells from one of its members in that one's place, as large."""
    effects, start = state.best.effects, state.start
    for (old, was), (new, now) in swaps:
        if old not in effects or new in effects or new in state.excluded:
            continue
        size = effects[old][was] - value(start, old, was) + value(start, new, now)
        if size <= value(start, new, now):  # sooner than the file says: no delay is negative
            continue
        required = {p.name: 1.0 for p in EFFECTS[new].params if p.required}
        swapped = {e: values for e, values in effects.items() if e != old} | {new: {now: size} | required}
        vehicle = start
        for effect, values in swapped.items():
            vehicle = with_value(vehicle, effect, values)
        group = [state.point.candidates[m] for m in members(state.point.candidates, swapped)]
        _keep(
            state, group, fit_from(state, group, _fit_cable_length(state, vehicle) if new == "slung_load" else vehicle)
        )


def _beaten(state: SelectionState, subset: Subset) -> float:
    """Score below which a subset is fitted: what it had, if it was stuck far from where the columns now point to."""
    fit = state.fits.get(_key([state.point.candidates[m] for m in subset.members]))
    return np.inf if fit is None else fit.score - _STUCK


def _key(group: Sequence[Candidate]) -> frozenset[str]:
    """What tells fits apart: the effects and the whole numbers held, not where a free parameter started."""
    return frozenset(_label(c) for c in group)


def _label(candidate: Candidate) -> str:
    whole = {p.name for p in EFFECTS[candidate.effect].params if p.integer}
    return candidate.effect + "".join(f":{k}={v:g}" for k, v in candidate.variant.items() if k in whole)


def _fit_all(state: SelectionState, subsets: Iterable[Subset]) -> None:
    for subset in subsets:
        _keep(state, [state.point.candidates[m] for m in subset.members], fit_subset(state, subset))


def _keep(state: SelectionState, group: Sequence[Candidate], fit: Fit) -> None:
    key = _key(group)
    if key not in state.fits or fit.score < state.fits[key].score:
        state.fits[key] = fit


def fit_subset(state: SelectionState, subset: Subset) -> Fit:
    """The subset fitted from where the columns point to."""
    group = [state.point.candidates[m] for m in subset.members]
    vehicle = _stepped(state, subset)
    if any(c.effect == "slung_load" for c in group):
        vehicle = _fit_cable_length(state, vehicle)
    return fit_from(state, group, vehicle)


def fit_from(state: SelectionState, group: Sequence[Candidate], vehicle: Vehicle) -> Fit:
    """Gauss-Newton from this vehicle; columns are taken anew while they still promise something else."""
    layout, metric = state.point.layout, state.metric
    rows = layout.stack(state.bench.residual(vehicle))
    chi2, used = metric.chi2(rows), 0
    pressed: frozenset[str] = frozenset()
    for _ in range(_STEPS if group else 0):
        slots = [(c, p) for c in group for p in fitted(vehicle, c.effect, vehicle.effects[c.effect]).parameters]
        raw = state.bench.columns(vehicle, [FreeParameter(c.effect, p) for c, p in slots])
        x = metric.columns(layout.stack([np.nan_to_num(values) for values in raw]))
        before = chi2
        for _ in range(_CHORDS):
            now = np.array([value(vehicle, c.effect, p) for c, p in slots])
            low = np.array([c.spec(p).minimum for c, p in slots]) - now
            high = np.array([c.spec(p).maximum for c, p in slots]) - now
            b = x.toward(rows)
            step, used = bounded_step(x.k, b, low, high)
            if 2.0 * float(b @ step) - float(step @ x.k @ step) < _CONVERGED:
                break
            moved, new_rows, new_chi2 = _best_on_the_way(state, vehicle, slots, now, step, chi2)
            if new_chi2 >= chi2:
                break
            vehicle, rows, chi2 = moved, new_rows, new_chi2
        sides = [at_physical_end(state.start, c.effect, p, value(vehicle, c.effect, p)) for c, p in slots]
        pressed = frozenset(slots[i][0].effect for i in pressed_beyond(x.k, x.toward(rows), np.array(sides)))
        if before - chi2 < 10.0 * _CONVERGED:
            break
    effects = {c.effect: dict(vehicle.effects[c.effect]) for c in group}
    return judged_fit(state, effects, vehicle, rows, used, pressed)


def pressed_beyond(k: F64, b: F64, sides: NDArray[np.int64]) -> list[int]:
    """Coefficients at an end (-1 least, 1 greatest, 0 none) beyond which chi-square falls by what a name needs."""
    free = np.flatnonzero(sides == 0)
    inverse = np.linalg.pinv(k[np.ix_(free, free)], hermitian=True)
    found = []
    for i in np.flatnonzero(sides):
        pull = float(b[i] - k[i, free] @ inverse @ b[free])
        stiffness = float(k[i, i] - k[i, free] @ inverse @ k[free, i])
        if pull * sides[i] > 0.0 and pull**2 > NAME_EVIDENCE * stiffness:
            found.append(int(i))
    return found


def _fit_cable_length(state: SelectionState, vehicle: Vehicle) -> Vehicle:
    """The vehicle with the rope on which the load swings best: too long or too short by a quarter it swings otherwise.

    Which rope that is hardly depends on what else is missing, so all are tried once for each set of columns.
    """
    best, least = vehicle, np.inf
    now = value(vehicle, "slung_load", "length_m")
    near = [state.rope_m * share for share in _NEAR_ROPES]
    for length in (now, *(near if state.rope_m > 0.0 else _ROPES_M)):
        tried = with_value(vehicle, "slung_load", {"length_m": float(length)})
        chi2 = state.metric.chi2(state.point.layout.stack(state.bench.residual(tried)))
        if chi2 < least:
            best, least, state.rope_m = tried, chi2, float(length)
    return best


def _stepped(state: SelectionState, subset: Subset) -> Vehicle:
    """The start vehicle with the subset's own coefficients."""
    point = state.point
    vehicle = state.start
    for m in subset.members:
        candidate = point.candidates[m]
        values = candidate.values(point.vehicle)
        for i in point.columns[m]:
            slot = point.slots[i]
            moved = slot.origin + float(subset.theta[i])
            values[slot.parameter] = float(np.clip(moved, slot.minimum, slot.maximum))
        vehicle = with_value(vehicle, candidate.effect, values)
    return vehicle


def judged_fit(
    state: SelectionState,
    effects: Mapping[str, Mapping[str, float]],
    vehicle: Vehicle,
    rows: F64,
    used: int,
    pressed: frozenset[str] = frozenset(),
) -> Fit:
    """A fit with its chi-square and score by the present metric."""
    chi2 = state.metric.chi2(rows)
    points = float(state.metric.rows.sum())
    price = float(score(0.0, used, len(effects), points, len(state.point.candidates)))
    return Fit(effects, vehicle, rows, chi2, used, chi2 + price - spared(state.point, state.start, effects), pressed)


def _best_on_the_way(
    state: SelectionState, vehicle: Vehicle, slots: list[tuple[Candidate, str]], now: F64, step: F64, chi2: float
) -> tuple[Vehicle, F64, float]:
    share = 1.0
    tried = (vehicle, np.empty(0), np.inf)
    for _ in range(_HALVINGS):
        moved = vehicle
        for (c, p), v in zip(slots, now + share * step, strict=True):
            spec = c.spec(p)
            moved = with_value(moved, c.effect, {p: float(np.clip(v, spec.minimum, spec.maximum))})
        rows = state.point.layout.stack(state.bench.residual(moved))
        tried = (moved, rows, state.metric.chi2(rows))
        if tried[2] < chi2:
            break
        share *= 0.4
    return tried
