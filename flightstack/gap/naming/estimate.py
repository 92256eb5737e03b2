"""The estimates: coefficients of the named effects by the noise alone, their intervals, and how constant they are.

Selection leaves a little of everything in the model (`gap.naming.evidence`); an estimate does not.  The covariance is
the sandwich of the whitened fit: what colour is left in the scores makes it wider (Newey and West, Econometrica 1987).
The rows are white by what some fifty candidates together leave, and these take most of the slow noise with them; a
kernel of half a second finds too little of that again.  So the noise that the named effects alone leave is modelled,
and the intervals are never narrower than it makes them (prewhitening: Andrews and Monahan, Econometrica 1992).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.chances import chi2_tails
from flightstack.gap.decisions import STEADY_MPS2, TENTH
from flightstack.gap.filters import through
from flightstack.gap.naming.candidates import HEIGHT, fitted, negligible, plausible
from flightstack.gap.naming.design import Layout, layout_of
from flightstack.gap.naming.metric import bounded_step
from flightstack.gap.naming.search import SelectionState
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.simulate import FreeParameter, value, with_value
from flightstack.types import F64
from flightstack.vehicle import Vehicle

_STEPS = 4
_STILL = 0.05
"""Standard deviations that another step would move."""
_SEGMENTS = 6
STEADY_PUSHES = ("constant_force", "steady_wind", "accelerometer_bias", "attitude_misalignment")
"""What pushes to one side all the time: in the world, in the body, or seemingly."""
_PUSH_MPS2 = 1.0
"""Of a push that a segment may have: wide, it only keeps the solution where no side force was measured."""
CI = 1.959964
"""Standard deviations of a 95 % interval."""
_BAND_S = 0.5
"""Correlation that whitening may have left."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Parameters of the named effects at the least squares of the noise alone."""

    vehicle: Vehicle
    slots: tuple[tuple[str, str], ...]
    """(effect, parameter) of each."""
    values: F64
    covariance: F64
    spread: F64
    """(n,) p-value of each parameter's being the same in all stretches of the flights."""
    between: F64
    """(n,) variance from stretch to stretch beyond what their noise makes."""
    x: F64
    """(R, n) whitened columns at `vehicle`."""
    rows: F64
    """(R,) whitened residual at `vehicle`."""


