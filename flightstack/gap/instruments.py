"""Named effects and the time at which commands acted, by instruments that a loop's noise does not reach.

A rate loop passes its gyro's noise to the motors.  The angular acceleration that is compared is made of the same gyro,
so its noise goes together with what the commands are said to do, and least squares take that for physics.  What the
columns were somewhat earlier goes together with what they are now, but not with noise that came after: two-stage least
squares on such instruments are not bent (Wooldridge, Econometric Analysis, 2010, chapter 5).  Where they differ from
the estimates by more than chance, they are believed (Hausman, Econometrica 1978).

Rows of a CSV hold commands that were sent before the row: there they acted earlier than their stamps say, which no
effect does, and which passes for a short lag, damping or flapping.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flightstack.effects import EFFECTS
from flightstack.gap.chances import chi2_tail
from flightstack.gap.decisions import CLEARLY, LEAST_SIZES, RARE_P, SURE_ERRORS
from flightstack.gap.naming.candidates import negligible, plausible
from flightstack.gap.naming.estimate import CI, inverse
from flightstack.gap.records import SIGNALS, Estimate, IdentifiedEffect, Samples
from flightstack.gap.sampled import timing_s
from flightstack.gap.simulate import FreeParameter, prediction_error, sensitivities, timing, value, with_value
from flightstack.gap.track import track
from flightstack.types import F64
from flightstack.vehicle import Vehicle

Slot = tuple[str, str]
Mask = NDArray[np.bool_]

_EARLIER = (2.0, 3.0, 4.0, 6.0)
"""Periods of the low-pass by which instruments are older: it reaches one to either side."""
_ROWS_PER_CUTOFF = 2.5
_BLOCK_S = 0.5
"""Rows so near are taken for one draw."""
_STEPS = 2
_TORQUES = (3, 4)
_LATE: tuple[Slot, Slot] = (("motor_lag", "time_constant_s"), ("transport_delay", "delay_s"))
_GAINS = (("inertia", "scale_x"), ("inertia", "scale_y"))


@dataclass(frozen=True, slots=True)
class _Told:
    """What instruments say beside the values that the columns were taken at; by how much commands act later is last."""

    change: F64
    covariance: F64
    blocks: int


def compared(
    believed: Vehicle,
    vehicle: Vehicle,
    found: Sequence[IdentifiedEffect],
    flights: Sequence[Samples],
    masks: Sequence[Mask],
    centre_s: Sequence[float],
) -> tuple[tuple[IdentifiedEffect, ...], tuple[IdentifiedEffect, ...] | None]:
    """The names (`vehicle` holds them) with intervals that reach to what instruments say, and the names by these alone.

    The former where a parameter differs by more than two standard errors; the latter where all together differ by more
    than chance, else None.  `centre_s`: how late each flight's commands are taken to act before anything is fitted.
    """
    slots = [
        (f.name, p)
        for f in found
        if EFFECTS[f.name].kind != "sensor" and f.name != "turbulence"
        for p, e in f.parameters.items()
        if e.told and e.low < e.high
    ]
    delay = ("transport_delay", "delay_s")
    known = delay in slots  # the same column: what is not known of the one is not known of the other
    sampling_s = float(np.mean([s.dt_s for s in flights]))
    off = float(np.mean([c - s.command_late_s for c, s in zip(centre_s, flights, strict=True)]))
    prior = (0.0, 1e-6) if known else (off, sampling_s / np.sqrt(12.0))
    wide, alone, now = tuple(found), None, vehicle
    for step in range(_STEPS if slots else 0):
        told = _told(now, flights, masks, slots, prior)
        if told is None:
            break
        sigma = np.sqrt(np.diag(told.covariance))
        if known:
            sigma[slots.index(delay)] = np.hypot(sigma[slots.index(delay)], sampling_s / np.sqrt(12.0))
        said = {slot: (float(told.change[k]), float(sigma[k])) for k, slot in enumerate(slots)}
        if step == 0:
            wide = _with(believed, found, said, alone=False)
            if not _differs(told, len(slots)):
                break
        alone = _with(believed, alone or found, said, alone=True)
        for e, p in slots:
            (each,) = (f for f in alone if f.name == e)
            now = with_value(now, e, {p: each.parameters[p].estimate})
    return wide, alone


def _differs(told: _Told, count: int) -> bool:
    """Whether parameters (not the time at which commands acted) are off by more than chance."""
    change = told.change[:count]
    distance = float(change @ inverse(told.covariance[:count, :count]) @ change)
    return chi2_tail(count, distance * (1.0 - count / told.blocks)) < RARE_P


def _with(
    believed: Vehicle,
    found: Sequence[IdentifiedEffect],
    by_slot: Mapping[Slot, tuple[float, float]],
    *,
    alone: bool,
) -> tuple[IdentifiedEffect, ...]:
    """The effects with what instruments say of each parameter: change and deviation."""
    out = []
    for each in found:
        own = {p: by_slot[each.name, p] for p in each.parameters if (each.name, p) in by_slot}
        out.append(replace(each, parameters={**each.parameters, **_by(believed, each, own, alone=alone)}))
    return tuple(out)


def _by(
    believed: Vehicle, found: IdentifiedEffect, own: Mapping[str, tuple[float, float]], *, alone: bool
) -> dict[str, Estimate]:
    out = {}
    for p, (change, sigma) in own.items():
        e = found.parameters[p]
        low, high = plausible(believed, found.name, p)
        if alone:
            now = float(np.clip(e.estimate + change, low, high))
            reach = max(CI * sigma, 0.5 * (e.high - e.low))  # of what no row shows, too
            out[p] = replace(
                e, estimate=now, low=min(now, max(now - reach, low)), high=max(now, min(now + reach, high))
            )
        elif abs(change) > SURE_ERRORS * sigma:
            out[p] = replace(
                e,
                low=min(e.low, max(e.estimate - math.hypot(e.estimate - e.low, change), low)),
                high=max(e.high, min(e.estimate + math.hypot(e.high - e.estimate, change), high)),
            )
    return out


def delay_for_lag(
    believed: Vehicle,
    vehicle: Vehicle,
    found: Sequence[IdentifiedEffect],
    flights: Sequence[Samples],
    masks: Sequence[Mask],
) -> IdentifiedEffect | None:
    """The delay in a named lag's place where instruments are sure of it and find nothing of the lag.

    In a hover commands are little but the gyro's noise passed on, which a lag passes for better than a delay does.
    """
    named = [f for f in found if f.name in dict(_LATE)]
    if [f.name for f in named] != ["motor_lag"] or named[0].indistinguishable_from:
        return None
    now, off, sigma = vehicle, np.zeros(2), np.zeros(2)
    for e, p in _LATE:
        now = with_value(now, e, {p: value(believed, e, p)})
    sampling_s = float(np.mean([s.dt_s for s in flights])) / np.sqrt(12.0)
    for _ in range(_STEPS + 1):
        told = _told(now, flights, masks, _LATE, (0.0, 1e-6))
        if told is None:
            return None
        sigma = np.hypot(
            np.sqrt(np.diag(told.covariance)[:2]), sampling_s * np.array([e != "motor_lag" for e, _ in _LATE])
        )
        for (e, p), change in zip(_LATE, told.change, strict=False):
            now = with_value(now, e, {p: float(np.clip(value(now, e, p) + change, *plausible(believed, e, p)))})
        off = np.array([value(now, e, p) - value(believed, e, p) for e, p in _LATE])
    if abs(off[0]) > SURE_ERRORS * sigma[0] or chi2_tail(1, float(off[1] / sigma[1]) ** 2) > RARE_P:
        return None
    effect, parameter = _LATE[1]
    before, reach = value(believed, effect, parameter), CI * float(sigma[1])
    size = before + float(off[1])
    parameters = {parameter: Estimate(before, size, max(size - reach, 0.0), size + reach)}
    return replace(named[0], name=effect, parameters=parameters, indistinguishable_from=(named[0].name,))


def is_trifling(vehicle: Vehicle, found: IdentifiedEffect) -> bool:
    """Whether every parameter differs from the file's by less than a name must."""
    told = {p: e for p, e in found.parameters.items() if e.told and e.low < e.high}
    return all(
        abs(e.estimate - e.before) < LEAST_SIZES * negligible(vehicle, found.name, p) for p, e in told.items()
    ) and bool(told)


