"""A load, or thrust, told by what holds a vehicle up in the mean, where its motors were logged too slowly for more.

Ten commands a second say nothing of torques or of how soon rotors follow.  Their mean is the mean lift all the same,
and that carries the weight and what the velocity gained: no accelerometer, whose bias would be a load, takes part.  In:
a verdict on the side force; out: with a load where the lift is another than the file's, the side force looked at anew
with it (a drag brakes the mass that there is), in one class with the thrust.

A linear drag along the rotors' axis carries, too: it is off by as much as along the others, but for a half, or by what
the lift's changes say.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap.airspeed import DRAGS
from flightstack.gap.classes import together, without_motors
from flightstack.gap.concluded import Said, held_out_gap
from flightstack.gap.decisions import HALF, SMALL_SHARE, SURE_ERRORS
from flightstack.gap.held import corrected
from flightstack.gap.name import Selection
from flightstack.gap.naming.estimate import CI
from flightstack.gap.pooled import FitHoldoutSplit, Mask
from flightstack.gap.records import Estimate, IdentifiedEffect, Samples, Unexplained
from flightstack.gap.report.words import SIDE_AND_LIFT, SIDE_FORCE
from flightstack.gap.simulate import natural_scale, predict, value, with_value
from flightstack.gap.track import GRAVITY_NED_MPS2, track
from flightstack.gap.verdict import unexplained
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle, with_effects
from flightstack_logs.turn import rotate

_LIFTED = ("payload", "thrust_scale")
_ALIKE = ("thrust_scale", "thrust_curve", "constant_force")
"""What carries less, or pulls down, in the mean as a load does."""
_IN_FLIGHT = (
    ("ground_effect", "strength"),
    ("vortex_ring", "strength"),
    ("translational_lift", "k_h_kg_per_m"),
    ("induced_inflow", "k_z_kg_per_rad"),
)
"""What may carry, or not, by how and where it is flown."""
_PLAUSIBLE = 10.0
"""Natural scales, each of which moves a vehicle by some percent."""
_ROTORS = (1, 2, 3, 4)
_STRETCHES = 6
_BLOCK_S = 0.5
_LEAST_ERROR = 0.004
"""Of the mass: in 13 flights of PX4's simulator at its default rates, with the drag as it was, the most was 0.0041."""
_LEAST_ROWS = 4 * _STRETCHES
_BESIDE = 5.0
"""Times as far from none as sure, beside something unexplained: ropes, wakes and gusts make up to 4, slung loads 11."""
_SURE_T = 8.6
"""Student's t of four degrees of freedom, one in a thousand."""
_LOOKS = 3
"""A drag along the rotors' axis carries too, and follows the level ones; each look moves the load a tenth as far."""


def with_mean_lift(vehicle: Vehicle, said: Said, look: Callable[[Vehicle], Said]) -> Said:
    """The verdict with the load that the mean lift tells; `look` says what the flights tell against a vehicle."""
    naming, of, _ = said
    guessed = {"rotors.max_thrust_n", "body.mass_kg"} & set(vehicle.ranges)  # what is guessed may be all of it
    if (
        guessed
        or not all(_tells(s) for s in of.flights)
        or not naming.can_be_fitted
        or any(f.name == "payload" for f in naming.found)
    ):
        return said
    if drift := _drift(vehicle, naming.found, of):
        return _with_drift(said, drift)
    times = _BESIDE if naming.unexplained.significant else 1.0
    ratio = _mass_ratio(vehicle, naming.found, of)
    if ratio is None:
        return said
    if _is_one(ratio, times):
        return said if times > 1.0 else _as_heavy_as_the_file(vehicle, said, ratio)
    try:
        loaded, ratio = _looked_again(vehicle, ratio, look)
    except InputError:
        return said
    if _is_one(ratio, times):
        return said if times > 1.0 else _as_heavy_as_the_file(vehicle, said, ratio)
    if abs(ratio.estimate - 1.0) > HALF:  # no load to believe in: a vehicle is weighed, and what brakes it stays
        found = (_thrust(vehicle, ratio), *naming.found)
    else:
        plain = {f.name for f in naming.found}
        naming, of, _ = loaded
        alike = _twins(naming.vehicle, of, ratio.estimate)
        others = tuple(together(f, alike) if f.name in DRAGS and not plain & DRAGS else f for f in naming.found)
        found = (_load(vehicle, ratio, alike), *_braked(others, ratio))
    naming = _told(replace(naming, found=found, vehicle=corrected(vehicle, found)), vehicle, ratio)
    gap = held_out_gap(vehicle, naming, of)
    return replace(naming, unexplained=unexplained(naming.unexplained, gap, named=True)), of, gap


