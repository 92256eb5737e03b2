"""How good the samples are: saturation, clipping, aliasing, battery, and what the signals say of one another."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.checks.agreement import correlation
from flightstack.gap.checks.clocks import longest_run
from flightstack.gap.checks.grid import period_s
from flightstack.gap.checks.motion import G_NED, band, integrated, motion, rate_hz, rates_of
from flightstack.gap.checks.rotors import felt_gravity
from flightstack.gap.decisions import CLEAR_SHARE, EDGE_S, HALF, SMALL_SHARE
from flightstack.gap.records import Finding, Offset, Samples, Signal, refused, warning
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import rotate

_FULL, _STOPPED = 0.995, 0.005
_OFTEN = 0.02
_CLIPPED = 0.001
_RAW_HZ = 50.0
_DISAGREE = 0.6
_STRAYS_RADPS = 0.05
"""How far gyro and attitude are apart (rms, 0.2 to 4 Hz) where one is wrong; up to 0.03 in logs of PX4's."""
_NOISE = 2.0
"""Of rates about an axis, what is faster than 4 Hz against what is slower: up to 1.4 where they are sound, from 3.0 on
where they are noise."""
_CELL_V = (2.8, 4.5)
_BEYOND = 0.05
_STRAIGHT = 0.002
"""How far from a line commands are that were drawn straight and then lost decimals."""
_MOTOR_UNITS = {
    "pulse widths of 1000 to 2000 us": (790.0, 2300.0, 1000.0, 2000.0),
    "in percent": (-1.0, 101.0, 0.0, 100.0),
    "16-bit numbers": (-1.0, 65536.0, 0.0, 65535.0),
}
"""Name -> least, greatest value that it takes, value at command 0, at command 1."""


def settle_battery(signals: Mapping[str, Signal], vehicle: Vehicle) -> tuple[dict[str, Signal], list[Finding]]:
    """Voltages ten, a hundred or a thousand times too large are put right, by the file's battery or by any cell's."""
    out = dict(signals)
    signal = out.get("battery_v")
    if signal is None:
        return out, []
    volts = float(np.median(signal.value))
    if vehicle.battery is not None:
        low, high = 0.6 * vehicle.battery.empty_v, 1.4 * vehicle.battery.full_v
    else:
        low, high = _CELL_V[0], 14 * _CELL_V[1]
    if low <= volts <= high:
        return out, []
    for factor in (1e-3, 0.1, 10.0, 1e-2, 1e3):
        if low <= volts * factor <= high:
            out["battery_v"] = Signal(signal.t_s, signal.value * factor, signal.source)
            text = f"battery: {volts:.4g} V can't be; taken for {volts * factor:.4g} V"
            return out, [warning("units", text)]
    del out["battery_v"]
    return out, [warning("battery", f"battery: {volts:.4g} V can't be this vehicle's; not used")]


def settle_motors(signals: Mapping[str, Signal]) -> tuple[dict[str, Signal], list[Finding]]:
    """Commands that are no numbers from 0 to 1 are put right where their range says what they are, else refused."""
    out = dict(signals)
    signal = out.get("motor")
    if signal is None or not len(signal.t_s):
        return out, []
    if not _is_off(signal.value, -_BEYOND, 1.0 + _BEYOND).any():
        out["motor"] = Signal(signal.t_s, np.clip(signal.value, 0.0, 1.0), signal.source)
        return out, []
    lasts, findings = _recorded(signal.value), []
    if lasts < len(signal.value):
        text = (
            f"motor: the last {len(signal.value) - lasts} of {len(signal.value)} samples are one straight line beyond"
        )
        findings.append(warning("gaps", f"{text} 0 to 1: the stream ended before them; left out"))
        signal = Signal(signal.t_s[:lasts], signal.value[:lasts], signal.source)
    for name, (least, most, zero, full) in (("", (-_BEYOND, 1.0 + _BEYOND, 0.0, 1.0)), *_MOTOR_UNITS.items()):
        known = np.where(signal.value == 0.0, zero, signal.value)  # no pulse is no thrust
        off = _is_off(known, least, most)
        if np.mean(off) > SMALL_SHARE or longest_run(off) * period_s(signal) > 2.0 * EDGE_S:
            continue
        command = np.clip((known[~off] - zero) / (full - zero), 0.0, 1.0)
        out["motor"] = Signal(signal.t_s[~off], command, signal.source)
        if name:
            findings.append(warning("units", f"motors: were {name}; turned into commands 0 to 1"))
        if off.any():
            text = f"motor: {int(off.sum())} of {len(off)} samples are no commands; left out"
            findings.append(warning("spikes", text))
        return out, findings
    low, high = (float(np.quantile(signal.value, share)) for share in (0.001, 0.999))
    text = f"motor commands from {low:.4g} to {high:.4g} are no commands 0 to 1; say their range with --columns FILE"
    return out, [refused("motors", text)]


