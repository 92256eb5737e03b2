"""What the flights say against a vehicle: named, refined, judged on held-out data, and what stays unexplained.

Every step is a file of this package; here is only what passes between naming and verdict, and which names are taken
back on the way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from flightstack.effects import EFFECTS
from flightstack.gap import airspeed, estimator_bias, instruments, pooled
from flightstack.gap.across import Told, confirmed, differing
from flightstack.gap.blown import with_turbulence
from flightstack.gap.classes import beside_a_poor_model, confused_with, doubled, in_classes, without_motors
from flightstack.gap.decisions import HALF, MOSTLY, NAME_EVIDENCE, TENTH
from flightstack.gap.held import (
    corrected,
    fails_holdout,
    far_from_noise,
    interval_contains_nominal,
    mass_for_thrust,
    surrogate_terms,
    told_by_signals,
)
from flightstack.gap.likeness import vehicle_mismatch
from flightstack.gap.name import EVERYWHERE, Selection, name
from flightstack.gap.naming.estimate import fills
from flightstack.gap.pooled import FitHoldoutSplit
from flightstack.gap.records import Gap, IdentifiedEffect, Samples
from flightstack.gap.refine import refine
from flightstack.gap.verdict import closed_by_channel, closed_power, gap_of, unexplained
from flightstack.types import InputError
from flightstack.vehicle import Vehicle

OnProgress = Callable[[float, str], None]
Said = tuple[Selection, FitHoldoutSplit, Gap]
"""A verdict: what is named, on which rows, and the gap that is left."""


def silent(share: float, phase: str) -> None:
    """Tells nobody."""


def concluded(
    vehicle: Vehicle,
    of: FitHoldoutSplit,
    called: str,
    on_progress: OnProgress = silent,
    *,
    closely: bool = False,
    margin: float = NAME_EVIDENCE,
) -> Said:
    """What is named, refined and judged by the held-out part of these flights, and what stays unexplained.

    `closely`, `margin`: of `name`.
    """
    on_progress(0.2, "naming")
    naming = name(vehicle, of.flights, of.fit, of.holdout, closely=closely, margin=margin)
    taken, (naming, of, gap) = of, _judged(vehicle, naming, of, on_progress)
    doubted = naming.found or naming.unexplained.significant or gap.closed is not None
    if doubted and any(early := instruments.early_s(naming.vehicle, taken.flights, taken.fit)):
        taken = replace(taken, flights=instruments.moved(taken.flights, early))
        naming = name(vehicle, taken.flights, taken.fit, taken.holdout, closely=closely, margin=margin)
        naming, of, gap = _judged(vehicle, naming, taken, on_progress)
    naming, of, gap = _without_loop_noise(vehicle, naming, of, gap, [s.command_late_s for s in taken.flights])
    naming, of, gap = _same_in_each(vehicle, naming, of, gap)
    felt = told_by_signals(vehicle, naming.found, of)
    if naming.found and _is_worse(gap):
        naming, of, gap = _with_mass_for_thrust(vehicle, naming, of, gap)
    if naming.found and (_is_worse(gap) or (naming.unexplained.significant and closed_power(gap) < HALF)):
        gone = {f.name for f in naming.found} - (set() if _is_worse(gap) else confirmed(naming.across) | felt)
        naming = naming.without(gone, "leaves most of the gap as it was") if gone else naming
        gap = held_out_gap(vehicle, naming, of)
    carried = naming.with_guessed_numbers()
    if carried is not naming:
        naming = carried
        gap = held_out_gap(vehicle, naming, of)
    unlike = vehicle_mismatch(vehicle, naming.vehicle, naming.found, unexplained=naming.unexplained.significant)
    if unlike:
        raise InputError(
            f"log {of.flights[0].name}: this log does not look like {called}: {unlike}; name the file of the vehicle "
            "that flew"
        )
    if naming.found and gap.closed is not None and gap.closed < MOSTLY:
        if not naming.unexplained.significant:
            naming = naming.with_unexplained(1.0 - gap.closed)  # it may have acted on held-out data only
        here = naming.unexplained.depends_on[:1] == ("position",)
        worse = _is_worse(gap, 1.0)
        gone = {f.name for f in naming.found if (here and f.name in EVERYWHERE) or worse} - felt
        if gone:
            naming = naming.without(gone, "what it explains depends on something else as well")
            gap = held_out_gap(vehicle, naming, of)
    naming, gap = with_turbulence(vehicle, naming, without_bias(naming, of), gap)
    naming = replace(naming, unexplained=unexplained(naming.unexplained, gap, named=bool(naming.found)))
    if naming.can_be_fitted and not naming.found and not naming.unexplained.significant:
        learned = held_out_gap(vehicle, naming, replace(of, fit=of.holdout, holdout=of.fit))
        naming = replace(naming, unexplained=unexplained(naming.unexplained, learned, named=False))
    return naming, of, gap


def _without_loop_noise(
    vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit, gap: Gap, centre_s: Sequence[float]
) -> Said:
    """The names less those of which nothing is left by instruments that a loop's noise does not reach.

    Beside something unexplained instruments are bent by it as well.
    """
    if naming.found and not naming.unexplained.significant and not far_from_noise(gap):
        # a refined moment of acting holds a part of the delay
        logged = [replace(s, command_late_s=late_s) for s, late_s in zip(of.flights, centre_s, strict=True)]
        as_logged = replace(of, flights=tuple(logged))
        flights = without_bias(naming, as_logged).flights
        late = instruments.delay_for_lag(vehicle, naming.vehicle, naming.found, flights, of.fit)
        if late is not None:
            (old,) = late.indistinguishable_from
            found = tuple(late if f.name == old else f for f in naming.found)
            exchanged = replace(naming, found=found, vehicle=corrected(vehicle, found))
            naming, of = _refined(vehicle, exchanged, as_logged)
            gap = held_out_gap(vehicle, naming, of)
    while naming.found and not naming.unexplained.significant and not far_from_noise(gap):
        flights = without_bias(naming, of).flights
        wide, alone = instruments.compared(vehicle, naming.vehicle, naming.found, flights, of.fit, centre_s)
        gone = interval_contains_nominal(alone or ())
        gone = gone or tuple(f.name for f in alone or () if instruments.is_trifling(vehicle, f))
        gone = gone or interval_contains_nominal(wide)
        if not gone:
            naming = replace(naming, found=wide)
            break
        left = naming.without(gone[-1:], "nothing of it is sure without the noise that the loop feeds back")
        naming, of = _refined(vehicle, replace(left, unexplained=naming.unexplained), of)
        gap = held_out_gap(vehicle, naming, of)
    return naming, of, gap


def _refined(
    vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit, effects: Sequence[str] | None = None
) -> tuple[Selection, FitHoldoutSplit]:
    """The named effects' parameters (or some) by output error through the simulator, and when commands really acted."""
    used = [k for k, mask in enumerate(of.fit) if mask.any() and not without_motors([of.flights[k]])]
    if not used:
        return naming, of
    flights, masks = [of.flights[k] for k in used], [of.fit[k] for k in used]
    names = [found.name for found in naming.found] if effects is None else effects
    fixed = _fixed(naming) | airspeed.lost(naming.vehicle, flights, masks, names) | estimator_bias.lost(flights, names)
    refined = refine(vehicle, naming.vehicle, flights, masks, names, fixed)
    if refined is None:
        return naming, of
    told = refined.parameters
    hidden = [(e, p) for e, own in told.items() for p, x in own.items() if fills(vehicle, (e, p), x.low, x.high)]
    if hidden:
        return _refined(vehicle, naming.without_telling(hidden), of, effects)
    found = tuple(
        replace(each, parameters={**each.parameters, **refined.parameters.get(each.name, {})}) for each in naming.found
    )
    late = dict(zip(used, refined.late_s, strict=True))
    moved = tuple(replace(s, command_late_s=late.get(k, s.command_late_s)) for k, s in enumerate(of.flights))
    return replace(naming, found=found, vehicle=refined.vehicle), replace(of, flights=moved)


