"""Units, frames and quaternion conventions, told by what the signals say of one another.

The attitude's turning must be the gyro's; the velocity's change must be the accelerometer's specific force, turned by
the attitude, plus gravity; the position's change must be the velocity.  Every usual convention of each signal is
tried; the one at hand is kept unless another makes the signals agree far better.  Correlations are taken at the best of
a range of time shifts, so that stamps may be late.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from flightstack.gap.checks.agreement import agreement, correlation, is_better
from flightstack.gap.checks.imu_axes import STRAIGHT, Mounting, accelerometer_mounting, gyro_mounting, tip_of
from flightstack.gap.checks.motion import G_NED, Motion, band, motion, rates_of
from flightstack.gap.decisions import CONVENTION_CHANCE, CONVENTION_MARGIN, HALF
from flightstack.gap.records import Finding, Signal, warning
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_logs.turn import body_to_frd, multiply, rotate, rotate_inverse, world_to_ned

GRID_S = 0.04
_LONGEST_S = 120.0
_LOW_HZ, _HIGH_HZ = 0.15, 4.0
_WORLDS = ("ned", "enu", "nwu")
_VECTORS = (*_WORLDS, "neu")
"""North, east, up is no right-handed frame, but vectors are logged so."""
_TURNS = {"ned": (1.0, 0.0, 0.0, 0.0), "nwu": (0.0, 1.0, 0.0, 0.0), "enu": (0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0)}
_SPEED_UNITS = {"mm/s": 1e3, "cm/s": 1e2, "km/h": 3.6, "ft/s": 1.0 / 0.3048, "knots": 1.0 / 0.514444}
_LENGTH_UNITS = {"mm": 1e3, "cm": 1e2, "ft": 1.0 / 0.3048, "km": 1e-3}
_WAS_IN = "accelerometer: was in {}; turned into m/s^2"
_OFF = 0.15
"""Share by which sizes may be off and still tell a unit."""
_ANGULAR_UNITS = {"deg/s": 180.0 / np.pi, "mrad/s": 1e3, "rpm": 30.0 / np.pi}


@dataclass(frozen=True, slots=True)
class _Convention:
    """One way to read the attitude."""

    order: str = "wxyz"
    inverse: bool = False
    body: str = "frd"
    world: str = "ned"

    @property
    def changes(self) -> int:
        return sum((self.order != "wxyz", self.inverse, self.body != "frd", self.world != "ned"))

    def said(self) -> str:
        words = []
        if self.order != "wxyz":
            words.append("scalar last")
        if self.inverse:
            words.append("world to body")
        if self.body != "frd":
            words.append("body " + self.body.upper())
        if self.world != "ned":
            words.append("world " + self.world.upper())
        return ", ".join(words)

    def read(self, raw: F64) -> F64:
        q = raw[:, [3, 0, 1, 2]] if self.order == "xyzw" else raw.copy()
        if self.inverse:
            q = q * np.array([1.0, -1.0, -1.0, -1.0])
        if self.body == "flu":
            q = multiply(q, np.array([[0.0, 1.0, 0.0, 0.0]]))
        return q if self.world == "ned" else multiply(np.array([_TURNS[self.world]]), q)


_CONVENTIONS = tuple(
    _Convention(*each) for each in itertools.product(("wxyz", "xyzw"), (False, True), ("frd", "flu"), _WORLDS)
)


def settle(signals: Mapping[str, Signal], span_s: tuple[float, float]) -> tuple[dict[str, Signal], list[Finding]]:
    """The signals in SI, NED and FRD with what had to be changed; the flying part is within `span_s`."""
    out = dict(signals)
    findings: list[Finding] = []
    unit, tip = _accelerometer(out, span_s, findings)
    middle = 0.5 * (span_s[0] + span_s[1])
    half = 0.5 * min(span_s[1] - span_s[0], _LONGEST_S)
    seen = motion(out, (middle - half, middle + half), GRID_S)
    if seen is None:
        return out, findings
    seen, gyro = _attitude(out, seen, tip, findings)
    seen = _velocity_unit(out, seen, findings)
    if unit == "mg":
        seen = _milli_g(out, seen, findings)
    _accelerometer_axes(out, seen, gyro, findings)
    _position(out, seen, findings)
    return out, findings


def _accelerometer(
    out: dict[str, Signal], span_s: tuple[float, float], findings: list[Finding]
) -> tuple[str, Mounting]:
    """In the air the mean specific force is one g, along body -z; the unit that it was in, and how it was tipped."""
    signal = out.get("accel_frd_mps2")
    if signal is None:
        return "", STRAIGHT
    inside = (signal.t_s >= span_s[0]) & (signal.t_s <= span_s[1])
    if not inside.any():
        return "", STRAIGHT
    value, unit = signal.value, ""
    mean = float(np.median(np.linalg.norm(value[inside], axis=1)))
    for name, factor in (("g", 1.0), ("mg", 1e3)):
        if 0.7 * factor < mean < 1.4 * factor:
            unit, scale = name, STANDARD_GRAVITY_MPS2 / factor
            value = value * scale
            findings.append(warning("units", _WAS_IN.format(unit)))
            mean *= scale
    tip = tip_of(value[inside])
    if tip != STRAIGHT:
        value = tip.turned(value)
        findings.append(warning("frames", f"accelerometer: {tip.said()}"))
    elif float(np.median(value[inside][:, 2])) > 0.5 * mean:
        value = body_to_frd(value, "flu")
        findings.append(warning("frames", "accelerometer: was in FLU (z up); turned into FRD"))
    out["accel_frd_mps2"] = Signal(signal.t_s, value, signal.source)
    return unit, tip


def _milli_g(out: dict[str, Signal], seen: Motion, findings: list[Finding]) -> Motion:
    """One g is 1000 mg and 981 cm/s^2: which it was says the mean of what is felt upwards, tilt taken out."""
    if not {"q_ned_frd", "vel_ned_mps", "accel_frd_mps2"} <= set(seen.columns):
        return seen
    fallen = float(seen["vel_ned_mps"][-1, 2] - seen["vel_ned_mps"][0, 2]) / float(seen.t_s[-1] - seen.t_s[0])
    up = -float(rotate(seen["q_ned_frd"], seen["accel_frd_mps2"])[:, 2].mean())
    scale = 1e1 / STANDARD_GRAVITY_MPS2
    expected = STANDARD_GRAVITY_MPS2 - fallen
    if abs(scale * up - expected) >= abs(up - expected):
        return seen
    columns = dict(seen.columns)
    _turn(out, columns, "accel_frd_mps2", lambda v: v * scale)
    findings[findings.index(warning("units", _WAS_IN.format("mg")))] = warning("units", _WAS_IN.format("cm/s^2"))
    return Motion(seen.t_s, seen.dt_s, columns, seen.known)


def _limited(values: F64, dt_s: float) -> F64:
    return band(values, dt_s, _LOW_HZ, _HIGH_HZ)


def _attitude(out: dict[str, Signal], seen: Motion, tip: Mounting, findings: list[Finding]) -> tuple[Motion, Mounting]:
    """Settle attitude, gyro frame and unit, and velocity frame together; the second is how the gyro lies."""
    if "q_ned_frd" not in seen:
        _rates_alone(out, seen, findings)
        return seen, STRAIGHT
    kept = _Convention()
    known = _Known(seen, tip)
    scores = {kept: _score(kept, known)}
    if scores[kept][0] < _parts(seen) - CONVENTION_MARGIN:
        scores |= {each: _score(each, known) for each in _CONVENTIONS if each != kept}
    # worlds that all signals share are alike but for rounding: then the usual one
    best = max(scores, key=lambda each: round(scores[each][0] - 0.01 * each.changes, 6))
    chosen = best if is_better(scores[best][0], scores[kept][0], _parts(seen)) else kept
    _, gyro, velocity_frame = scores[chosen]
    columns = dict(seen.columns)
    if chosen != kept:
        findings.append(warning("quaternion", f"attitude: was {chosen.said()}; turned into FRD to NED, scalar first"))
        old = out["q_ned_frd"]
        out["q_ned_frd"] = Signal(old.t_s, chosen.read(old.value), old.source)
        columns["q_ned_frd"] = chosen.read(columns["q_ned_frd"])
    if gyro != STRAIGHT:
        _turn(out, columns, "rate_frd_radps", gyro.turned)
        findings.append(warning("frames", f"gyro: {gyro.said()}"))
    if velocity_frame in ("enu", "nwu", "neu"):
        _turn(out, columns, "vel_ned_mps", lambda v: world_to_ned(v, velocity_frame))
        findings.append(warning("frames", f"velocity: was {velocity_frame.upper()}; turned into NED"))
    elif velocity_frame in ("frd", "flu"):
        _velocity_from_body(out, columns, velocity_frame)
        findings.append(
            warning("frames", f"velocity: was in the body frame ({velocity_frame.upper()}); turned into NED")
        )
    seen = Motion(seen.t_s, seen.dt_s, columns, seen.known)
    return _rates_unit(out, seen, findings), gyro


def _accelerometer_axes(out: dict[str, Signal], seen: Motion, gyro: Mounting, findings: list[Finding]) -> None:
    if not {"q_ned_frd", "vel_ned_mps", "accel_frd_mps2"} <= seen.columns.keys():
        return
    dt_s = seen.dt_s
    moved = rotate_inverse(seen["q_ned_frd"], np.gradient(seen["vel_ned_mps"], dt_s, axis=0) - G_NED)
    lies = accelerometer_mounting(_limited(moved, dt_s), _limited(seen["accel_frd_mps2"], dt_s), dt_s, gyro)
    if lies != STRAIGHT:
        _turn(out, dict(seen.columns), "accel_frd_mps2", lies.turned)
        findings.append(warning("frames", f"accelerometer: {lies.said()}"))


def _parts(seen: Motion) -> int:
    """The greatest sum that `_score` can give."""
    force = "accel_frd_mps2" in seen
    return ("rate_frd_radps" in seen) + force + (force and "vel_ned_mps" in seen)


class _Known:
    """What the scores of several conventions share: the measured sides, band-limited once."""

    def __init__(self, seen: Motion, tip: Mounting) -> None:
        dt_s = seen.dt_s
        self.seen, self.tip = seen, tip
        self.gyro: F64 | None = None
        if "rate_frd_radps" in seen:
            self.gyro = _limited(seen["rate_frd_radps"], dt_s)
        self.change = {}
        if "vel_ned_mps" in seen:
            change = _limited(np.gradient(seen["vel_ned_mps"], dt_s, axis=0), dt_s)
            self.change = {frame: world_to_ned(change, frame) for frame in _VECTORS}
        self.turns: dict[_Convention, tuple[float, Mounting]] = {}

    def turning(self, each: _Convention, q: F64) -> tuple[float, Mounting]:
        """(agreement of gyro and attitude, how the gyro lies); the world's frame makes no difference."""
        key = replace(each, world="ned")
        if key not in self.turns and self.gyro is not None:
            dt_s = self.seen.dt_s
            self.turns[key] = gyro_mounting(_limited(rates_of(q, dt_s), dt_s), self.gyro, dt_s, self.tip)
        return self.turns.get(key, (0.0, STRAIGHT))