def _recorded(value: F64) -> int:
    """How many rows come before a straight line to the log's end that leaves 0 to 1: a stream that ends early is drawn
    on like that by who puts streams on one clock, and has most rows beyond 1, as percent and pulse widths have."""

    def straight(first: int) -> bool:
        line = np.linspace(value[first], value[-1], len(value) - first)
        return bool(np.abs(value[first:] - line).max() <= _STRAIGHT)

    first = bisect_left(range(len(value) - 1), True, key=straight)
    tail = value[first:]
    ended = len(tail) > SMALL_SHARE * len(value) and bool(_is_off(tail, -_BEYOND, 1.0 + _BEYOND).any())
    return first if ended and np.ptp(tail, axis=0).max() > _BEYOND else len(value)


def _is_off(value: F64, least: float, most: float) -> NDArray[np.bool_]:
    """(N,) rows of which a number is not between these."""
    return np.asarray(np.any((value < least) | (value > most), axis=1))


def judge_quality(samples: Samples, signals: Mapping[str, Signal]) -> list[Finding]:
    """Warnings on the flying part."""
    findings = _saturation(samples)
    span = (float(samples.t_s[0]), float(samples.t_s[-1]))
    for name in ("accel_frd_mps2", "rate_frd_radps"):
        if name in signals:
            findings += _clipping(name, signals[name], span)
            if 1.0 / period_s(signals[name]) < _RAW_HZ:
                findings.append(warning("aliasing", f"{name}: sampled so rarely that vibration folds into it; "
                                        "not to be trusted above a few Hz"))  # fmt: skip
    felt = felt_gravity(samples)
    if np.isfinite(felt) and not 0.7 < felt < 1.6 and "accel_frd_mps2" in signals:
        findings.append(refused("gravity", f"the accelerometer's mean is {felt:.2f} g: this is no flight, or its "
                                "unit is none that is known; give the specific force in m/s^2"))  # fmt: skip
    elif np.isfinite(felt) and not 0.97 < felt < 1.15 and "accel_frd_mps2" in signals:
        findings.append(
            Finding(
                "gravity",
                "warning",
                f"the accelerometer's mean is {felt:.3f} g; a flight that keeps its height has 1.0",
            )
        )
    return findings


def _saturation(samples: Samples) -> list[Finding]:
    motor = samples.motor[samples.valid]
    if not np.isfinite(motor).all() or not len(motor):
        return []
    out = []
    for word, share in (("full", np.mean(motor >= _FULL, axis=0)), ("stopped", np.mean(motor <= _STOPPED, axis=0))):
        if share.max() > _OFTEN:
            each = ", ".join(f"{100 * value:.0f}" for value in share)
            out.append(warning("saturation", f"motors are at {word} command in {each} % of the time"))
    return out


def _clipping(name: str, signal: Signal, span: tuple[float, float]) -> list[Finding]:
    """A sensor at its limit shows the same greatest value again and again."""
    value = signal.value[(signal.t_s >= span[0]) & (signal.t_s <= span[1])]
    for axis, column in zip("xyz", value.T, strict=True):
        if np.ptp(column) <= 0.0:
            continue
        for edge in (column.max(), column.min()):
            share = float(np.mean(column == edge))
            if share > _CLIPPED and share * len(column) >= 5:
                return [warning("clipping", f"{name}: {axis} stands at {edge:.4g} in {100 * share:.1f} % of the time: "
                                "the sensor is at its limit")]  # fmt: skip
    return []