def _same_in_each(vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit, gap: Gap) -> Said:
    """Names that are not the same in each of several flights are taken back, clearest first, the others fitted anew.

    With several flights, or far from the noise, intervals reach as far as flights and their stretches differ.
    """
    while len(of.flights) > 1 and naming.found:
        refined = _to_refine(naming, gap)
        naming = naming.in_each_flight([_alone(vehicle, naming, s, refined) for s in of.flights])
        gone = [name for name in differing(naming.across) if name in {f.name for f in naming.found}]
        if not gone:
            break
        naming, of, gap = fitted_without(vehicle, (naming, of, gap), gone[:1], "is not the same in each flight")
    if len(of.flights) == 1 and not far_from_noise(gap):
        return naming, of, gap
    naming = naming.as_wide_as_it_varies()
    while unsure := interval_contains_nominal(naming.found):
        reason = "is not sure to be there: it differs that much from stretch to stretch"
        naming, of, gap = fitted_without(vehicle, (naming, of, gap), unsure[-1:], reason)
        naming = naming.as_wide_as_it_varies()
    return naming, of, gap


def fitted_without(vehicle: Vehicle, said: Said, gone: Sequence[str], reason: str) -> Said:
    """The verdict less these names, the others fitted and refined again."""
    naming, of, gap = said
    naming = naming.without(gone, reason)
    names = _to_refine(naming, gap)
    naming, of = _refined(vehicle, naming, of, names) if names else (naming, of)
    return naming, of, held_out_gap(vehicle, naming, of)


