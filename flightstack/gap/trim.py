"""How weak a rotor is, by what a flight's commands hold in the mean: lift and the two tilting torques must balance.

Without a gyro, turning comes from an attitude that is itself an estimate: fast rows tell a rotor's size badly, and
their errors are alike in all of them.  The mean of many seconds is sound: a vehicle that stays in the air is held by
its rotors, so each must give what its command says times what is left of it.  In: a verdict that leaves something
unexplained on flights without a gyro; out: its weak rotor at the size that balances, or the verdict as it was.

Residuals are linear in the rotors' gains, so five simulations do: y(g) = y(1) + sum (1 - g_i) B_i, with g_i = s for
whole rotors and s e for the weak one, least squares for s and s e over (lift, roll, pitch).

Measured on CrazyPAD (Masalimov et al., Data 2024; a Crazyflie with propeller M3 cut): 12 flights with whole propellers
need one rotor at 0.86 to 0.97 of the others; with 1 mm off both blades it is 0.84 to 0.90, 2 mm 0.72 to 0.81, 2.5 mm
0.74, 3 mm 0.65, 4 mm 0.63 to 0.66; flights of one propeller differ by 0.04.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.classes import has_gyro, in_classes, without_motors
from flightstack.gap.compare import residual
from flightstack.gap.concluded import Said, held_out_gap
from flightstack.gap.decisions import HALF, MOSTLY, SMALL_SHARE, SURE_ERRORS, TENTH
from flightstack.gap.held import corrected
from flightstack.gap.name import Selection
from flightstack.gap.pooled import FitHoldoutSplit, stretch
from flightstack.gap.records import Estimate, IdentifiedEffect, Rejected
from flightstack.gap.verdict import closed_power, unexplained
from flightstack.types import F64
from flightstack.vehicle import Vehicle, with_effects

_CHANNELS = [2, 3, 4]
"""Lift, and the accelerations of roll and pitch.  Yaw is no balance: what trims it is in no vehicle file."""
_ROTORS = (1, 2, 3, 4)
_STEP = 0.5
_STRETCHES = 6
_WEAK = MOSTLY - TENTH
"""Weaker than any rotor of the 12 whole vehicles above (0.86)."""
_STANDS_FOR = frozenset(
    ("thrust_scale", "payload", "rotor_fault", "com_offset", "thrust_curve", "battery_sag", "constant_force",
     "steady_wind", "translational_lift", "blade_flapping", "induced_inflow", "parasitic_drag", "angular_damping")
)  # fmt: skip
"""What a hover's balance is told as where a rotor is weak."""
Masks = Sequence[NDArray[np.bool_]]


class _Trim(NamedTuple):
    """A balance: which rotor, what is left of it, and what all of them give."""

    rotor: int
    effectiveness: float
    scale: float
    left: float
    """Sum of squares that stays."""


def told_by_trim(vehicle: Vehicle, said: Said) -> Said:
    """The verdict with its weak rotor as the mean commands tell it; `said` where they tell none, or it closes nothing.

    A weak rotor that was not named must be weaker than rotors of whole vehicles are, and balance held-out rows, too.
    """
    naming, of, before = said
    known = {"thrust_scale", "rotor_fault"} & set(vehicle.effects)
    if known or not naming.unexplained.significant or has_gyro(of.flights) or without_motors(of.flights):
        return said
    named = any(f.name == "rotor_fault" for f in naming.found)
    found = _Balance(vehicle, of).found(naming, named=named)
    if not found:
        return said
    kept = tuple(f for f in naming.found if f.name not in _STANDS_FOR)
    all_found = in_classes((*found, *kept), of.flights)
    names = {f.name for f in all_found}
    gone = [Rejected(f.name, f.delta_bic, "a weak rotor balances the mean commands") for f in naming.found]
    rejected = (*naming.rejected, *gone)
    now = replace(
        naming,
        found=all_found,
        vehicle=corrected(vehicle, all_found),
        rejected=tuple(r for r in rejected if r.name not in names),
    )
    gap = held_out_gap(vehicle, now, of)
    if closed_power(gap) < max(HALF, closed_power(before) - SMALL_SHARE if naming.found else HALF):
        return said
    return replace(now, unexplained=unexplained(naming.unexplained, gap, named=True)), of, gap


