"""Whether a named effect does on data not used before what it did where it was learned.

Without the effect, the held-out disagreement is what the effect makes there and what is left anyway.  If the
effect is really there and of the size that was found, the slope of the one against the other is 1 wherever one looks; a
proxy's slope falls away, and what grows with time shows a slope beyond 1 on what was flown last.  The slope's error is
of the sandwich kind over seconds, so that a slow remainder is not taken for many errors.

Where a model leaves much more than noise, an effect may only trim what the model lacks: one is taken back if its size
changes from stretch to stretch, or if it stands at the end of what is plausible for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap.compare import residual
from flightstack.gap.decisions import CLEAR_SHARE, CLEARLY, FICKLE_P, HALF, SURE_ERRORS
from flightstack.gap.naming.candidates import at_end
from flightstack.gap.pooled import FitHoldoutSplit
from flightstack.gap.records import Estimate, Gap, IdentifiedEffect
from flightstack.gap.simulate import with_value
from flightstack.gap.verdict import ONE_STEP
from flightstack.types import F64
from flightstack.vehicle import Vehicle

_BLOCK_S = 1.0
_FEWEST_BLOCKS = 4
KINEMATIC = ((6, 7, 8), (9, 10, 11))
"""Columns in which no physics acts: the gyro against the attitude, the accelerometer against the velocity."""


@dataclass(frozen=True, slots=True)
class Slope:
    """Slope of the held-out disagreement against what effects make of it, and its standard error."""

    value: float
    error: float

    def holds(self, *, beside: bool) -> bool:
        """Whether the effects do what they did; `beside`: something that nothing explains is there as well."""
        low, high = (CLEAR_SHARE, 1.0 / CLEAR_SHARE) if beside else (HALF, np.inf)
        return self.value + SURE_ERRORS * self.error >= low and self.value - SURE_ERRORS * self.error <= high


def slope(without: Vehicle, corrected: Vehicle, of: FitHoldoutSplit) -> Slope:
    """Of the held-out residual of `without` against what `corrected` makes of it; 1 +- 0 where that can't be said."""
    shares: list[F64] = []
    pairs = []
    for samples, mask in zip(of.flights, of.holdout, strict=True):
        if not mask.any():
            continue
        was, now = residual(without, samples).y[mask], residual(corrected, samples).y[mask]
        pairs.append((np.nan_to_num(was), np.nan_to_num(now), max(1, round(_BLOCK_S / samples.dt_s))))
    if not pairs:
        return Slope(1.0, 0.0)
    left = np.sqrt(np.mean(np.concatenate([now for _, now, _ in pairs]) ** 2, axis=0))
    weight = np.where(left > 0.0, 1.0 / np.maximum(left, 1e-12), 0.0)
    for was, now, size in pairs:
        made, rest = (was - now) * weight, now * weight
        rows = np.stack([np.sum(made * rest, axis=1), np.sum(made * made, axis=1)], axis=1)
        count = len(rows) // size
        shares.append(rows[: count * size].reshape(count, size, 2).sum(axis=1))
    blocks = np.concatenate(shares)
    power = float(blocks[:, 1].sum())
    if len(blocks) < _FEWEST_BLOCKS or power <= 0.0:
        return Slope(1.0, 0.0)
    off = float(blocks[:, 0].sum()) / power
    scatter = blocks[:, 0] - off * blocks[:, 1]
    return Slope(1.0 + off, float(np.sqrt(np.sum(scatter**2))) / power)


def fails_holdout(
    believed: Vehicle, found: Sequence[IdentifiedEffect], of: FitHoldoutSplit, *, beside: bool
) -> tuple[str, ...]:
    """Named effects that don't hold on data not used before; all of them where they don't hold together."""
    whole = corrected(believed, found)
    if not slope(believed, whole, of).holds(beside=beside):
        return tuple(each.name for each in found)
    if len(found) == 1:
        return ()
    others = {each.name: corrected(believed, [f for f in found if f is not each]) for each in found}
    return tuple(name for name, without in others.items() if not slope(without, whole, of).holds(beside=beside))


def told_by_signals(believed: Vehicle, found: Sequence[IdentifiedEffect], of: FitHoldoutSplit) -> set[str]:
    """Named errors of sensors that held-out data show in what their signals say of one another.

    There no physics acts, and no gust: what they leave of the force says nothing against such a name.
    """
    whole = corrected(believed, found)
    return {
        f.name
        for f in found
        if EFFECTS[f.name].kind == "sensor"
        and any(
            _falls(corrected(believed, [g for g in found if g is not f]), whole, of, columns) for columns in KINEMATIC
        )
    }