def _to_refine(naming: Selection, gap: Gap) -> list[str]:
    """Far from the noise only forces are: torques answer what a rate loop does, forces don't."""
    return [f.name for f in naming.found if not far_from_noise(gap) or EFFECTS[f.name].kind == "force"]


def _alone(vehicle: Vehicle, naming: Selection, samples: Samples, effects: Sequence[str]) -> Told:
    """What one flight says of these effects by output error."""
    if not effects:
        return {}
    fixed = _fixed(naming) | airspeed.lost(naming.vehicle, [samples], [samples.valid], effects)
    fixed |= estimator_bias.lost([samples], effects)
    refined = refine(vehicle, naming.vehicle, [samples], [samples.valid], effects, fixed)
    if refined is None:
        return {}
    return {(effect, p): e for effect, own in refined.parameters.items() for p, e in own.items()}


def _fixed(naming: Selection) -> set[tuple[str, str]]:
    return {(f.name, p) for f in naming.found for p, e in f.parameters.items() if not e.told}


def _judged(vehicle: Vehicle, named: Selection, of: FitHoldoutSplit, on_progress: OnProgress) -> Said:
    """The names that hold on data not used before, refined, and the gap with them.

    Refinement trusts the structure.  Where the model stays far from the noise, only what clearly matters is named,
    and the naming's own estimates stand but for forces: torques answer what a rate loop does, forces don't.
    """
    on_progress(0.6, "refining")
    named = _merged(named)
    # of several parameters none may surely be off, and yet all together
    while gone := interval_contains_nominal([f for f in named.found if len(f.parameters) == 1]):
        named = _without_last(named, gone, "nothing of it is left once all are estimated together")
    if not named.found:
        moved = of if named.unexplained.significant else _refined(vehicle, named, of)[1]
        return named, moved, held_out_gap(vehicle, named, moved)
    naming, moved = _refined(vehicle, named, of)
    on_progress(0.75, "verifying")
    while gone := interval_contains_nominal(
        naming.found
    ):  # one by one: of two that are alike each is nothing beside the other
        named = _without_last(named, gone, "nothing of it is left once all are refined")
        naming, moved = _refined(vehicle, named, of)
    gone = fails_holdout(vehicle, naming.found, without_bias(naming, moved), beside=naming.unexplained.significant)
    if gone:
        named = named.without(gone, "does something else on data not used before")
        naming, moved = _refined(vehicle, named, of)
    gap = held_out_gap(vehicle, naming, moved)
    if not naming.found or not far_from_noise(gap):
        return naming, moved, gap
    named = _beside_a_poor_model(vehicle, named)
    named = _merged(named.with_classes_of_a_poor_model())
    forces = _to_refine(named, gap)
    named, of = _refined(vehicle, named, of, forces) if forces else (named, of)
    return named, of, held_out_gap(vehicle, named, of)