def _score(each: _Convention, known: _Known) -> tuple[float, Mounting, str]:
    """(how well the signals agree, how the gyro lies, the velocity's frame) when the attitude is read this way."""
    seen, dt_s = known.seen, known.seen.dt_s
    q = each.read(seen["q_ned_frd"])
    total, mounting = known.turning(each, q)
    velocity_frame = "ned"
    if "accel_frd_mps2" not in seen:
        return total, mounting, velocity_frame
    world = rotate(q, seen["accel_frd_mps2"])
    total += max(-1.0, -float(world[:, 2].mean()) / STANDARD_GRAVITY_MPS2)
    if known.change:
        felt = _limited(world + G_NED, dt_s)
        given = {frame: agreement(change, felt, dt_s) for frame, change in known.change.items()}
        for frame in ("frd", "flu"):
            value = rotate(q, body_to_frd(seen["vel_ned_mps"], frame))
            given[frame] = agreement(_limited(np.gradient(value, dt_s, axis=0), dt_s), felt, dt_s)
        best = max(given, key=lambda frame: given[frame])
        velocity_frame = best if is_better(given[best], given["ned"]) else "ned"
        total += given[velocity_frame] - (0.02 if velocity_frame != "ned" else 0.0)
    return total, mounting, velocity_frame