def _falls(without: Vehicle, whole: Vehicle, of: FitHoldoutSplit, columns: tuple[int, ...]) -> bool:
    """Whether the mean square of these columns falls clearly, and surely over seconds."""
    changes, left = [], 0.0
    for samples, mask in zip(of.flights, of.holdout, strict=True):
        pairs = [np.nan_to_num(residual(v, samples).y[mask][:, columns]) for v in (without, whole)]
        size = max(1, round(_BLOCK_S / samples.dt_s))
        was, now = (np.sum(y**2, axis=1)[: len(y) // size * size].reshape(-1, size).sum(axis=1) for y in pairs)
        changes.append(was - now)
        left += float(now.sum())
    seconds = np.concatenate(changes)
    if len(seconds) < _FEWEST_BLOCKS:
        return False
    fall, error = float(seconds.sum()), float(np.std(seconds, ddof=1)) * math.sqrt(len(seconds))
    return fall > SURE_ERRORS * error and fall >= CLEARLY * left


def interval_contains_nominal(found: Sequence[IdentifiedEffect]) -> tuple[str, ...]:
    """Named effects of which refinement has left nothing: every interval holds what the vehicle's file has."""
    told = {f.name: [e for e in f.parameters.values() if math.isfinite(e.before) and e.low < e.high] for f in found}
    return tuple(name for name, each in told.items() if each and all(e.low <= e.before <= e.high for e in each))


def corrected(believed: Vehicle, found: Sequence[IdentifiedEffect]) -> Vehicle:
    """The vehicle with these effects at their estimates."""
    vehicle = believed
    for each in found:
        vehicle = with_value(vehicle, each.name, {p: e.estimate for p, e in each.parameters.items()})
    return vehicle


def far_from_noise(gap: Gap, figures: Sequence[str] = ONE_STEP, share: float | None = None) -> bool:
    """Whether of what the model leaves of force or torque (or of one of them) this share is not the sensors' noise."""
    pairs = [(getattr(gap.after, n), getattr(gap.noise_floor, n)) for n in figures]
    known = [(now, least) for now, least in pairs if now is not None and least is not None]
    return any(least**2 < (1.0 - (HALF if share is None else share)) * now**2 for now, least in known)


def surrogate_terms(
    believed: Vehicle, found: Sequence[IdentifiedEffect], constant: Mapping[str, float]
) -> tuple[str, ...]:
    """Named effects that, far from the noise, stand for something else.

    Those that stand at the end of their range, those whose size changes from stretch to stretch (`constant`: p-values
    of its being the same), a wind that blows up or down more than along: no steady wind goes through the ground,
    a wind beside a constant force: what is left of two forces that are alike is a torque, or nothing, a payload of half
    the vehicle: who weighs a vehicle would have noticed it, how strong rotors are few have measured, and a tilt between
    sensors and body that can be seen.
    """
    ends = at_bound(believed, found)
    names = {f.name for f in found}
    gone = {f.name for f in found if f.name in ends or constant.get(f.name, 1.0) < FICKLE_P or upright(f)}
    gone |= {"steady_wind"} if names >= {"steady_wind", "constant_force"} else set()
    gone |= {f.name for f in found if f.name == "payload" and _is_half(f, believed)}
    gone |= {f.name for f in found if f.name == "attitude_misalignment" and _is_seen(f)}
    return tuple(f.name for f in found if f.name in gone)


_SEEN_RAD = 0.15
"""Nine degrees: no autopilot is mounted, and none levelled, so badly unnoticed."""


def _is_seen(tilt: IdentifiedEffect) -> bool:
    return math.hypot(*(tilt.parameters[f"{axis}_rad"].estimate for axis in ("roll", "pitch"))) > _SEEN_RAD


def _is_half(load: IdentifiedEffect, believed: Vehicle) -> bool:
    return abs(load.parameters["mass_kg"].estimate) > HALF * believed.mass_kg


def mass_for_thrust(believed: Vehicle, found: Sequence[IdentifiedEffect]) -> tuple[IdentifiedEffect, ...]:
    """The same forces by a mass in place of a thrust scale s: m / s for m, and what pushes by newtons 1 / s of it.

    None where that is no mass to believe in, or the file has one of the two already.
    """
    scale = next((f.parameters["scale"] for f in found if f.name == "thrust_scale"), None)
    if scale is None or scale.low <= 0.0 or {"thrust_scale", "payload"} & set(believed.effects):
        return ()

    def load(value: float) -> float:
        return believed.mass_kg * (1.0 / value - 1.0)

    out = []
    for each in found:
        if each.name == "thrust_scale":
            mass = Estimate(load(scale.before), load(scale.estimate), load(scale.high), load(scale.low))
            twins = ("thrust_scale", *(t for t in each.indistinguishable_from if t != "payload"))
            each = replace(each, name="payload", parameters={"mass_kg": mass}, indistinguishable_from=twins)
        elif each.name in _PUSHES:
            by = {p: _times(e, 1.0 / scale.estimate) for p, e in each.parameters.items()}
            each = replace(each, parameters=by)
        out.append(each)
    return () if any(f.name == "payload" and _is_half(f, believed) for f in out) else tuple(out)


_PUSHES = ("linear_drag", "parasitic_drag", "rotor_drag", "induced_inflow", "constant_force")


def _times(each: Estimate, factor: float) -> Estimate:
    return replace(each, estimate=factor * each.estimate, low=factor * each.low, high=factor * each.high)


def upright(found: IdentifiedEffect) -> bool:
    """Whether it is a wind steeper than half a right angle."""
    if found.name != "steady_wind":
        return False
    north, east, down = (found.parameters[f"{axis}_mps"].estimate for axis in ("north", "east", "down"))
    return abs(down) > math.hypot(north, east)


def at_bound(believed: Vehicle, found: Sequence[IdentifiedEffect]) -> tuple[str, ...]:
    """Effects with a parameter at the end of its range."""
    return tuple(f.name for f in found if any(at_end(believed, f.name, p, e.estimate) for p, e in f.parameters.items()))
