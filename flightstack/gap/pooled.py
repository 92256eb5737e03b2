"""Figures over several flights: what each flight shows, weighted by how much of it was looked at."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from flightstack.gap import compare
from flightstack.gap.decisions import GAP_FROM, GUARD_S, HELD_SHARE, SMALL_SHARE
from flightstack.gap.records import Figures, Samples
from flightstack.gap.sampled import sampling_floor
from flightstack.types import F64, I64
from flightstack.vehicle import Vehicle

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class FitHoldoutSplit:
    """The flights and what of each is learned from and judged by."""

    flights: tuple[Samples, ...]
    fit: tuple[Mask, ...]
    """(N,) by flight."""
    holdout: tuple[Mask, ...]
    """(N,) by flight, at least 2 s away from `fit`."""


def split(flights: Sequence[Samples], kept: Sequence[Samples], *, first: bool = False) -> FitHoldoutSplit:
    """Flights to learn from and flights that were kept; without any kept, the last (or first) third of each one."""
    if kept:
        whole = [np.array(s.valid) for s in (*flights, *kept)]
        chosen = [k < len(flights) for k in range(len(whole))]
        fit = tuple(m & c for m, c in zip(whole, chosen, strict=True))
        return FitHoldoutSplit((*flights, *kept), fit, tuple(m & ~f for m, f in zip(whole, fit, strict=True)))
    parts = [_third(s, first=first) for s in flights]
    return FitHoldoutSplit(tuple(flights), tuple(fit for fit, _ in parts), tuple(held for _, held in parts))


def _third(samples: Samples, *, first: bool) -> tuple[Mask, Mask]:
    rows = np.flatnonzero(samples.valid)
    if not len(rows):
        nothing = np.zeros(len(samples.t_s), np.bool_)
        return nothing, nothing
    begin, end = float(samples.t_s[rows[0]]), float(samples.t_s[rows[-1]])
    if first:
        kept = samples.t_s < begin + HELD_SHARE * (end - begin)
        learned = samples.t_s >= begin + HELD_SHARE * (end - begin) + GUARD_S
    else:
        kept = samples.t_s >= end - HELD_SHARE * (end - begin)
        learned = samples.t_s < end - HELD_SHARE * (end - begin) - GUARD_S
    return samples.valid & learned, samples.valid & kept


def split_by_power(vehicle: Vehicle, flights: Sequence[Samples]) -> FitHoldoutSplit | None:
    """The last third of each flight's squared disagreement held out; None where that is about its last third."""
    parts, later = [], False
    for s in flights:
        rows = np.flatnonzero(s.valid)
        power = np.cumsum(_off_by(vehicle, s, rows))
        if not len(rows) or power[-1] <= 0.0:
            return None
        begin = float(s.t_s[rows[np.searchsorted(power, (1.0 - HELD_SHARE) * power[-1])]])
        parts.append((s.valid & (s.t_s < begin - GUARD_S), s.valid & (s.t_s >= begin)))
        later = later or begin > float(s.t_s[np.flatnonzero(_third(s, first=False)[1])[0]]) + GUARD_S
    return FitHoldoutSplit(tuple(flights), *zip(*parts, strict=True)) if later else None


def split_by_passes(vehicle: Vehicle, flights: Sequence[Samples]) -> FitHoldoutSplit | None:
    """The last of several times at which a flight is off held out, a third of its disagreement or one such time.

    A vehicle that passes low over the ground in one third of its flight only shows nothing of it in the others.  None
    where no flight is off at two times, seconds apart; another is cut by its time.
    """
    cuts = [_between_passes(vehicle, s) for s in flights]
    if all(cut is None for cut in cuts):
        return None
    parts = [
        _third(s, first=False) if cut is None else (s.valid & (s.t_s < cut - GUARD_S), s.valid & (s.t_s >= cut))
        for s, cut in zip(flights, cuts, strict=True)
    ]
    return FitHoldoutSplit(tuple(flights), *zip(*parts, strict=True))