def _turn(out: dict[str, Signal], columns: dict[str, F64], name: str, turn: Callable[[F64], F64]) -> None:
    old = out[name]
    out[name] = Signal(old.t_s, turn(old.value), old.source)
    columns[name] = turn(columns[name])


def _velocity_from_body(out: dict[str, Signal], columns: dict[str, F64], frame: str) -> None:
    from flightstack.gap.checks.grid import attitude_on_grid

    old = out["vel_ned_mps"]
    q, good = attitude_on_grid(out["q_ned_frd"], old.t_s)
    value = rotate(q, body_to_frd(old.value, frame))
    out["vel_ned_mps"] = Signal(old.t_s[good], value[good], old.source)
    columns["vel_ned_mps"] = rotate(columns["q_ned_frd"], body_to_frd(columns["vel_ned_mps"], frame))


def _unit(a: F64, b: F64, dt_s: float, units: Mapping[str, float], least: float) -> str | None:
    """The unit that b (N, 3) is in, where a in SI says so: by most of the axes on which the two agree, taken together.

    One axis that is off makes no foot of a metre.
    """
    axes = [correlation(a[:, [k]], b[:, [k]], dt_s) for k in range(3)]
    told = [_unit_of(each, units, least) for each in axes]
    agreeing = [unit for unit, each in zip(told, axes, strict=True) if each[0] > least]
    unit = max(agreeing or told, key=agreeing.count)
    voting = [k for k in range(3) if unit and told[k] == unit]
    if agreeing and len(voting) <= HALF * len(agreeing):
        return None
    return _unit_of(correlation(a[:, voting or [0, 1, 2]], b[:, voting or [0, 1, 2]], dt_s), units, least)


