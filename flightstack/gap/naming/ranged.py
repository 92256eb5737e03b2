"""Intervals of named effects where numbers of the vehicle file are only guessed, and the class of the common scale.

A number that the file gives as a range stays where it is in the fit; how far the estimates move with what the range
and the flights together leave of it is added to their covariance (Schmidt's consider parameters, 1966).  Where an
effect is named that is itself such a number under another name (a payload for the mass), the effect carries the
uncertainty.

Mass, thrust, inertia and drag times two fly alike.  Where effects correct several of them and nothing that is known
fixes the scale, ranges (or how well such numbers are usually guessed) say where on that line the estimate stands, and
the intervals reach as far as they do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flightstack.file_numbers import FileNumber, file_numbers, with_numbers
from flightstack.gap.decisions import ALIKE_COSINE
from flightstack.gap.naming.candidates import fitted
from flightstack.gap.naming.design import layout_of
from flightstack.gap.naming.estimate import CI, covariance_of, inverse, without_nuisance
from flightstack.gap.naming.search import SelectionState
from flightstack.gap.records import Estimate, IdentifiedEffect
from flightstack.gap.simulate import FreeParameter, spec_of, value, with_value
from flightstack.types import F64
from flightstack.vehicle import Vehicle

STANDS_FOR = {
    ("payload", "mass_kg"): "body.mass_kg",
    ("thrust_scale", "scale"): "rotors.max_thrust_n",
    ("thrust_curve", "thrust_model_factor"): "rotors.thrust_model_factor",
    ("motor_lag", "time_constant_s"): "rotors.time_constant_s",
    **{("inertia", f"scale_{axis}"): f"body.inertia_kgm2[{i}]" for i, axis in enumerate("xyz")},
}
"""Effects' parameters that are one of the file's numbers under another name."""
_SCALED = ("payload", "thrust_scale", "inertia")
_USUAL = {"body.mass_kg": 0.3, "rotors.max_thrust_n": 0.5, "body.inertia_kgm2": 0.7}
"""Relative half width within which a plain number of these is taken to lie once an effect contradicts it."""
_STEP = 1e-3
WEIGH = "weigh the vehicle: no acceleration shows the common scale of mass, thrust, inertia and drag"


def is_touched(start: Vehicle, found: Sequence[IdentifiedEffect]) -> bool:
    """Whether guessed numbers or the common scale concern these names."""
    return bool(found) and (bool(start.ranges) or sum(f.name in _SCALED for f in found) > 1)


def carried(
    state: SelectionState, found: tuple[IdentifiedEffect, ...], vehicle: Vehicle
) -> tuple[tuple[IdentifiedEffect, ...], Vehicle]:
    """The names with what guessed numbers do to them, and the vehicle at their estimates; `vehicle` holds them."""
    start, layout, chosen = state.start, state.point.layout, state.point.fit_rows()
    told = {(f.name, p) for f in found for p, e in f.parameters.items() if e.told}
    slots = [(f.name, p) for f in found for p in fitted(vehicle, f.name, vehicle.effects[f.name]).parameters]
    slots = [slot for slot in slots if slot in told]
    numbers = {n.name: n for n in file_numbers(start)}
    raw = state.bench.columns(vehicle, [FreeParameter(e, p) for e, p in slots])
    x = layout.stack([np.nan_to_num(columns) for columns in raw])
    now = np.array([value(vehicle, e, p) for e, p in slots])
    centre, sigma = np.array([_prior(numbers, e, p, v) for (e, p), v in zip(slots, now, strict=True)]).T
    known = np.where(np.isfinite(sigma), 1.0 / np.maximum(sigma, 1e-300) ** 2, 0.0)
    left = layout_of(state.bench, state.bench.residual(vehicle), coloured=True)
    rows = without_nuisance(state, layout.stack(state.bench.residual(vehicle)), chosen)
    covariance = covariance_of(state, x, rows, chosen, left, known)
    mine = x[chosen]
    inverted = inverse(mine.T @ mine + np.diag(known))
    shift = inverted @ (known * (centre - now))
    named = {STANDS_FOR.get(slot, "") for slot in slots}
    guessed = [n for n in numbers.values() if n.is_ranged and n.name not in named]
    if guessed:
        moves = layout.stack([np.nan_to_num(c) for c in _number_columns(state, vehicle, guessed)])
        both, all_known = np.hstack([x, moves]), np.append(known, [12.0 / (n.high - n.low) ** 2 for n in guessed])
        wide = covariance_of(state, both, rows, chosen, left, all_known)
        asked = both[chosen].T @ rows[chosen] + np.append(known * (centre - now), np.zeros(len(guessed)))
        off = (inverse(both[chosen].T @ both[chosen] + np.diag(all_known)) @ asked)[len(slots) :]
        reach = inverted @ (mine.T @ moves[chosen])
        covariance = covariance + reach @ (wide[len(slots) :, len(slots) :] + np.outer(off, off)) @ reach.T
    return _told(found, vehicle, slots, now + shift, covariance)


def as_twins_read(start: Vehicle, found: tuple[IdentifiedEffect, ...]) -> tuple[IdentifiedEffect, ...]:
    """The names with intervals that hold for a mass's and a thrust's reading alike, where no log tells which it is.

    A thrust scale of 0.8 in a payload's place leaves forces, moments and inertias 0.8 of what they are beside the
    payload.
    """
    named = {f.name: f for f in found}
    factor = 1.0
    if "thrust_scale" in named and "payload" not in named and "payload" in named["thrust_scale"].indistinguishable_from:
        factor = 1.0 / max(named["thrust_scale"].parameters["scale"].estimate, _STEP)
    elif "payload" in named and "thrust_scale" not in named:
        if "thrust_scale" in named["payload"].indistinguishable_from:
            factor = start.total_mass_kg / (start.total_mass_kg + named["payload"].parameters["mass_kg"].estimate)
    if factor == 1.0:
        return found
    return tuple(f if f.name in ("payload", "thrust_scale") else _also_times(f, factor) for f in found)


def _also_times(found: IdentifiedEffect, factor: float) -> IdentifiedEffect:
    """The effect with intervals of what goes with the common scale that hold this many times as much as well."""
    parameters = dict(found.parameters)
    for name, e in found.parameters.items():
        unit = spec_of(found.name, name).unit
        if e.told and e.low < e.high and (found.name == "inertia" or "kg" in unit or unit.startswith("N")):
            ends = (e.low, e.high, e.low * factor, e.high * factor)
            parameters[name] = replace(e, low=min(ends), high=max(ends))
    return replace(found, parameters=parameters)


def _prior(numbers: dict[str, FileNumber], effect: str, parameter: str, now: float) -> tuple[float, float]:
    """Centre and deviation of a parameter by what the file knows of its number; infinite where it knows nothing."""
    number = numbers.get(STANDS_FOR.get((effect, parameter), ""))
    if number is None:
        return now, np.inf
    low, high = number.low, number.high
    if not number.is_ranged:
        if number.key not in _USUAL:
            return now, np.inf
        low, high = number.value * (1.0 - _USUAL[number.key]), number.value * (1.0 + _USUAL[number.key])
    if effect == "payload":
        low, high = low - number.value, high - number.value
    elif effect in ("thrust_scale", "inertia"):
        low, high = low / number.value, high / number.value
    return 0.5 * (low + high), (high - low) / np.sqrt(12.0)


def _number_columns(state: SelectionState, vehicle: Vehicle, numbers: Sequence[FileNumber]) -> list[F64]:
    """Derivatives of the simulated (N, 12, K) of each flight by numbers of the file."""
    columns = []
    for number in numbers:
        step = _STEP * (number.high - number.low)
        ends = max(number.value - step, number.minimum), min(number.value + step, number.maximum)
        less, more = (state.bench.residual(with_numbers(vehicle, {number: end})) for end in ends)
        columns.append([(b - a) / (ends[0] - ends[1]) for a, b in zip(less, more, strict=True)])
    return [np.stack(flight, axis=-1) for flight in zip(*columns, strict=True)]


def _told(
    found: tuple[IdentifiedEffect, ...], vehicle: Vehicle, slots: list[tuple[str, str]], values: F64, covariance: F64
) -> tuple[tuple[IdentifiedEffect, ...], Vehicle]:
    """The names at these values, intervals as wide as before or as this covariance; classes of what goes together."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    alike = np.abs(covariance) > ALIKE_COSINE * np.maximum(np.outer(sigma, sigma), 1e-300)
    place = {slot: k for k, slot in enumerate(slots)}
    out, changed = [], vehicle
    for each in found:
        parameters = dict(each.parameters)
        twins: set[str] = set()
        for name, e in each.parameters.items():
            k = place.get((each.name, name))
            if k is None:
                continue
            spec = spec_of(each.name, name)
            now = float(np.clip(values[k], spec.minimum, spec.maximum))
            half = max(0.5 * (e.high - e.low), CI * float(sigma[k]))
            parameters[name] = Estimate(e.before, now, max(now - half, spec.minimum), min(now + half, spec.maximum))
            twins |= {slots[j][0] for j in np.flatnonzero(alike[k]) if slots[j][0] in _SCALED} - {each.name}
        changed = with_value(changed, each.name, {p: e.estimate for p, e in parameters.items()})
        if each.name in _SCALED and twins:
            all_twins = tuple(dict.fromkeys((*each.indistinguishable_from, *sorted(twins))))
            out.append(replace(each, parameters=parameters, indistinguishable_from=all_twins, manoeuvre=WEIGH))
        else:
            out.append(replace(each, parameters=parameters))
    return tuple(out), changed