def _tells(samples: Samples) -> bool:
    """Whether its motors tell a mean and no more, and it says how the vehicle leaned and moved."""
    needs = {"q_ned_frd", "vel_ned_mps"}
    return "motor" in samples.derived and not needs & track(samples).missing and "q_ned_frd" not in samples.derived


def _with_drift(said: Said, change: float) -> Said:
    """The verdict, in which a lift that changes in flight is something that no effect explains."""
    naming = said[0]
    rest = naming.unexplained
    drivers = ("time", *(driver for driver in rest.depends_on if driver != "time"))
    fraction = rest.fraction if naming.found or rest.significant else 1.0
    shown = f"what the same commands carry changes by {100.0 * abs(change):.0f} % of the weight in flight"
    return replace(naming, unexplained=Unexplained(True, drivers, fraction, shown)), *said[1:]


def _drift(vehicle: Vehicle, found: Sequence[IdentifiedEffect], of: FitHoldoutSplit) -> float:
    """By how much of the weight the lift changes over a flight, by a straight line that is surely there; else 0."""
    whole = _with_upright_drag(corrected(vehicle, found), found)
    at = np.arange(_STRETCHES) - 0.5 * (_STRETCHES - 1)
    for samples in of.flights:
        rows = _blocks([whole], samples, samples.valid)
        if len(rows) < _LEAST_ROWS:
            continue
        parts = [part.mean(axis=0) for part in np.array_split(rows, _STRETCHES)]
        ratios = np.array([said / felt for said, felt in parts])
        slope = float(at @ ratios / (at @ at))
        rest = ratios - ratios.mean() - slope * at
        error = math.sqrt(float(rest @ rest) / (_STRETCHES - 2) / float(at @ at))
        change = slope * float(at[-1] - at[0])
        if abs(slope) > _SURE_T * error and abs(change) > SMALL_SHARE:
            return change
    return 0.0


def _is_one(ratio: Estimate, times: float) -> bool:
    """Whether the mass may be the file's, by an interval so many times as wide."""
    return abs(ratio.estimate - 1.0) <= times * (ratio.high - ratio.estimate)


def _looked_again(vehicle: Vehicle, ratio: Estimate, look: Callable[[Vehicle], Said]) -> tuple[Said, Estimate]:
    """What the flights tell against the vehicle at the mass that its lift carries, and that mass by the file's own."""
    for _ in range(_LOOKS):
        heavy = replace(vehicle, mass_kg=vehicle.mass_kg + (ratio.estimate - 1.0) * vehicle.total_mass_kg)
        said = look(heavy)
        more = _mass_ratio(heavy, said[0].found, said[1])
        if more is None:
            break
        at = ratio.estimate * more.estimate
        was, ratio = ratio, Estimate(1.0, at, at * more.low / more.estimate, at * more.high / more.estimate)
        if was.low < at < was.high:
            break
    return said, ratio


def _mass_ratio(vehicle: Vehicle, found: Sequence[IdentifiedEffect], of: FitHoldoutSplit) -> Estimate | None:
    """Mean lift that the commands say by what carried the vehicle: its mass by the file's, if the thrust is right.

    As sure as stretches of the flights agree, and as the drag along the rotors' axis is known.
    """
    vehicles = [_with_upright_drag(corrected(vehicle, found), found), corrected(vehicle, found)]
    both = [fit | held for fit, held in zip(of.fit, of.holdout, strict=True)]
    rows = np.concatenate([_blocks(vehicles, s, mask) for s, mask in zip(of.flights, both, strict=True)])
    if len(rows) < _LEAST_ROWS:
        return None
    best, doubt = _balance(rows)
    parts = [_balance(np.delete(rows, part, axis=0))[0] for part in np.array_split(np.arange(len(rows)), _STRETCHES)]
    if not all(map(math.isfinite, (best, doubt, *parts))) or best <= 0.0:
        return None
    error = math.sqrt((_STRETCHES - 1) * float(np.var(parts)))  # Quenouille's jackknife
    width = SURE_ERRORS * math.hypot(error, doubt, _LEAST_ERROR)
    return Estimate(1.0, best, best - width, best + width)