class _Balance:
    """What the flights' rows say of the rotors' gains: residuals as the file has them, and their slopes."""

    def __init__(self, vehicle: Vehicle, of: FitHoldoutSplit) -> None:
        changed = [with_effects(vehicle, {"rotor_fault": {"rotor": k, "effectiveness": _STEP}}) for k in _ROTORS]
        self._of = of
        self._whole = [residual(vehicle, s).y[:, _CHANNELS] for s in of.flights]
        self._turned = [[residual(other, s).y[:, _CHANNELS] for s in of.flights] for other in changed]

    def found(self, naming: Selection, *, named: bool) -> tuple[IdentifiedEffect, ...]:
        """The weak rotor, and the common scale of all; nothing where no rotor balances the rows."""
        fit, held = (self._means(masks) for masks in (self._of.fit, self._of.holdout))
        if fit is None or held is None:
            return ()
        best = min((_solved(fit, k) for k in _ROTORS), key=lambda each: each.left)
        alone = _solved(fit, 0)
        judged = [_left(held, best.rotor, best.effectiveness, best.scale), _left(held, 0, 1.0, alone.scale)]
        balanced = best.left <= HALF**2 * alone.left and judged[0] <= HALF * judged[1]
        if judged[1] <= 0.0 or not (named or (balanced and best.effectiveness <= _WEAK)):
            return ()
        weak, scale = self._with_intervals(best.rotor)
        if weak.high >= 1.0:
            return ()
        evidence = {r.name: r.delta_bic for r in naming.rejected} | {f.name: f.delta_bic for f in naming.proposed}
        gain = 1.0 - math.sqrt(judged[0] / judged[1])
        rotor = Estimate(1.0, float(best.rotor), float(best.rotor), float(best.rotor))
        parts = {"rotor_fault": {"rotor": rotor, "effectiveness": weak}}
        if not scale.low <= 1.0 <= scale.high:
            parts["thrust_scale"] = {"scale": scale}
        return tuple(IdentifiedEffect(n, p, evidence.get(n, 0.0), gain, 0.0) for n, p in parts.items())

    def _with_intervals(self, rotor: int) -> tuple[Estimate, Estimate]:
        """What is left of a rotor and the scale by all rows; 95 % intervals as wide as stretches and flights differ."""
        masks = [fit | held for fit, held in zip(self._of.fit, self._of.holdout, strict=True)]
        stretches = (self._means([stretch(mask, k, _STRETCHES) for mask in masks]) for k in range(_STRETCHES))
        told = [_solved(means, rotor) for means in (self._means(masks), *stretches) if means is not None]
        out = []
        for value, *others in ([t.effectiveness for t in told], [t.scale for t in told]):
            error = float(np.std(others, ddof=1)) / math.sqrt(len(others)) if len(others) > 1 else math.inf
            width = math.hypot(SMALL_SHARE, SURE_ERRORS * error)
            out.append(Estimate(1.0, value, max(value - width, 0.0), value + width))
        return out[0], out[1]

    def _means(self, masks: Masks) -> F64 | None:
        """(5, 3): residual and slopes of the rotors' gains over these rows, in units that make lift and tilt alike."""
        rows = [
            np.concatenate([y[m & np.isfinite(y).all(axis=1)] for y, m in zip(ys, masks, strict=True)])
            for ys in (self._whole, *self._turned)
        ]
        if min(map(len, rows)) == 0:
            return None
        means = np.array([each.mean(axis=0) for each in rows])
        slopes = (means[1:] - means[0]) / (1.0 - _STEP)
        size = np.array([np.abs(slopes[:, 0]).sum(), np.abs(slopes[:, 1]).max(), np.abs(slopes[:, 2]).max()])
        scaled: F64 = np.vstack([means[0], slopes]) / np.maximum(size, 1e-9)
        return scaled


def _solved(means: F64, rotor: int) -> _Trim:
    """Least squares for the common scale and what is left of this rotor, at most all; 0: of none."""
    weak = means[rotor] if rotor else np.zeros(3)
    rest = means[1:].sum(axis=0) - weak
    whole = means[0] + means[1:].sum(axis=0)
    x = np.column_stack([rest, weak]) if rotor else rest[:, None]
    gains = np.linalg.lstsq(x, whole, rcond=None)[0]
    scale = float(gains[0])
    effectiveness = float(gains[1] / scale) if rotor and scale > 0.0 else 1.0
    if not 0.0 <= effectiveness <= 1.0:
        return _solved(means, 0)._replace(rotor=rotor)
    return _Trim(rotor, effectiveness, scale, _left(means, rotor, effectiveness, scale))


def _left(means: F64, rotor: int, effectiveness: float, scale: float) -> float:
    gains = np.full(4, scale)
    if rotor:
        gains[rotor - 1] *= effectiveness
    return float(np.sum((means[0] + (1.0 - gains) @ means[1:]) ** 2))