def early_s(vehicle: Vehicle, flights: Sequence[Samples], masks: Sequence[Mask]) -> list[float]:
    """By how much the commands of each flight acted before their stamps, s (0 or less), where that is beyond doubt.

    It must clearly lower what is left of roll and pitch.
    """
    out = []
    for samples, mask in zip(flights, masks, strict=True):
        told = None
        if mask.any() and "motor" not in track(samples).missing:
            told = _told(vehicle, [samples], [mask], _GAINS, (0.0, np.inf), _TORQUES)
        late = sigma = 0.0
        if told is not None:
            late, sigma = float(told.change[-1]), float(np.sqrt(told.covariance[-1, -1]))
        early = max(late, -samples.dt_s)
        sure = late + SURE_ERRORS * sigma < -timing_s(samples.dt_s)
        if sure:
            (other,) = moved([samples], [early])
            sure = _turning(vehicle, samples, mask) > (1.0 + CLEARLY) * _turning(vehicle, other, mask)
        out.append(early if sure else 0.0)
    return out


def _turning(vehicle: Vehicle, samples: Samples, mask: Mask) -> float:
    """Mean square of what is left of roll and pitch."""
    return float(
        np.nanmean(prediction_error(vehicle, samples)[0][mask & track(samples).usable][:, list(_TORQUES)] ** 2)
    )