def _balance(rows: F64) -> tuple[float, float]:
    """What the lift carries by what it does, and how far the drag along the rotors' axis leaves it open.

    rows: of `_blocks`, with that drag and without.
    r and b: said + b change = r felt, in the mean and (b, weighed against what it is believed to be) as they change.
    """
    said, change, felt = rows[:, 0], rows[:, 1] - rows[:, 0], rows[:, 2]
    plain = np.mean(said) / np.mean(felt)
    noise = max(float(np.var(said - plain * felt)), 1e-12)
    swing = (change - np.mean(change)) / noise
    weight = float(swing @ change) + HALF**-2
    A = np.array([[np.mean(felt), -np.mean(change)], [-swing @ felt, weight]])
    r = float(np.linalg.solve(A, np.array([np.mean(said), -swing @ said]))[0])
    return r, abs(float(np.mean(change) / np.mean(felt))) / math.sqrt(weight)


def _with_upright_drag(vehicle: Vehicle, found: Sequence[IdentifiedEffect]) -> Vehicle:
    """The vehicle with a linear drag along the rotors' axis that is off by as much as along the others."""
    drag = next((f.parameters for f in found if f.name == "linear_drag"), None)
    if drag is None or drag["d_z_kgps"].told:
        return vehicle
    level = [drag["d_x_kgps"], drag["d_y_kgps"]]
    before, now = (float(np.mean(each)) for each in ([e.before for e in level], [e.estimate for e in level]))
    z = drag["d_z_kgps"].before
    own = dict(vehicle.effects["linear_drag"]) | {"d_z_kgps": z * now / before if z and before else now}
    return with_effects(vehicle, {"linear_drag": own})


