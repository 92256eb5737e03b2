"""Turbulence among the names, and what of the others holds against it.

Gusts have a mean and a drift over any minute.  As noise they make a wind look as if it changed with time, and it is
taken back; as a steady wind their mean would be named with an interval far too narrow.  So what the search has found
is fitted anew beside the gusts (`gap.gusts`), and an effect that was taken back is named after all where it is more
than gusts make.  A wind beside gusts is told by its own size against what their mean may be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap import pooled
from flightstack.gap.chances import chi2_tail
from flightstack.gap.classes import splitting_manoeuvre, together
from flightstack.gap.decisions import CHANCE_P, GUST_SPREAD_OUT, MOSTLY, NOT_WORSE, RARE_P
from flightstack.gap.estimator_bias import with_bias
from flightstack.gap.gusts import Gusts, as_found, gusts
from flightstack.gap.held import far_from_noise, upright
from flightstack.gap.name import Selection
from flightstack.gap.naming.estimate import CI, within_range
from flightstack.gap.pooled import FitHoldoutSplit
from flightstack.gap.records import Estimate, Gap, IdentifiedEffect, Unexplained
from flightstack.gap.simulate import FreeParameter, free_parameters, value, with_value
from flightstack.gap.verdict import ONE_STEP, gap_of, is_open
from flightstack.vehicle import Vehicle

_WIND = "steady_wind"
_FORCE = "constant_force"
"""Through a drag that is the same on every axis a wind is one: where the gusts leave both open, they are twins."""
_LOAD = "payload"
"""What a wind that blows up or down may be, and its twins."""
_LOADS = ("thrust_scale", "constant_force")


def with_turbulence(vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit, gap: Gap) -> tuple[Selection, Gap]:
    """Turbulence where it explains what is left of the force, and the names that hold beside it."""
    if not is_open(gap) or "turbulence" in vehicle.effects or not naming.can_be_fitted:
        return naming, gap
    if far_from_noise(
        gap, ONE_STEP[1:], MOSTLY
    ):  # gusts act through drag: they don't make a turning that nothing explains
        return naming, gap
    held = {f.name for f in naming.found}
    back = [f for f in naming.proposed if f.name not in {*held, _WIND} and EFFECTS[f.name].told_by_force]
    kept = [f for f in naming.found if f.name != _WIND]
    wind = [_proposed(vehicle, naming, _WIND)]
    told = _beside(vehicle, naming, of, [*kept, *back, *wind], {f.name for f in (*back, *wind)} | ({_FORCE} & held))
    if told is None and back:  # what was taken back may stand for gusts itself
        told = _beside(vehicle, naming, of, [*kept, *wind], {f.name for f in wind})
    if told is not None and any(upright(f) for f in told[0].found) and not held & {_LOAD, *_LOADS}:
        load = _proposed(vehicle, naming, _LOAD)
        told = _beside(vehicle, naming, of, [*kept, load, *wind], {_LOAD, _WIND})
    if told is None or any(upright(f) for f in told[0].found):  # no steady wind goes through the ground
        return naming, gap
    named, blown, twins = told
    of = replace(of, flights=tuple(with_bias(named.vehicle, s) for s in of.flights))
    after = pooled.figures(named.vehicle, of)
    most = blown.sigma_mps.high / blown.sigma_mps.estimate  # how hard it blew on held-out data nobody knows better
    made = (most * blown.force_rms_mps2, most * blown.turning_rms_radps2)
    floor = pooled.noise_floor(named.vehicle, of, after, made)
    if any(_is_worse(*(getattr(of_all, name) for of_all in (after, gap.after, floor))) for name in ONE_STEP):
        return naming, gap
    still, least = after.one_step_mps2, pooled.noise_floor(named.vehicle, of, after).one_step_mps2
    found = as_found(blown, 0.0 if still is None or least is None else still**2 - least**2)
    manoeuvre = splitting_manoeuvre((found.name, *twins)) if twins else ""
    found = replace(found, indistinguishable_from=twins, manoeuvre=manoeuvre)
    corrected = with_value(named.vehicle, found.name, {p: e.estimate for p, e in found.parameters.items()})
    rejected = tuple(r for r in named.rejected if r.name != found.name)
    whole = (*named.found, found)
    return replace(named, found=whole, vehicle=corrected, rejected=rejected, unexplained=Unexplained(False)), gap_of(
        gap.before, after, floor
    )


def _beside(
    vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit, found: list[IdentifiedEffect], tested: set[str]
) -> tuple[Selection, Gusts, tuple[str, ...]] | None:
    """The names that hold beside gusts, the gusts, and what their mean can't be told from; None if there are none.

    Of the `tested` the least certain goes first, and the others are fitted again without it.
    """
    flights = [replace(s, bias_frd_mps2=None) for s in of.flights]  # as slow as gusts: told beside them, not before
    masks = [s.valid for s in flights]
    unsure: Gusts | None = None
    alike: dict[str, str] = {}
    while True:
        named = naming.with_only(found)
        turned = [knob for f in found for knob in free_parameters(f.name, _whole(f))]
        blown = gusts(named.vehicle, flights, masks, turned)
        if blown is None or not blown.named:
            return None
        chance = {f.name: _chance(vehicle, named.vehicle, f, turned, blown) for f in found if f.name in tested}
        worst = max(chance, key=lambda name: chance[name], default="")
        if not worst or chance[worst] <= RARE_P:
            break
        if {_WIND, _FORCE} <= {name for name, p in chance.items() if p > RARE_P}:
            alike = {_WIND: _FORCE, _FORCE: _WIND}
        if worst == _WIND and chance[worst] < CHANCE_P:
            unsure = blown
        found = [f for f in found if f.name != worst]
    slow = [f for f in named.found if f.name == _WIND or EFFECTS[f.name].told_by_force]
    for f in slow:
        named = _by_gusts(vehicle, named, f, turned, blown)
    if len(both := {f.name for f in slow} & alike.keys()) == 1:
        (one,) = both
        named = named.with_twins(one, (alike[one],))
    if unsure is not None:
        return named, replace(blown, sigma_mps=unsure.sigma_mps, length_m=unsure.length_m), (_WIND,)
    return named, blown, ()


def _chance(
    vehicle: Vehicle, at: Vehicle, found: IdentifiedEffect, turned: Sequence[FreeParameter], blown: Gusts
) -> float:
    """Probability of the flights if this effect were as the file has it, gusts being what they are (Wald's test)."""
    count, statistic = _wald(vehicle, at, found, turned, blown)
    if not count:
        return 0.0 if found.name != _WIND else 1.0  # no force shows it: it is not gusts that it may be
    return chi2_tail(count, statistic / _spread_out(found))


def _spread_out(found: IdentifiedEffect) -> float:
    """By how much beside gusts the variance of an effect's parameters is larger than their likelihood says.

    Gusts change the airspeed that it goes with, or the thrust; a wind and a steady force don't care.
    """
    return 1.0 if found.name in (_WIND, _FORCE) else GUST_SPREAD_OUT


def _wald(
    vehicle: Vehicle, at: Vehicle, found: IdentifiedEffect, turned: Sequence[FreeParameter], blown: Gusts
) -> tuple[int, float]:
    """How many parameters of the effect the force shows, and their squared distance from the file's in errors."""
    mine = [k for k, knob in enumerate(turned) if knob.effect == found.name and blown.covariance[k, k] > 0.0]
    if not mine:
        return 0, 0.0
    own = [turned[k].parameter for k in mine]
    start = np.nan_to_num([value(vehicle, found.name, p) for p in own])
    off = np.array([value(at, found.name, p) for p in own]) + blown.beside[mine] - start
    size = np.sqrt(np.diag(blown.covariance)[mine])
    scaled = np.linalg.pinv(blown.covariance[np.ix_(mine, mine)] / np.outer(size, size), rcond=1e-9, hermitian=True)
    return len(mine), float((off / size) @ scaled @ (off / size))


def _by_gusts(
    vehicle: Vehicle, naming: Selection, found: IdentifiedEffect, turned: Sequence[FreeParameter], blown: Gusts
) -> Selection:
    """The verdict with this effect's parameters as they are beside gusts.

    Its interval would be too narrow where `_spread_out` says so.
    """
    spread = math.sqrt(_spread_out(found))
    parameters: dict[str, Estimate] = {}
    for k, knob in enumerate(turned):
        if knob.effect == found.name:
            now = value(naming.vehicle, knob.effect, knob.parameter) + float(blown.beside[k])
            reach = spread * CI * float(np.sqrt(blown.covariance[k, k]))
            before = value(vehicle, knob.effect, knob.parameter)
            told = within_range(naming.vehicle, knob.effect, knob.parameter, now)
            parameters[knob.parameter] = Estimate(before, told, now - reach, now + reach)
    moved = with_value(naming.vehicle, found.name, {p: e.estimate for p, e in parameters.items()})
    own = replace(found, parameters=parameters)
    if not found.delta_bic:  # it was not the search that found it
        count, statistic = _wald(vehicle, naming.vehicle, found, turned, blown)
        own = replace(own, delta_bic=-statistic, p_value=chi2_tail(count, statistic) if count else 1.0)
    names = tuple(own if f.name == found.name else f for f in naming.found)
    return replace(naming, found=names, vehicle=moved)


def _is_worse(now: float | None, was: float | None, blown: float | None) -> bool:
    """Whether a figure is worse than it was, by more than gusts may make it: of long ones a wind takes the mean."""
    return now is not None and was is not None and now > NOT_WORSE * max(was, blown or 0.0)


def _proposed(vehicle: Vehicle, naming: Selection, effect: str) -> IdentifiedEffect:
    """The effect as it was found, or as the file has it; a load is nothing that a thrust or a force is not."""
    for f in (*naming.found, *naming.proposed):
        if f.name == effect:
            return f
    own = {knob.parameter: value(vehicle, effect, knob.parameter) for knob in free_parameters(effect)}
    made = IdentifiedEffect(effect, {p: Estimate(x, x, x, x) for p, x in own.items()}, 0.0, float("nan"), 1.0)
    return together(made, _LOADS) if effect == _LOAD else made


def _whole(found: IdentifiedEffect) -> dict[str, float]:
    return {p.name: found.parameters[p.name].estimate for p in EFFECTS[found.name].params if p.integer}
