"""Classes of effects that this log can't tell apart, and the manoeuvre that would split them.

Two effects are alike on a log when exchanging one for the other, everything else fitted again, costs less than the
evidence can bear; nothing is taken from a list.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from flightstack.gap.airspeed import moves
from flightstack.gap.decisions import ALIKE_EVIDENCE, ALIKE_SHARE, HALF
from flightstack.gap.naming.candidates import members
from flightstack.gap.naming.design import layout_of
from flightstack.gap.naming.evidence import fit_subsets, score
from flightstack.gap.naming.search import Fit, SelectionState, fit_subset
from flightstack.gap.records import IdentifiedEffect, Samples
from flightstack.gap.simulate import value, with_value
from flightstack.gap.track import track
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle

_TRIED = 4


def alternatives(state: SelectionState, best: Fit, effect: str) -> tuple[str, ...]:
    """Effects that would explain the flights as well in this one's place, closest first."""
    point = state.point
    base = [m for m in members(point.candidates, best.effects) if point.candidates[m].effect != effect]
    excluded = state.excluded | set(best.effects)
    others = [m for m, c in enumerate(point.candidates) if c.effect not in excluded]
    gram = point.gram()
    subsets = [tuple(sorted((*base, m))) for m in others]
    fitted = fit_subsets(gram, [tuple(base), *subsets], point.columns, point.low, point.high)
    explained = max(gram.c - fitted[0].gain - best.chi2, 0.0)
    bearable = ALIKE_EVIDENCE + ALIKE_SHARE * explained
    count = len(point.candidates)
    scored = sorted(
        (gram.c + float(score(-0.0, s.used, len(s.members), gram.rows, count)) - s.gain, i)
        for i, s in enumerate(fitted[1:])
        if np.isfinite(s.gain)
    )
    found: dict[str, Fit] = {}
    rest = set(best.effects) - {effect}
    for fit in state.fits.values():  # to first order alike, what was fitted already may lie where no line leads to
        if len(fit.effects) == len(best.effects) and rest < set(fit.effects) and fit.score - best.score < bearable:
            (name,) = set(fit.effects) - rest
            if name not in excluded:
                found[name] = min(found.get(name, fit), fit, key=lambda each: each.score)
    for least, i in scored[:_TRIED]:
        if least > best.score + 3.0 * bearable + 0.05 * explained:
            break
        name = point.candidates[others[i]].effect
        fit = fit_subset(state, fitted[1 + i])
        if fit.score - best.score < bearable:
            found[name] = min(found.get(name, fit), fit, key=lambda each: each.score)
    as_plain = _as_plain(state, best, effect, [fit.vehicle for fit in found.values()])
    found = {name: fit for (name, fit), good in zip(found.items(), as_plain, strict=True) if good}
    return tuple(sorted(found, key=lambda name: found[name].score))


def _as_plain(state: SelectionState, best: Fit, effect: str, others: Sequence[Vehicle]) -> list[bool]:
    """Which of these vehicles explain most of what the effect does of the rows as they are, slow parts and means too.

    Whitened rows hardly count what lasts: beside something unexplained a weak rotor passed there for a load that had
    nine tenths of the lift, of which the rotor had nothing.
    """
    if not others:
        return []
    without = state.start
    for name, values in best.effects.items():
        without = without if name == effect else with_value(without, name, values)
    rows = state.bench.residual(best.vehicle)
    layout = layout_of(state.bench, rows, coloured=False)
    learned = layout.keep & ~layout.held

    def left(values: list[F64]) -> float:
        return float(np.sum(layout.stack(values)[learned] ** 2))

    most = left(state.bench.residual(without))
    explained = most - left(rows)
    return [most - left(state.bench.residual(other)) >= HALF * explained for other in others]


POORLY_TOLD = (("motor_lag", "transport_delay"), ("rotor_fault", "com_offset"), ("payload", "thrust_scale"))
"""How late rotors are in all shows, which part of it is lag is a matter of the response's shape; a weak rotor and a
shifted mass both tip a hovering vehicle, what tells them apart is yaw and how the tipping changes with thrust; a
mass and a thrust scale differ in the torques only.  It takes a gyro, and a model that leaves little else."""


DRAGS = ("linear_drag", "rotor_drag", "parasitic_drag")
_ORDER = ("linear_drag", "rotor_drag")


def poorly_told(effects: Collection[str]) -> set[str]:
    """What beside a poor model can't be told from one of these."""
    return {e for pair in POORLY_TOLD if set(pair) & set(effects) for e in pair} - set(effects)


def beside_a_poor_model(found: IdentifiedEffect) -> IdentifiedEffect:
    """A named effect of a model far from the noise: its class holds what only a good model tells from it.

    So it is with a drag's order: of 45 flights of one Crazyflie (NanoBench) 24 were told a linear drag, 21 one of the
    rotors, most of them as sure.
    """
    for effects in (*POORLY_TOLD, _ORDER):
        found = together(found, effects) if found.name in effects else found
    return (
        together(found, ("com_offset",)) if found.name == "blade_flapping" else found
    )  # drag above the centre of mass


def confused_with(gone: Collection[IdentifiedEffect]) -> set[str]:
    """What these names may have stood for: their twins, and what a manoeuvre is told for that splits them."""
    names = {f.name for f in gone}
    groups = (group for group, _ in _SPLITS if group & names)
    return {twin for f in gone for twin in f.indistinguishable_from}.union(*groups) - names


