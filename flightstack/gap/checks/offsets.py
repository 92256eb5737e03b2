"""By how much each topic's stamps are late against the attitude's, with 95 % intervals.

Three comparisons, each band-limited and linear in what is sought once the stamps are nearly right (so it is repeated
with the stamps shifted): the gyro against the attitude's turning; the velocity against the integral of the specific
force, turned by the attitude, plus gravity (which sees the velocity's and the accelerometer's lateness at once), or
without an accelerometer against the attitude alone (rotors push along one axis of the body: what lies across it goes
with speed, not with turning); the position against the velocity's integral.  Constant biases are fitted along.
Errors are correlated in time, so the intervals come from sums over blocks that are longer than that (a sandwich
estimate clustered by blocks: White 1980, Liang and Zeger 1986).  What the motion can't tell has an interval of NaN
and is left as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from flightstack.gap.chances import t_limit
from flightstack.gap.checks.agreement import correlation
from flightstack.gap.checks.motion import G_NED, Motion, band, integrated, motion, rate_hz, rates_of
from flightstack.gap.records import Offset, Signal
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_logs.turn import rotate, rotate_inverse

TOPICS = ("rate_frd_radps", "accel_frd_mps2", "vel_ned_mps", "pos_ned_m", "motor")
_LONGEST_S = 0.35
_ROUNDS = 4
_BLOCK_S = 1.5
_LEAST_BLOCKS = 6
_WIDEST_S = 0.02
"""Half an interval that is wider tells nothing."""
_LEAST_SHIFT_S = 2e-4
_SETTLED = 0.2
"""A last step this small against its own error ends the search."""
_LOW_HZ = 0.3
_LEANING_S = 0.0006
"""Standard error of a lateness told by leaning that blocks don't see: 0.55 ms on 21 made-up flights."""


@dataclass(frozen=True, slots=True)
class _Fit:
    """Estimate and standard error of each unknown, and how many blocks they stand on."""

    value: F64
    error: F64
    blocks: int

    def half_width(self, which: int) -> float:
        return float(self.error[which] * t_limit(max(1, self.blocks - 1)))


def _unknown(name: str) -> Offset:
    return Offset(name, np.nan, np.nan, np.nan)


def find_offsets(signals: Mapping[str, Signal], span_s: tuple[float, float]) -> tuple[Offset, ...]:
    """One line for each topic that the log has, of TOPICS; the flying part is `span_s`."""
    if "q_ned_frd" not in signals:
        return tuple(_unknown(name) for name in TOPICS if name in signals)
    found: dict[str, Offset] = {}
    known = dict(signals)
    if "rate_frd_radps" in signals:
        found |= _settled(known, span_s, ("rate_frd_radps",))
        gyro = found["rate_frd_radps"]
        if _one_topic(signals) and np.isfinite(gyro.low_s):
            found["accel_frd_mps2"] = Offset("accel_frd_mps2", gyro.offset_s, gyro.low_s, gyro.high_s)
            old = signals["accel_frd_mps2"]
            known["accel_frd_mps2"] = Signal(old.t_s - gyro.offset_s, old.value, old.source)
    if {"vel_ned_mps", "accel_frd_mps2"} <= signals.keys():
        sought = ("vel_ned_mps",) if "accel_frd_mps2" in found else ("vel_ned_mps", "accel_frd_mps2")
        found |= _settled(known, span_s, sought)
    elif "vel_ned_mps" in signals:
        found |= _settled(known, span_s, ("vel_ned_mps",))
    if "pos_ned_m" in signals and "vel_ned_mps" in signals:
        found |= _position(shifted(signals, tuple(found.values())), span_s, found.get("vel_ned_mps"))
    return tuple(found.get(name, _unknown(name)) for name in TOPICS if name in signals)


def shifted(signals: Mapping[str, Signal], offsets: tuple[Offset, ...]) -> dict[str, Signal]:
    """The signals with their stamps put right where an offset is known and is not nothing."""
    out = dict(signals)
    for each in offsets:
        if is_certain(each):
            old = out[each.signal]
            out[each.signal] = Signal(old.t_s - each.offset_s, old.value, old.source)
    return out