def settle_gyro(signals: dict[str, Signal], span_s: tuple[float, float]) -> tuple[dict[str, Signal], list[Finding]]:
    """The signals without a gyro of which an axis says something else than the attitude, where another one does not.

    A dead or noisy axis passes for inertia: the motors push and nothing turns.  The attitude says how it turned.
    """
    used = {name: each for name, each in signals.items() if name in ("q_ned_frd", "rate_frd_radps")}
    slowest_hz = min((rate_hz(each) for each in used.values()), default=0.0)
    seen = motion(used, span_s, 1.0 / float(np.clip(2.0 * slowest_hz, 50.0, 125.0)))
    if seen is None or len(seen.columns) < 2:
        return signals, []
    both, high_hz = (rates_of(seen["q_ned_frd"], seen.dt_s), seen["rate_frd_radps"]), min(4.0, 0.2 * slowest_hz)
    turned, gyro = (band(each, seen.dt_s, 0.2, high_hz) for each in both)
    alike = np.array([correlation(turned[:, [axis]], gyro[:, [axis]], seen.dt_s)[0] for axis in range(3)])
    size, other = np.std(turned, axis=0), np.std(gyro, axis=0)
    strays = (alike < HALF) & (np.std(turned - gyro, axis=0) > _STRAYS_RADPS) & (size > _STRAYS_RADPS)
    strays &= np.std(both[0] - turned, axis=0) < _NOISE * size  # else the attitude is the one, or nobody knows which
    strays &= (other < HALF * size) | (np.std(both[1] - gyro, axis=0) > _NOISE * other)
    if not strays.any() or alike.max() < CLEAR_SHARE:
        return signals, []
    said = ", ".join(f"{axis} {each:.2f}" for axis, each in zip("xyz", alike, strict=True))
    text = f"the gyro does not follow the attitude about {' and '.join(np.array(list('xyz'))[strays])} (correlation "
    text += f"{said}): it is left out, body rates come from the attitude"
    return {name: each for name, each in signals.items() if name != "rate_frd_radps"}, [warning("gyro", text)]


def judge_consistency(
    signals: Mapping[str, Signal], span_s: tuple[float, float], offsets: tuple[Offset, ...]
) -> list[Finding]:
    """How well the signals agree once all is put right."""
    seen = motion(
        signals,
        span_s,
        1.0 / float(np.clip(2.0 * min((rate_hz(s) for s in signals.values()), default=50.0), 50.0, 100.0)),
    )
    if seen is None:
        return []
    dt_s, out = seen.dt_s, []
    if {"q_ned_frd", "rate_frd_radps"} <= seen.columns.keys():
        out.append(
            _agreement("gyro and attitude", rates_of(seen["q_ned_frd"], dt_s), seen["rate_frd_radps"], dt_s, "rad/s")
        )
    if {"q_ned_frd", "accel_frd_mps2", "vel_ned_mps"} <= seen.columns.keys():
        felt = integrated(rotate(seen["q_ned_frd"], seen["accel_frd_mps2"]) + G_NED, dt_s)
        out.append(_agreement("velocity, specific force and attitude", felt, seen["vel_ned_mps"], dt_s, "m/s"))
    if {"pos_ned_m", "vel_ned_mps"} <= seen.columns.keys():
        out.append(
            _agreement("position and velocity", integrated(seen["vel_ned_mps"], dt_s), seen["pos_ned_m"], dt_s, "m")
        )
    return out


def _agreement(what: str, a: F64, b: F64, dt_s: float, unit: str) -> Finding:
    a, b = band(a, dt_s, 0.2, 4.0), band(b, dt_s, 0.2, 4.0)
    rest, size = float(np.sqrt(np.mean((a - b) ** 2))), float(np.sqrt(np.mean(b * b)))
    text = f"{what} agree to {rest:.3g} {unit} of {size:.3g} {unit} rms (0.2 to 4 Hz)"
    return Finding("consistency", "ok" if rest < _DISAGREE * size else "warning", text)