def _blocks(vehicles: Sequence[Vehicle], samples: Samples, mask: Mask) -> F64:
    """(n, vehicles + 1) upward force by mass over each half second: as commands say it by each, and as it moved."""
    fast = _with_motors(samples)
    flight = track(fast)
    said = [-rotate(flight.q_ned_frd, predict(_with_true_sensors(v), fast)[:, :3])[:, 2] for v in vehicles]
    columns = np.stack([*said, -(flight.vel_rate_ned_mps2 - GRAVITY_NED_MPS2)[:, 2]], axis=1)
    columns[~(mask & flight.usable)] = np.nan
    every = max(1, round(_BLOCK_S / samples.dt_s))
    blocks = columns[: len(columns) // every * every].reshape(-1, every, columns.shape[1]).mean(axis=1)
    return np.asarray(blocks[np.isfinite(blocks).all(axis=1)])


def _with_motors(samples: Samples) -> Samples:
    """The samples as if their motors told more than a mean."""
    return replace(samples, derived=tuple(name for name in samples.derived if name != "motor"))


def _with_true_sensors(vehicle: Vehicle) -> Vehicle:
    """What moves the vehicle is asked for, and not what its sensors show."""
    return replace(
        vehicle, effects={name: own for name, own in vehicle.effects.items() if EFFECTS[name].kind != "sensor"}
    )


def _load(vehicle: Vehicle, ratio: Estimate, twins: tuple[str, ...]) -> IdentifiedEffect:
    was = value(vehicle, "payload", "mass_kg")
    best, low, high = (was + vehicle.total_mass_kg * (x - 1.0) for x in (ratio.estimate, ratio.low, ratio.high))
    return together(_named("payload", {"mass_kg": Estimate(was, best, low, high)}, ratio), twins)


def _thrust(vehicle: Vehicle, ratio: Estimate) -> IdentifiedEffect:
    was = value(vehicle, "thrust_scale", "scale")
    scale = Estimate(was, was / ratio.estimate, was / ratio.high, was / ratio.low)
    return together(_named("thrust_scale", {"scale": scale}, ratio), ("payload", "thrust_curve"))


def _twins(vehicle: Vehicle, of: FitHoldoutSplit, ratio: float) -> tuple[str, ...]:
    """What would carry as much less (or more) in the mean, on these flights."""
    sags = "battery_sag" not in vehicle.effects and any(np.any(s.battery_v > 0.0) for s in of.flights)
    weak = ratio > 1.0 and any(_is_weak_rotor(vehicle, _with_motors(s), ratio) for s in of.flights)
    swings = ("slung_load",) * (ratio > 1.0)
    others = [effect for effect, parameter in _IN_FLIGHT if _carries(vehicle, of, ratio, effect, parameter)]
    return (*_ALIKE, *swings, *["battery_sag"] * sags, *["rotor_fault"] * weak, *others)


def _carries(vehicle: Vehicle, of: FitHoldoutSplit, ratio: float, effect: str, parameter: str) -> bool:
    """Whether a plausible size of it, on these flights, would be what the mean lift is off by."""
    size = _PLAUSIBLE * natural_scale(vehicle, effect, parameter)
    other = with_value(vehicle, effect, {parameter: value(vehicle, effect, parameter) + size})
    with_it, without = (_mean_share(each, of, [f | h for f, h in zip(of.fit, of.holdout, strict=True)])
                        for each in (other, vehicle))  # fmt: skip
    return without - with_it >= ratio - 1.0 > 0.0 or without - with_it <= ratio - 1.0 < 0.0


def _is_weak_rotor(vehicle: Vehicle, samples: Samples, ratio: float) -> bool:
    """Whether mean commands that carry too little also tip, and a weak rotor explains both."""
    left = max(0.0, 1.0 - len(_ROTORS) * (1.0 - 1.0 / ratio))
    faults: list[dict[str, float]] = [{"rotor": float(k), "effectiveness": left} for k in _ROTORS]
    vehicles = [vehicle, *(with_effects(vehicle, {"rotor_fault": each}) for each in faults)]
    usable = track(samples).usable
    tips = [float(np.sum(np.mean(predict(each, samples)[usable][:, 3:5], axis=0) ** 2)) for each in vehicles]
    return bool(usable.any()) and min(tips[1:]) < tips[0]


def _named(name: str, parameters: dict[str, Estimate], ratio: Estimate) -> IdentifiedEffect:
    off = ratio.estimate - 1.0
    errors = SURE_ERRORS * off / (ratio.high - ratio.estimate)
    evidence = math.log(_LEAST_ROWS) - errors**2
    return IdentifiedEffect(name, parameters, evidence, min(1.0, abs(off)), math.erfc(abs(errors) / math.sqrt(2.0)))


def _as_heavy_as_the_file(vehicle: Vehicle, said: Said, ratio: Estimate) -> Said:
    naming = replace(said[0], found=_braked(said[0].found, ratio))
    return _told(naming, vehicle, ratio), *said[1:]


def _told(naming: Selection, vehicle: Vehicle, ratio: Estimate) -> Selection:
    """The verdict with what the lift says of a load among what was asked."""
    width = vehicle.total_mass_kg * (ratio.high - ratio.estimate)
    rows = tuple(
        replace(row, error=width / CI, smallest=width, shown=True, like="thrust_scale")
        if row.effect == "payload"
        else row
        for row in naming.identifiable
    )
    named = {f.name for f in naming.found}
    rejected = tuple(
        replace(r, reason="the mean lift carries what the file says") if r.name in _LIFTED else r
        for r in naming.rejected
        if not (r.name in _LIFTED and named & set(_LIFTED))
    )
    return replace(naming, identifiable=rows, rejected=rejected)


def held_out_share(vehicle: Vehicle, of: FitHoldoutSplit) -> float:
    """By how much of the weight the mean lift that the commands say is off on data not used before."""
    return _mean_share(vehicle, of, of.holdout)


def _mean_share(vehicle: Vehicle, of: FitHoldoutSplit, masks: Sequence[Mask]) -> float:
    rows = [_blocks([vehicle], s, mask) for s, mask in zip(of.flights, masks, strict=True)]
    said, felt = np.concatenate(rows).mean(axis=0) if any(len(each) for each in rows) else (math.nan, math.nan)
    return float(said / felt - 1.0)


def compared_only(naming: Selection, flights: Sequence[Samples]) -> str:
    """What is compared of flights whose motors were logged too slowly for more; else ""."""
    if not without_motors(flights):
        return ""
    return SIDE_AND_LIFT if any(r.effect == "payload" and r.shown for r in naming.identifiable) else SIDE_FORCE


def _braked(found: Sequence[IdentifiedEffect], ratio: Estimate) -> tuple[IdentifiedEffect, ...]:
    """The names without a load as their twin: a drag's interval holds what the mass may be off by."""
    share = max(ratio.high / ratio.estimate - 1.0, abs(ratio.estimate - 1.0) if ratio.low <= 1.0 <= ratio.high else 0.0)
    out = []
    for each in found:
        if each.name in DRAGS:
            wide = {p: _wider(e, share * abs(e.estimate)) if e.told else e for p, e in each.parameters.items()}
            twins = tuple(t for t in each.indistinguishable_from if t != "payload")
            each = replace(each, parameters=wide, indistinguishable_from=twins)
        out.append(each)
    return tuple(out)


def _wider(each: Estimate, by: float) -> Estimate:
    down, up = (math.hypot(side, by) for side in (each.estimate - each.low, each.high - each.estimate))
    return replace(each, low=each.estimate - down, high=each.estimate + up)