def _one_topic(signals: Mapping[str, Signal]) -> bool:
    """Whether gyro and accelerometer come in one message, and so have the same stamps."""
    names = ("rate_frd_radps", "accel_frd_mps2")
    if not set(names) <= signals.keys():
        return False
    gyro, force = (signals[name] for name in names)
    topic = gyro.source.partition(" ")[0]
    same = topic == force.source.partition(" ")[0] and not topic.endswith(",")
    return same and len(gyro.t_s) == len(force.t_s) and bool(np.all(gyro.t_s == force.t_s))


def is_certain(offset: Offset) -> bool:
    """Whether an offset is known and differs from nothing at about three standard errors: what is put right."""
    half = 0.5 * (offset.high_s - offset.low_s)
    return bool(abs(offset.offset_s) > max(1.5 * half, _LEAST_SHIFT_S))


def _settled(signals: dict[str, Signal], span_s: tuple[float, float], names: tuple[str, ...]) -> dict[str, Offset]:
    """Repeat the comparison with ever better stamps; the first round looks for the coarse shift by correlation."""
    total = np.zeros(len(names))
    original = dict(signals)
    fit: _Fit | None = None
    for turn in range(_ROUNDS):
        for place, name in enumerate(names):
            old = original[name]
            signals[name] = Signal(old.t_s - total[place], old.value, old.source)
        needed = ("rate_frd_radps",) if names[0] == "rate_frd_radps" else ("vel_ned_mps", "accel_frd_mps2")
        used = {name: signals[name] for name in (*needed, "q_ned_frd") if name in signals}
        slowest = min(rate_hz(each) for each in used.values())
        seen = motion(used, span_s, _grid_s(slowest))
        if seen is None:
            break
        high_hz = min(0.25 * slowest, 12.0)
        if turn == 0:
            total += _coarse(seen, names, high_hz)
            continue
        if len(needed) == 1:
            fit = _rates_fit(seen, high_hz)
        else:
            fit = _velocity_fit(seen, min(high_hz, 6.0), len(names))
        if fit is None:
            break
        step = np.where(fit.error[: len(names)] < 3.0 * _WIDEST_S, fit.value[: len(names)], 0.0)
        total += np.clip(step, -0.05, 0.05)
        if np.all(np.abs(step) < _SETTLED * fit.error[: len(names)]):
            break
    return {name: _offset(name, float(total[place]), fit, place) for place, name in enumerate(names)}


def _grid_s(slowest_hz: float) -> float:
    return 1.0 / float(np.clip(2.0 * slowest_hz, 50.0, 125.0))


def _offset(name: str, value: float, fit: _Fit | None, place: int) -> Offset:
    if fit is None or abs(value) > _LONGEST_S:
        return _unknown(name)
    half = fit.half_width(place)
    if not half < _WIDEST_S:
        return Offset(name, value if np.isfinite(half) else np.nan, np.nan, np.nan)
    return Offset(name, value, value - half, value + half)


def _coarse(seen: Motion, names: tuple[str, ...], high_hz: float) -> F64:
    """Shift of the best correlation; the accelerometer's lateness alone is found in the finer rounds."""
    dt_s = seen.dt_s
    high_hz = min(high_hz, 5.0)
    if names == ("rate_frd_radps",):
        turning = band(rates_of(seen["q_ned_frd"], dt_s), dt_s, _LOW_HZ, high_hz)
        return np.array([correlation(turning, band(seen["rate_frd_radps"], dt_s, _LOW_HZ, high_hz), dt_s)[2]])
    if "accel_frd_mps2" not in seen:
        lift = np.array([[0.0, 0.0, -STANDARD_GRAVITY_MPS2]])
        felt = band(rotate(seen["q_ned_frd"], np.repeat(lift, len(seen.t_s), axis=0)), dt_s, _LOW_HZ, high_hz)
    else:
        felt = band(rotate(seen["q_ned_frd"], seen["accel_frd_mps2"]) + G_NED, dt_s, _LOW_HZ, high_hz)
    moved = band(np.gradient(seen["vel_ned_mps"], dt_s, axis=0), dt_s, _LOW_HZ, high_hz)
    level = correlation(felt[:, :2], moved[:, :2], dt_s)
    upright = correlation(felt[:, 2:], moved[:, 2:], dt_s)
    if level[0] < 0.6:
        return np.zeros(len(names))
    accelerometer = level[2] - upright[2] if upright[0] > 0.6 else 0.0
    return np.array([level[2], accelerometer][: len(names)])