def has_gyro(flights: Sequence[Samples]) -> bool:
    """Whether any of the flights has one: without it what is poorly told is one class."""
    return any("rate_frd_radps" not in track(s).missing for s in flights)


def without_motors(flights: Sequence[Samples]) -> bool:
    """Whether none of the flights has commands that say more than their mean."""
    return all("motor" in track(s).missing for s in flights)


def in_classes(found: tuple[IdentifiedEffect, ...], flights: Sequence[Samples]) -> tuple[IdentifiedEffect, ...]:
    """The named effects of these flights: without a gyro their classes are those of a poor model.

    Without motors no drag's order is told: how the rotors' speed goes with the air's is what parts them.  Nor is a drag
    that the file has told from the mass that it brakes.
    """
    if not has_gyro(flights):
        found = tuple(beside_a_poor_model(f) for f in found)
    if not any(moves(s) for s in flights):
        # Drag at the hubs of a vehicle that only turns; of one that only rises and sinks.
        turns, sinks = ("rotor_drag",), ("linear_drag", "parasitic_drag")
        twins = {"angular_damping": turns, "induced_inflow": sinks}
        found = tuple(together(f, twins.get(f.name, ())) for f in found)
    if without_motors(flights):
        found = tuple(together(f, (*DRAGS, *_braked(f))) if f.name in DRAGS else f for f in found)
    return found


def _braked(found: IdentifiedEffect) -> tuple[str, ...]:
    return ("payload",) if any(e.before > 0.0 for e in found.parameters.values()) else ()


def together(found: IdentifiedEffect, others: tuple[str, ...]) -> IdentifiedEffect:
    """The effect with all of these as its twins."""
    twins = tuple(dict.fromkeys((*found.indistinguishable_from, *(e for e in others if e != found.name))))
    if twins == found.indistinguishable_from:
        return found
    return replace(found, indistinguishable_from=twins, manoeuvre=splitting_manoeuvre((found.name, *twins)))


def doubled(found: Sequence[IdentifiedEffect], vehicle: Vehicle) -> tuple[str, ...]:
    """Named effects (strongest first) that the logs can't tell from a stronger one that is named too.

    A force, or a wind on the vertical drag, that holds up more than half of what a named payload weighs or a named
    thrust scale takes (or pulls down what it adds) is none either: both together are thrust that answers commands less
    than it should, round the same mean.  `vehicle` has what is named.
    """
    gone = [
        weaker.name
        for k, weaker in enumerate(found)
        for other in found[:k]
        if weaker.name in other.indistinguishable_from and other.name in weaker.indistinguishable_from
    ]
    of = {f.name: f.parameters for f in found}
    carried_kg = of["payload"]["mass_kg"].estimate if "payload" in of else 0.0
    lost = 1.0 - of["thrust_scale"]["scale"].estimate if "thrust_scale" in of else 0.0
    weight_n = STANDARD_GRAVITY_MPS2 * (carried_kg + lost * vehicle.mass_kg)
    if weight_n and "constant_force" in of:
        down_n = of["constant_force"]["down_n"].estimate
        gone += ["constant_force"] if -down_n * np.sign(weight_n) > HALF * abs(weight_n) else []
    if weight_n and "steady_wind" in of:
        down_n = of["steady_wind"]["down_mps"].estimate * value(vehicle, "linear_drag", "d_z_kgps")
        gone += ["steady_wind"] if -down_n * np.sign(weight_n) > HALF * abs(weight_n) else []
    return tuple(dict.fromkeys(gone))


def splitting_manoeuvre(effects: tuple[str, ...]) -> str:
    """What to fly so that these effects part."""
    for group, text in _SPLITS:
        if set(effects) <= group or len(group & set(effects)) >= 2:
            return text
    return "rate doublets on all axes, a thrust chirp and a fast run on two opposite headings"


_SPLITS: tuple[tuple[frozenset[str], str], ...] = (
    (
        frozenset({"motor_lag", "transport_delay", "inertia"}),
        "rate doublets and a thrust chirp up to 8 Hz, motors and gyro logged at 250 Hz",
    ),
    (
        frozenset({"steady_wind", "constant_force", "accelerometer_bias", "attitude_misalignment", "com_offset"}),
        "the same line at two speeds to and fro, then hover while turning by half a turn",
    ),
    (
        frozenset({"linear_drag", "rotor_drag", "parasitic_drag", "induced_inflow"}),
        "straight runs at three airspeeds, and the same speed in hard turns (the rotors' speed must change)",
    ),
    (
        frozenset({"payload", "thrust_scale", "battery_sag", "thrust_curve", "constant_force", "rotor_fault"}),
        "rate doublets and a thrust chirp: torques tell thrust from mass; repeat with a fresh and an empty battery",
    ),
    (
        frozenset({"ground_effect", "thrust_scale", "payload", "vortex_ring"}),
        "low passes at half, one and two rotor diameters over the ground, and a steady descent",
    ),
    (
        frozenset({"com_offset", "rotor_fault", "blade_flapping"}),
        "climb hard and hover by turns: a shifted mass turns with the thrust, a weak rotor yaws as well",
    ),
)