def estimate(
    state: SelectionState, effects: Mapping[str, Mapping[str, float]], fixed: Collection[tuple[str, str]] = ()
) -> Estimates:
    """Fit these effects (in the search's whitened rows to learn from) by the noise alone.

    Parameters whose interval would fill all that is plausible stay what the file has, as those do that are `fixed`.
    """
    vehicle = state.start
    for effect, values in effects.items():
        own = {p: value(state.start, effect, p) if (effect, p) in fixed else v for p, v in values.items()}
        vehicle = with_value(vehicle, effect, own)
    layout, chosen = state.point.layout, state.point.fit_rows()
    every = tuple((e, p) for e in effects for p in fitted(vehicle, e, vehicle.effects[e]).parameters)
    slots = tuple(slot for slot in every if slot not in fixed)
    rows = layout.stack(state.bench.residual(vehicle))
    x = np.zeros((len(rows), 0))
    for _ in range(_STEPS if slots else 0):
        raw = state.bench.columns(vehicle, [FreeParameter(e, p) for e, p in slots])
        x = layout.stack([np.nan_to_num(values) for values in raw])
        step = _step(state, vehicle, slots, x, rows, chosen)
        moved = vehicle
        now = np.array([value(vehicle, e, p) for e, p in slots])
        for (e, p), v in zip(slots, now + step, strict=True):
            moved = with_value(moved, e, {p: within_range(vehicle, e, p, v)})
        fresh = layout.stack(state.bench.residual(moved))
        still = float(
            np.max(np.abs(step) / np.sqrt(np.maximum(np.diag(covariance_of(state, x, rows, chosen)), 1e-300)))
        )
        vehicle, rows = moved, fresh
        if still < _STILL:
            break
    left = layout_of(state.bench, state.bench.residual(vehicle), coloured=True) if slots else layout
    free = without_nuisance(state, rows, chosen)
    covariance = covariance_of(state, x, free, chosen, left)
    now = np.array([value(vehicle, e, p) for e, p in slots])
    hidden = _hidden(state.start, slots, now, CI * np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    if hidden:
        return estimate(state, effects, (*fixed, *hidden))
    made = Estimates(vehicle, slots, now, covariance, np.ones(len(slots)), np.zeros(len(slots)), x, rows)
    spread, between = _constancy(state, made, free, chosen)
    return replace(made, spread=spread, between=between)


def _hidden(start: Vehicle, slots: Sequence[tuple[str, str]], values: F64, reach: F64) -> tuple[tuple[str, str], ...]:
    """Parameters whose interval fills their range; none of an effect of which no other is left."""
    wide = {s for s, v, r in zip(slots, values, reach, strict=True) if fills(start, s, float(v - r), float(v + r))}
    return tuple(s for s in slots if s in wide and any(e == s[0] and (e, p) not in wide for e, p in slots))


def fills(start: Vehicle, slot: tuple[str, str], low: float, high: float) -> bool:
    """Whether an interval holds all that is plausible for a parameter that the file (or nothing) has a value of.

    The height of a centre of mass, which hardly any flight shows, is no measurement where either end is reached.
    """
    least, most = plausible(start, *slot)
    ends = (low <= least, high >= most)
    return bool(np.isfinite(value(start, *slot))) and (any(ends) if slot == HEIGHT else all(ends))


def within_range(vehicle: Vehicle, effect: str, parameter: str, v: float) -> float:
    """The value, or the end of what a vehicle file may have of this parameter."""
    spec = next(p for p in fitted(vehicle, effect, vehicle.effects[effect]).parameters if p == parameter)
    row = fitted(vehicle, effect, vehicle.effects[effect]).spec(spec)
    return float(np.clip(v, row.minimum, row.maximum))


def _bounds(vehicle: Vehicle, slots: tuple[tuple[str, str], ...]) -> tuple[F64, F64]:
    specs = [fitted(vehicle, e, vehicle.effects[e]).spec(p) for e, p in slots]
    now = np.array([value(vehicle, e, p) for e, p in slots])
    return np.array([s.minimum for s in specs]) - now, np.array([s.maximum for s in specs]) - now


def _step(
    state: SelectionState, vehicle: Vehicle, slots: tuple[tuple[str, str], ...], x: F64, rows: F64, chosen: Mask
) -> F64:
    low, high = _bounds(vehicle, slots)
    nuisance, size = _fitted_nuisance(state)
    both = np.hstack([x, nuisance])[chosen]
    k = both.T @ both + np.diag(np.concatenate([np.zeros(len(slots)), 1.0 / size**2]))
    b = both.T @ rows[chosen]
    # the nuisance is solved for and left out again
    n = len(slots)
    shift = k[:n, n:] @ np.linalg.inv(k[n:, n:])
    return bounded_step(k[:n, :n] - shift @ k[n:, :n], b[:n] - shift @ b[n:], low, high)[0]


def _fitted_nuisance(state: SelectionState) -> tuple[F64, F64]:
    told = state.point.nuisance_fitted
    return state.point.nuisance[:, told], state.point.nuisance_size[told]


def without_nuisance(state: SelectionState, rows: F64, chosen: Mask) -> F64:
    """(R,) residual at the estimate less what the nuisance makes of it."""
    nuisance, size = _fitted_nuisance(state)
    mine = nuisance[chosen]
    return np.asarray(rows - nuisance @ np.linalg.solve(mine.T @ mine + np.diag(1.0 / size**2), mine.T @ rows[chosen]))


def covariance_of(
    state: SelectionState, x: F64, rows: F64, chosen: Mask, left: Layout | None = None, known: F64 | None = None
) -> F64:
    """Of the coefficients: noise, and what is neither known nor fitted (Schmidt's consider parameters, 1966).

    `left`: whose noise the rows have; without it they are taken as they are.  `known` (n,): information on each
    coefficient that does not come from the rows.
    """
    count = x.shape[1]
    if count == 0:
        return np.zeros((0, 0))
    nuisance, size = _fitted_nuisance(state)
    both = np.hstack([x, nuisance])
    prior = np.concatenate([np.zeros(count) if known is None else known, 1.0 / size**2])
    covariance = _sandwich(state, both, rows, chosen, prior, left)[:count, :count]
    told = state.point.nuisance_fitted
    steady = _steady(state.point.layout)
    other = np.hstack([state.point.nuisance[:, ~told], steady])
    scale = np.concatenate([state.point.nuisance_size[~told], np.full(steady.shape[1], STEADY_MPS2)])
    gram = both[chosen].T @ both[chosen] + np.diag(prior)
    shift = (inverse(gram) @ (both[chosen].T @ other[chosen]))[:count] * scale
    return np.asarray(covariance + shift @ shift.T)


@lru_cache(maxsize=4)
def _steady(layout: Layout) -> F64:
    """(R, 3) whitened columns of a force that stays in the body: it only widens intervals."""
    columns = [np.zeros((*ok.shape, 3)) for ok in layout.ok]
    for each in columns:
        axes = range(min(3, each.shape[1]))
        each[:, axes, axes] = 1.0
    return layout.stack(columns)


def inverse(gram: F64) -> F64:
    """Of a normal matrix with columns of very different size, some of them nothing."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.asarray(np.linalg.pinv(gram / np.outer(size, size), rcond=1e-10, hermitian=True) / np.outer(size, size))


def _sandwich(state: SelectionState, x: F64, rows: F64, chosen: Mask, prior: F64, left: Layout | None) -> F64:
    """Sandwich over time: scores of all channels at one time belong together, neighbours by Bartlett weights."""
    layout = state.point.layout
    xs, e = x[chosen], rows[chosen]
    gram = xs.T @ xs + np.diag(prior)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverted = inverse(gram)
    scores = xs * e[:, None]
    middle = np.diag(prior)
    for flight in np.unique(layout.flight[chosen]):
        mine = layout.flight[chosen] == flight
        at = layout.at[chosen][mine]
        series = np.zeros((int(at.max()) + 1, xs.shape[1]))
        np.add.at(series, at, scores[mine])
        lags = max(1, round(_BAND_S * state.bench.rate(int(flight))))
        middle += series.T @ series
        for k in range(1, min(lags, len(series) - 1) + 1):
            cross = series[k:].T @ series[:-k]
            middle += (1.0 - k / (lags + 1.0)) * (cross + cross.T)
    sandwich = inverted @ middle @ inverted
    # never narrower than the noise would make it; what the flights don't see at all has no variance here
    seen = (np.diag(sandwich) > 0.0) & (size > 1e-100)
    least = np.diag(inverted)
    if left is not None:
        least = np.maximum(least, np.diag(inverted @ (_coloured(layout, left, xs, chosen) + np.diag(prior)) @ inverted))
    root = np.sqrt(np.maximum(1.0, least / np.where(seen, np.diag(sandwich), 1.0))) * seen
    return np.asarray(sandwich * np.outer(root, root))


def _coloured(layout: Layout, left: Layout, x: F64, chosen: Mask) -> F64:
    """(n, n) covariance of the scores of columns (R, n) where the noise is what `left` says, channel by channel.

    Rows whitened by one model of noise of the other are that noise through one filter and the other's inverse: the
    scores' covariance is that of the columns passed backwards through the same.
    """
    total = np.zeros((x.shape[1], x.shape[1]))
    for f, channels in enumerate(layout.whiteners):
        for c, whitener in enumerate(channels):
            mine, noise = (layout.flight[chosen] == f) & (layout.channel[chosen] == c), left.whiteners[f][c]
            if not mine.any() or not noise.usable:
                continue
            series = np.zeros((len(layout.ok[f]), x.shape[1]))
            series[layout.at[chosen][mine]] = x[mine]
            passed = through(whitener.taps * (noise.sigma / whitener.sigma), noise.stable_taps, series[::-1])
            total += passed.T @ passed
    return total


def segments(state: SelectionState, chosen: Mask) -> NDArray[np.int64]:
    """(R,) segment number of each row to learn from, others -1: flights cut into stretches of equal length."""
    layout = state.point.layout
    number = np.full(len(layout.at), -1)
    flights = np.unique(layout.flight)
    each = max(1, round(_SEGMENTS / len(flights)))
    count = 0
    for flight in flights:
        mine = chosen & (layout.flight == flight)
        if not mine.any():
            continue
        edges = np.quantile(layout.at[mine], np.linspace(0.0, 1.0, each + 1)[1:-1])
        number[mine] = count + np.searchsorted(edges, layout.at[mine])
        count += each
    return number


def _constancy(state: SelectionState, made: Estimates, rows: F64, chosen: Mask) -> tuple[F64, F64]:
    """`same` of all segments; what does not itself push to one side all the time, whatever pushes so in each segment.

    A tilt between two instruments that wanders by a degree is a push of 0.17 m/s^2 that changes from minute to minute:
    a drag must not change with it.
    """
    slots, x = made.slots, made.x
    if not slots:
        return np.empty(0), np.empty(0)
    number = segments(state, chosen)
    allowed = variation(state.start, made.vehicle, slots, made.values)
    pushes = np.array([effect in STEADY_PUSHES for effect, _ in slots])
    side = np.hstack([x, _steady(state.point.layout)[:, :2]])
    told = [
        (by_segment(x, rows, number, allowed), pushes),
        (by_segment(side, rows, number, allowed), ~pushes),
    ]
    p_value, between = np.ones(len(slots)), np.zeros(len(slots))
    for (theta, variance), mine in told:
        if len(theta) >= 2 and mine.any():
            p_value[mine], between[mine] = (each[mine] for each in same(theta, variance, allowed))
    return p_value, between


def by_segment(x: F64, rows: F64, number: NDArray[np.int64], allowed: F64) -> tuple[F64, F64]:
    """(k, n) coefficients of each segment, and their variances, of the first n columns of x (R, n or more)."""
    count = len(allowed)
    prior = np.full(x.shape[1], 1.0 / _PUSH_MPS2**2)
    prior[:count] = 1e-2 / np.maximum(allowed, 1e-300)
    estimates, variances = [], []
    for k in range(number.max() + 1):
        mine = number == k
        if mine.sum() < 10 * count:
            continue
        inverted = np.linalg.inv(x[mine].T @ x[mine] + np.diag(prior))
        estimates.append((inverted @ (x[mine].T @ rows[mine]))[:count])
        variances.append(2.0 * np.diag(inverted)[:count])
    return np.array(estimates), np.array(variances)


def variation(start: Vehicle, vehicle: Vehicle, slots: Sequence[tuple[str, str]], values: F64) -> F64:
    """(n,) variance of each parameter that a good model of a good vehicle may show from place to place."""
    origin = np.array([_origin(start, e, p, v) for (e, p), v in zip(slots, values, strict=True)])
    slack = np.array([negligible(vehicle, e, p) for e, p in slots])
    return np.asarray((TENTH * (values - origin)) ** 2 + slack**2)


def same(theta: F64, variance: F64, allowed: F64) -> tuple[F64, F64]:
    """Of parameters (k, n) told k times: p-value of their being the same, and the variance between them (n,) each.

    The p-value allows small differences (Cochran's Q), the variance does not (DerSimonian and Laird's).
    """
    q, _ = _heterogeneity(theta, variance + allowed)
    freedom = len(theta) - 1
    plain, weight = _heterogeneity(theta, np.maximum(variance, 1e-300))
    total = weight.sum(axis=0)
    between = (plain - freedom) / np.maximum(total - (weight**2).sum(axis=0) / total, 1e-300)
    return chi2_tails(freedom, q), np.maximum(between, 0.0)


def _heterogeneity(theta: F64, variance: F64) -> tuple[F64, F64]:
    weight = 1.0 / variance
    mean = (weight * theta).sum(axis=0) / weight.sum(axis=0)
    return (weight * (theta - mean) ** 2).sum(axis=0), weight


def _origin(start: Vehicle, effect: str, parameter: str, now: float) -> float:
    origin = value(start, effect, parameter)
    return origin if np.isfinite(origin) else now


def parameter_change(state: SelectionState, made: Estimates) -> F64:
    """(n,) how far each coefficient is from where it started; 0 for one that started nowhere."""
    origin = np.array([value(state.start, *slot) for slot in made.slots])
    return np.where(np.isfinite(origin), made.values - np.nan_to_num(origin), 0.0)