def _between_passes(vehicle: Vehicle, samples: Samples) -> float | None:
    """When (s) the first begins of those times that are held out."""
    rows = np.flatnonzero(samples.valid)
    if not len(rows):
        return None
    second = (samples.t_s[rows] - samples.t_s[rows[0]]).astype(int)
    count = np.maximum(np.bincount(second), 1)
    power = np.bincount(second, _off_by(vehicle, samples, rows)) / count
    above = np.maximum(power - GAP_FROM * np.median(power), 0.0)
    busy = np.flatnonzero(above > SMALL_SHARE * above.max())
    passes = np.split(busy, np.flatnonzero(np.diff(busy) > 1 + math.ceil(GUARD_S)) + 1)
    if len(passes) < 2:
        return None
    share = np.cumsum([above[each].sum() for each in passes]) / above[busy].sum()
    first_held = min(int(np.searchsorted(share, 1.0 - HELD_SHARE)) + 1, len(passes) - 1)
    return float(samples.t_s[rows[0]]) + float(passes[first_held][0])


def _off_by(vehicle: Vehicle, samples: Samples, rows: I64) -> F64:
    """(rows,) squared disagreement of force and turning, in units of the sensors' noise."""
    y = compare.residual(vehicle, samples)
    noise = np.where(y.noise > 0.0, y.noise, np.inf)
    found: F64 = np.sum(np.nan_to_num(y.y[rows] / noise)[:, :6] ** 2, axis=1)
    return found


def stretch(mask: Mask, k: int, count: int) -> Mask:
    """The k-th of `count` stretches of these rows, alike in number."""
    out = np.zeros_like(mask)
    out[np.array_split(np.flatnonzero(mask), count)[k]] = True
    return out


def figures(vehicle: Vehicle, of: FitHoldoutSplit) -> Figures:
    """The held-out figures of the simulator of this vehicle."""
    return _pooled(of, lambda samples, mask: compare.figures(vehicle, samples, mask))


def noise_floor(
    vehicle: Vehicle, of: FitHoldoutSplit, after: Figures, gusts: tuple[float, float] = (0.0, 0.0)
) -> Figures:
    """The held-out figures of a simulator without any error: the sensors' noise, and what sampling hides of commands.

    Gusts that are named (`gusts`: specific force, angular acceleration) belong to it: nobody knows when one blows.
    How much sampling hides is known as an upper bound only (a log may hold every command), and what gusts make here
    and now is not known either: what is left in `after` is counted as that up to the bound, never more.
    """
    sensors = _pooled(of, lambda samples, mask: compare.noise_floor(vehicle, samples, mask))
    hidden = _pooled(of, lambda samples, mask: sampling_floor(vehicle, samples, mask))
    known = (hidden.one_step_mps2, hidden.one_step_radps2)
    force, turning = (h if h is None else math.hypot(h, gust) for h, gust in zip(known, gusts, strict=True))
    return Figures(
        _with(sensors.one_step_mps2, force, after.one_step_mps2),
        _with(sensors.one_step_radps2, turning, after.one_step_radps2),
        _reached(_with(sensors.rollout_1s_m, hidden.rollout_1s_m, after.rollout_1s_m), after.rollout_1s_m),
    )


def _with(sensors: float | None, hidden: float | None, after: float | None) -> float | None:
    if sensors is None or hidden is None or after is None:
        return sensors
    return min(math.hypot(sensors, hidden), max(sensors, after))


def _reached(floor: float | None, after: float | None) -> float | None:
    """A path's floor: what was reached is no less than it (a coarse log's IMU says more of the path than there is)."""
    return floor if floor is None or after is None else min(floor, after)


def _pooled(of: FitHoldoutSplit, figures_of: Callable[[Samples, Mask], Figures]) -> Figures:
    rows = [
        (int(mask.sum()), figures_of(samples, mask))
        for samples, mask in zip(of.flights, of.holdout, strict=True)
        if mask.any()
    ]
    return Figures(*(_rms([(n, getattr(f, field.name)) for n, f in rows]) for field in fields(Figures)))


def _rms(rows: list[tuple[int, float | None]]) -> float | None:
    known = [(n, value) for n, value in rows if value is not None and math.isfinite(value)]
    if not known:
        return None
    return math.sqrt(sum(n * value * value for n, value in known) / sum(n for n, _ in known))