def _told(
    vehicle: Vehicle,
    flights: Sequence[Samples],
    masks: Sequence[Mask],
    slots: Sequence[Slot],
    late: tuple[float, float],
    channels: Sequence[int] = range(len(SIGNALS)),
) -> _Told | None:
    """What instruments say of these parameters of `vehicle` and of when commands acted; None of too few samples.

    `late`: mean and deviation of the latter by what is known beforehand.
    """
    each = (_rows(vehicle, s, m, slots, channels) for s, m in zip(flights, masks, strict=True))
    parts = [part for part in each if part is not None]
    n = len(slots) + 1
    blocks, count = [], 0
    for part in parts:
        numbers = np.unique(part[-1], return_inverse=True)[1].ravel() + count
        blocks.append(numbers)
        count = int(numbers.max()) + 1
    if count < 2 * n or not parts:
        return None
    x, y, z = (np.concatenate([part[k] for part in parts]) for k in range(3))
    seen = z @ np.linalg.lstsq(z, x, rcond=1e-9)[0]
    gram = seen.T @ seen
    back = inverse(gram)

    def sandwich(change: F64) -> F64:
        sums = np.zeros((count, n))
        np.add.at(sums, np.concatenate(blocks), seen * (y - x @ change)[:, None])
        return np.asarray(sums.T @ sums)

    change = back @ (seen.T @ y)
    if not np.isfinite(late[1]):
        return _Told(change, back @ sandwich(change) @ back, count)
    # neighbours of a row say the same again: what is known beforehand counts as much more
    again = float(np.diag(back @ sandwich(change) @ back)[-1] / max(back[-1, -1], 1e-300))
    weight = np.zeros(n)
    weight[-1] = again / late[1] ** 2
    back = inverse(gram + np.diag(weight))
    change = back @ (seen.T @ y + weight * late[0])
    return _Told(change, back @ (sandwich(change) + np.diag(weight * late[1]) ** 2) @ back, count)


def _rows(
    vehicle: Vehicle, samples: Samples, mask: Mask, slots: Sequence[Slot], channels: Sequence[int]
) -> tuple[F64, F64, F64, NDArray[np.int64]] | None:
    """Columns (R, n), residual (R,), instruments (R, m) and block (R,): each channel by its residual's rms."""
    flight = track(samples)
    every = max(1, int(1.0 / (_ROWS_PER_CUTOFF * flight.cutoff_hz * samples.dt_s)))
    columns = sensitivities(vehicle, samples, [FreeParameter(e, p) for e, p in slots], every)
    x = np.nan_to_num(np.concatenate([columns, timing(vehicle, samples)[::every, :, None]], axis=2))
    y = prediction_error(vehicle, samples)[0][::every]
    row_s = every * samples.dt_s
    back = [int(np.ceil(k / flight.cutoff_hz / row_s)) for k in _EARLIER]
    at = np.flatnonzero((mask & flight.usable)[::every])
    at = at[at >= back[-1]]
    block = np.floor(at * row_s / _BLOCK_S).astype(np.int64)
    out = []
    for c in channels:
        if not len(at) or not np.isfinite(y[at, c]).all():
            continue
        size = max(float(np.sqrt(np.mean(y[at, c] ** 2))), 1e-12)
        out.append(
            (x[at, c] / size, y[at, c] / size, np.concatenate([x[at - k, c] for k in back], axis=1) / size, block)
        )
    if not out:
        return None
    rows, left, older, blocks = (np.concatenate(each) for each in zip(*out, strict=True))
    return rows, left, older, blocks


def moved(flights: Sequence[Samples], early: Sequence[float]) -> tuple[Samples, ...]:
    """The flights with their commands acting that much before their stamps."""
    return tuple(replace(s, command_late_s=s.command_late_s + t) for s, t in zip(flights, early, strict=True))