def _rates_fit(seen: Motion, high_hz: float) -> _Fit | None:
    """gyro(t) = rate(t - lateness) + bias + a small turn of the rate, for an attitude that is not the gyro's.

    In a hover a noisy attitude turns more than the vehicle: the gyro's columns have the attitude's for instruments.
    """
    dt_s = seen.dt_s
    turning = band(rates_of(seen["q_ned_frd"], dt_s), dt_s, 0.0, high_hz)
    gyro = band(seen["rate_frd_radps"], dt_s, 0.0, high_hz)
    by_gyro, by_attitude = (
        np.stack([-np.gradient(rate, dt_s, axis=0), *(np.cross(rate, unit) for unit in np.eye(3))], axis=-1)
        for rate in (gyro, turning)
    )
    return _clustered(
        [gyro[:, axis] - turning[:, axis] for axis in range(3)],
        [by_gyro[:, axis] for axis in range(3)],
        seen,
        free=1,
        instruments=[by_attitude[:, axis] for axis in range(3)],
    )


def _velocity_fit(seen: Motion, high_hz: float, sought: int) -> _Fit | None:
    """Unknowns: the lateness of the velocity, of the accelerometer (where 2 are sought), and its bias on each axis."""
    if "accel_frd_mps2" not in seen:
        return _leaning_fit(seen, high_hz)
    dt_s = seen.dt_s
    q, force = seen["q_ned_frd"], seen["accel_frd_mps2"]

    def limited(values: F64) -> F64:
        return band(values, dt_s, _LOW_HZ, high_hz)

    felt = rotate(q, force) + G_NED
    difference = limited(seen["vel_ned_mps"] - integrated(felt, dt_s))
    smooth = band(force, dt_s, 0.0, high_hz)
    columns = [-limited(felt), limited(integrated(rotate(q, np.gradient(smooth, dt_s, axis=0)), dt_s))][:sought]
    for axis in range(3):
        unit = np.zeros((1, 3))
        unit[0, axis] = 1.0
        columns.append(limited(integrated(rotate(q, np.repeat(unit, len(q), axis=0)), dt_s)))
    table = np.stack(columns, axis=-1)
    return _clustered(
        [difference[:, axis] for axis in range(3)], [table[:, axis] for axis in range(3)], seen, free=sought
    )


def _leaning_fit(seen: Motion, high_hz: float) -> _Fit | None:
    """Unknowns: the velocity's lateness against the attitude, and a drag along each level axis of the body.

    A velocity late by d shows f - d rate x f for the force f along the body's vertical axis.
    """
    dt_s, q = seen.dt_s, seen["q_ned_frd"]
    felt = rotate_inverse(q, np.gradient(seen["vel_ned_mps"], dt_s, axis=0) - G_NED)
    rate, air = rates_of(q, dt_s), rotate_inverse(q, seen["vel_ned_mps"])
    lift = band(felt[:, 2:], dt_s, 0.0, high_hz)[:, 0]
    none = np.zeros(len(q))
    tables = [[-rate[:, 1] * lift, air[:, 0], none], [rate[:, 0] * lift, none, air[:, 1]]]
    right = [band(np.stack(table, axis=-1), dt_s, _LOW_HZ, high_hz) for table in tables]
    side = band(felt[:, :2], dt_s, _LOW_HZ, high_hz)
    fit = _clustered([side[:, 0], side[:, 1]], right, seen, free=1)
    return fit and replace(fit, error=np.hypot(fit.error, [_LEANING_S, 0.0, 0.0]))