def _unit_of(told: tuple[float, float, float], units: Mapping[str, float], least: float) -> str | None:
    """The unit whose size explains that a should be b times the slope, within 15 %, where they agree by `least`.

    Where all that they lack of agreement is noise of b, a is b times the slope over the agreement's square: that must
    rule SI out as well.
    """
    agree, slope, _ = told
    if agree <= least or slope <= 0.0:
        return None
    if (1.0 - _OFF) * slope < 1.0 < (1.0 + _OFF) * slope / agree**2:
        return None
    distance = {unit: abs(float(np.log(slope * size))) for unit, size in units.items()}
    best = min(distance, key=lambda unit: distance[unit])
    return best if distance[best] < _OFF else None


def _rates_unit(out: dict[str, Signal], seen: Motion, findings: list[Finding]) -> Motion:
    if "rate_frd_radps" not in seen:
        return seen
    dt_s = seen.dt_s
    turning = _limited(rates_of(seen["q_ned_frd"], dt_s), dt_s)
    unit = _unit(turning, _limited(seen["rate_frd_radps"], dt_s), dt_s, _ANGULAR_UNITS, 0.5)
    if unit is None:
        return seen
    columns = dict(seen.columns)
    _turn(out, columns, "rate_frd_radps", lambda v: v / _ANGULAR_UNITS[unit])
    findings.append(warning("units", f"gyro: was in {unit}; turned into rad/s"))
    return Motion(seen.t_s, dt_s, columns, seen.known)


def _rates_alone(out: dict[str, Signal], seen: Motion, findings: list[Finding]) -> None:
    """Without an attitude only the size can tell: no vehicle turns at 15 rad/s all the time."""
    if "rate_frd_radps" not in seen:
        return
    if float(np.median(np.abs(seen["rate_frd_radps"]).max(axis=1))) > 15.0:
        _turn(out, dict(seen.columns), "rate_frd_radps", lambda v: v / _ANGULAR_UNITS["deg/s"])
        findings.append(warning("units", "gyro: was in deg/s, by its size; turned into rad/s"))


def _velocity_unit(out: dict[str, Signal], seen: Motion, findings: list[Finding]) -> Motion:
    """By the accelerometer and the attitude; the time's unit was settled before."""
    if not {"vel_ned_mps", "accel_frd_mps2", "q_ned_frd"} <= seen.columns.keys():
        return seen
    dt_s = seen.dt_s
    felt = _limited(rotate(seen["q_ned_frd"], seen["accel_frd_mps2"]) + G_NED, dt_s)
    unit = _unit(felt, _limited(np.gradient(seen["vel_ned_mps"], dt_s, axis=0), dt_s), dt_s, _SPEED_UNITS, 0.6)
    if unit is None:
        return seen
    columns = dict(seen.columns)
    _turn(out, columns, "vel_ned_mps", lambda v: v / _SPEED_UNITS[unit])
    findings.append(warning("units", f"velocity: was in {unit}; turned into m/s"))
    return Motion(seen.t_s, dt_s, columns, seen.known)


def _position(out: dict[str, Signal], seen: Motion, findings: list[Finding]) -> None:
    """Frame and unit of the position, by the velocity."""
    if not {"pos_ned_m", "vel_ned_mps"} <= seen.columns.keys():
        return
    dt_s = seen.dt_s
    velocity = _limited(seen["vel_ned_mps"], dt_s)
    change = _limited(np.gradient(seen["pos_ned_m"], dt_s, axis=0), dt_s)
    given = {frame: correlation(velocity, world_to_ned(change, frame), dt_s) for frame in _VECTORS}
    agreed = {frame: each[0] if each[0] > CONVENTION_CHANCE else 0.0 for frame, each in given.items()}
    best = max(agreed, key=lambda frame: agreed[frame])
    if is_better(agreed[best], agreed["ned"]):
        _turn(out, dict(seen.columns), "pos_ned_m", lambda v: world_to_ned(v, best))
        findings.append(warning("frames", f"position: was {best.upper()}; turned into NED"))
    else:
        best = "ned"
    unit = _unit(velocity, world_to_ned(change, best), dt_s, _LENGTH_UNITS, 0.6)
    if unit is not None:
        _turn(out, dict(seen.columns), "pos_ned_m", lambda v: v / _LENGTH_UNITS[unit])
        findings.append(warning("units", f"position: was in {unit}; turned into m"))
