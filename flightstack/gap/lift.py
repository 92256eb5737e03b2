"""How strong all rotors are, by what holds the vehicle up in the mean.

Fast rows tell a thrust by how force and turning follow the commands, and turning, where a rotor is weak or the mass
sits off, may pull that far from what carries the vehicle: rows weighed by a coloured noise hardly count a mean.  In: a
verdict that leaves something unexplained; out: with the thrust scale that balances the mean vertical force, where what
is named leaves a tenth of the weight or more of it (where no scale is named, half: a spring or a cord may carry less),
alike on all stretches of the flights and on held-out data; else the verdict as it was.

Of four gentle flights of a Crazyflie under Vicon, whose commands ask for 1.9 to 2.0 times its weight all the time, the
scale was told as 0.01, 0.16 and 0.38, and not at all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.classes import together, without_motors
from flightstack.gap.compare import residual
from flightstack.gap.concluded import Said, fitted_without, held_out_gap
from flightstack.gap.decisions import HALF, SMALL_SHARE, SURE_ERRORS, TENTH
from flightstack.gap.held import corrected
from flightstack.gap.pooled import FitHoldoutSplit, stretch
from flightstack.gap.records import Estimate, IdentifiedEffect
from flightstack.gap.verdict import closed_power, unexplained
from flightstack.types import STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle, with_effects

_VERTICAL = 2
_STRETCHES = 6
_SCALES = (1.0, 0.5)
"""Two at which the vertical force is looked at: it is a straight line in the scale."""
Mask = NDArray[np.bool_]


def told_by_lift(vehicle: Vehicle, said: Said) -> Said:
    """The verdict with the thrust scale that carries the vehicle, where what is named does not; else `said`."""
    naming, of, before = said
    known = {"thrust_scale", "payload"} & set(vehicle.effects) or any(f.name == "payload" for f in naming.found)
    known = known or {"rotors.max_thrust_n", "body.mass_kg"} & set(vehicle.ranges)  # what is guessed is fitted
    if known or not naming.unexplained.significant or without_motors(of.flights):
        return said
    named = any(f.name == "thrust_scale" for f in naming.found)
    scale = _balancing(naming.vehicle, of, least_mps2=(TENTH if named else HALF) * STANDARD_GRAVITY_MPS2)
    if scale is None:
        return _without_what_lifts_nothing(vehicle, said)
    others = tuple(f for f in naming.found if f.name != "thrust_scale")
    evidence = {r.name: r.delta_bic for r in naming.rejected} | {f.name: f.delta_bic for f in naming.found}
    found = (_named(scale, evidence.get("thrust_scale", 0.0), of, naming.vehicle), *others)
    now = replace(
        naming,
        found=found,
        vehicle=corrected(vehicle, found),
        rejected=tuple(r for r in naming.rejected if r.name != "thrust_scale"),
    )
    gap = held_out_gap(vehicle, now, of)
    if closed_power(gap) < max(HALF, closed_power(before)):
        return said
    return replace(now, unexplained=unexplained(naming.unexplained, gap, named=True)), of, gap


def _without_what_lifts_nothing(vehicle: Vehicle, said: Said) -> Said:
    """The verdict less a thrust scale with which all rotors at full command would not lift the vehicle."""
    scale = next((f.parameters["scale"].estimate for f in said[0].found if f.name == "thrust_scale"), 1.0)
    if scale * vehicle.max_total_thrust_n >= vehicle.weight_n or scale >= 1.0:
        return said
    naming, of, gap = fitted_without(vehicle, said, ("thrust_scale",), "at full command the rotors would not lift it")
    left = unexplained(naming.unexplained, gap, named=bool(naming.found))
    return replace(naming, unexplained=left), of, gap


def _named(scale: Estimate, evidence: float, of: FitHoldoutSplit, was: Vehicle) -> IdentifiedEffect:
    off = _off(was, of, of.holdout)
    now = IdentifiedEffect("thrust_scale", {"scale": scale}, evidence, min(1.0, abs(off) / STANDARD_GRAVITY_MPS2), 0.0)
    return together(now, ("payload",))


def _balancing(vehicle: Vehicle, of: FitHoldoutSplit, *, least_mps2: float) -> Estimate | None:
    """The scale that leaves no mean vertical force, its interval as wide as stretches differ; None where the model
    leaves less than this now, no scale does it everywhere, or the vehicle would not fly with it."""
    with_scale = [with_effects(vehicle, {"thrust_scale": {"scale": s}}) for s in _SCALES]
    both = [fit | held for fit, held in zip(of.fit, of.holdout, strict=True)]
    parts: list[Sequence[Mask]] = [[stretch(mask, k, _STRETCHES) for mask in both] for k in range(_STRETCHES)]
    told, left = [], []
    for masks in (of.fit, of.holdout, both, *parts):
        now, *at = (_off(each, of, masks) for each in (vehicle, *with_scale))
        slope = (at[1] - at[0]) / (_SCALES[1] - _SCALES[0])
        if not math.isfinite(now) or not slope:
            return None
        told.append(_SCALES[0] - at[0] / slope)
        left.append(now)
    fit, held, best, *stretches = told
    error = float(np.std(stretches, ddof=1)) / math.sqrt(_STRETCHES)
    width = math.hypot(SMALL_SHARE * best, SURE_ERRORS * error)
    off = min(abs(each) for each in left) >= least_mps2 and len({each > 0.0 for each in left}) == 1
    alike = abs(held - fit) <= TENTH * best and width <= TENTH * best
    flies = best * vehicle.max_total_thrust_n > vehicle.weight_n
    if not (off and alike and flies) or best - width <= 1.0 <= best + width:
        return None
    return Estimate(1.0, best, best - width, best + width)


def _off(vehicle: Vehicle, of: FitHoldoutSplit, masks: Sequence[Mask]) -> float:
    return _mean([residual(vehicle, s).y[m] for s, m in zip(of.flights, masks, strict=True)])


def _mean(rows: Sequence[NDArray[np.float64]]) -> float:
    each = np.concatenate([y[:, _VERTICAL] for y in rows])
    each = each[np.isfinite(each)]
    return float(np.mean(each)) if len(each) else math.nan