def _position(signals: Mapping[str, Signal], span_s: tuple[float, float], velocity: Offset | None) -> dict[str, Offset]:
    """The position's lateness against the (corrected) velocity's, which carries the velocity's own uncertainty."""
    name = "pos_ned_m"
    if velocity is None or not np.isfinite(velocity.low_s):
        return {}
    total, fit = 0.0, None
    used = {key: signals[key] for key in (name, "vel_ned_mps")}
    if not is_certain(velocity):
        old = used["vel_ned_mps"]
        used["vel_ned_mps"] = Signal(old.t_s - velocity.offset_s, old.value, old.source)
    original = used[name]
    for _ in range(_ROUNDS):
        used[name] = Signal(original.t_s - total, original.value, original.source)
        slowest = min(rate_hz(each) for each in used.values())
        seen = motion(used, span_s, _grid_s(slowest))
        if seen is None:
            return {}
        dt_s, high_hz = seen.dt_s, min(0.25 * slowest, 3.0)
        speed = band(seen["vel_ned_mps"], dt_s, _LOW_HZ, high_hz)
        difference = band(seen[name] - integrated(seen["vel_ned_mps"], dt_s), dt_s, _LOW_HZ, high_hz)
        fit = _clustered(
            [difference[:, axis] for axis in range(3)], [-speed[:, axis : axis + 1] for axis in range(3)], seen
        )
        if fit is None:
            return {}
        total += float(np.clip(fit.value[0], -0.2, 0.2))
        if abs(fit.value[0]) < _SETTLED * fit.error[0]:
            break
    found = _offset(name, total, fit, 0)
    half = np.hypot(found.high_s - found.offset_s, velocity.high_s - velocity.offset_s)
    if not half < _WIDEST_S:
        return {name: Offset(name, total, np.nan, np.nan)}
    return {name: Offset(name, total, total - float(half), total + float(half))}


def _clustered(
    left: list[F64], right: list[F64], seen: Motion, free: int | None = None, instruments: list[F64] | None = None
) -> _Fit | None:
    """Least squares over the axes, each weighed by its own residual; errors by blocks of time.

    left: per axis (N,); right: per axis (N, k).  A constant for each axis is fitted along.  `free`: the first so many
    unknowns are what is sought, the others may be undetermined.  `instruments`: `right` as somebody else measured it:
    noise in `right` makes what it is multiplied with too small, noise in both does not (instrumental variables).
    """
    keep = seen.known
    block = max(4, round(_BLOCK_S / seen.dt_s))
    blocks = len(keep) // block
    if blocks < _LEAST_BLOCKS:
        return None
    rows = slice(0, blocks * block)
    mask = keep[rows, None]
    right = [(part[rows] - part[rows].mean(axis=0)) * mask for part in right]
    by = right if instruments is None else [(part[rows] - part[rows].mean(axis=0)) * mask for part in instruments]
    left = [(part[rows] - part[rows].mean()) * mask[:, 0] for part in left]
    size = np.sqrt(sum(np.mean(part * part, axis=0) for part in right))
    if not np.all(size[: free or len(size)] > 0.0):
        return None
    scale = np.where(size > 0.0, size, 1.0)
    right, by = [part / scale for part in right], [part / scale for part in by]
    ridge = 1e-9 * len(keep) * np.eye(len(scale))
    weights = np.ones(len(left))
    value: F64 = np.zeros(len(scale))
    for _ in range(3):
        normal = sum(w * z.T @ part for w, z, part in zip(weights, by, right, strict=True)) + ridge
        toward = sum((w * z.T @ y for w, z, y in zip(weights, by, left, strict=True)), np.zeros(len(scale)))
        value = np.asarray(np.linalg.solve(normal, toward), np.float64)
        residual = [y - p @ value for p, y in zip(right, left, strict=True)]
        power = np.array([max(float(np.mean(part * part)), 1e-16) for part in residual])
        weights = power.min() / power
    normal = sum(w * z.T @ part for w, z, part in zip(weights, by, right, strict=True)) + ridge
    gain = sum((w * z * r[:, None] for w, z, r in zip(weights, by, residual, strict=True)), np.zeros_like(right[0]))
    scores = gain.reshape(blocks, block, -1).sum(axis=1)
    inverse = np.linalg.inv(normal)
    covariance = inverse @ (scores.T @ scores) @ inverse.T * blocks / max(1, blocks - len(scale))
    return _Fit(value / scale, np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale, blocks)