def _without_last(named: Selection, gone: Sequence[str], reason: str) -> Selection:
    """The verdict less the weakest of these; beside others nothing is missing for it."""
    left = named.without(gone[-1:], reason)
    return replace(left, unexplained=named.unexplained) if left.found else left


def _merged(named: Selection) -> Selection:
    """The verdict with one name for each class: what the logs can't tell from a stronger name is its twin."""
    gone = doubled(named.found, named.vehicle)
    return (
        replace(named.without(gone, "these logs can't tell it from what is named"), unexplained=named.unexplained)
        if gone
        else named
    )


def _beside_a_poor_model(vehicle: Vehicle, named: Selection) -> Selection:
    """What stands for something else or hardly matters is taken back; what the former stood for may join, one by one.

    One beside which any of the names stands for something else does not.
    """
    stood: list[IdentifiedEffect] = []
    while gone := (proxy := surrogate_terms(vehicle, named.found, named.constant)) or named.trifles():
        stood += [f for f in named.found if f.name in proxy]
        named = named.without(gone, "stands for something else, or changes hardly what is left")
    open_ = confused_with(stood) - {f.name for f in stood}
    while open_ and named.found and (more := named.forward_selection_step(open_)) is not None:
        (new,) = {f.name for f in more.found} - {f.name for f in named.found}
        open_.remove(new)
        if not surrogate_terms(vehicle, more.found, more.constant):
            named = more.with_twins(new, tuple(f.name for f in stood if new in confused_with([f])))
    return named


def _with_mass_for_thrust(vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit, gap: Gap) -> Said:
    """The verdict with a mass for a thrust scale that closes force but makes turning worse; else as it was.

    Beside a poor model the two are one class: both say how hard the rotors pull a kilogram.  A thrust scales what turns
    the vehicle as well, and there a wrong inertia, or rows too rare for a rate loop, speak louder.
    """
    found = in_classes(mass_for_thrust(vehicle, naming.found), of.flights)
    if not found or closed_by_channel(gap).get("force", 0.0) < HALF:
        return naming, of, gap
    now = replace(naming, found=tuple(beside_a_poor_model(f) for f in found), vehicle=corrected(vehicle, found))
    after = held_out_gap(vehicle, now, of)
    better = not _is_worse(after) and closed_power(after) >= closed_power(gap) - TENTH
    return (now, of, after) if better else (naming, of, gap)


def _is_worse(gap: Gap, times: float = (1.0 + TENTH)) -> bool:
    """Whether the corrected model predicts data not used before worse than the model as it was."""
    pairs = [(getattr(gap.before, name), getattr(gap.after, name)) for name in ("one_step_mps2", "one_step_radps2")]
    return any(was is not None and now is not None and now > times * was for was, now in pairs)


def held_out_gap(vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit) -> Gap:
    """The gap that these names leave on the held-out part of these flights."""
    of = without_bias(naming, of)
    before = pooled.figures(vehicle, of)
    after = pooled.figures(naming.vehicle, of) if naming.found else before
    floor = pooled.noise_floor(naming.vehicle, of, after)
    return gap_of(before, after, floor)


def without_bias(naming: Selection, of: FitHoldoutSplit) -> FitHoldoutSplit:
    """The flights less what an estimator believed of its accelerometer's bias, as these names leave it."""
    return replace(of, flights=tuple(estimator_bias.with_bias(naming.vehicle, s) for s in of.flights))
