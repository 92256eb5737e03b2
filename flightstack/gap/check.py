"""The data check: what a log is worth, before any physics is fitted to it.

It refuses what can't be used, mends what can be mended and says so, finds by how much each topic's stamps are late,
and hands on the flying part on one grid.  No vehicle parameter is used for any of it but to tell whether the motors
hold the vehicle up and whether its rotors are the log's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from flightstack.gap.checks import conventions, quality, speeds
from flightstack.gap.checks.clocks import judge_rates, settle_clocks
from flightstack.gap.checks.exclusions import exclude_ground_contact, exclude_stopped_rotors, standing_m
from flightstack.gap.checks.grid import SLOWEST_MOTOR_S, period_s
from flightstack.gap.checks.motion import KINEMATIC, LEAST_ROWS
from flightstack.gap.checks.offsets import find_offsets, is_certain, shifted
from flightstack.gap.checks.rotors import judge_vehicle, moves
from flightstack.gap.checks.samples import flying_span, make_samples
from flightstack.gap.checks.spikes import without_spikes
from flightstack.gap.decisions import CLEAR_M, HALF, LEAST_FLIGHT_S, SHORT_FLIGHT_S, STOOD_S
from flightstack.gap.records import Checked, Finding, Flight, Offset, Signal, how_to_record, ok, refused, warning
from flightstack.gap.sources import FREED
from flightstack.vehicle import Vehicle

_GROUND_OFF_M = {"mcap": 0.05, "ulog": 0.05, "dataflash": 0.3, "tlog": 0.3}
"""Logs whose heights are an autopilot's own, and from which distance the ground is not at its frame's origin: in the
last two heights and landing are told so rarely that 0.1 m may be a touch."""
_MISSED = {
    "q_ned_frd": "attitude: drag and wind can't be told",
    "rate_frd_radps": "body rates: they come from the attitude",
    "accel_frd_mps2": "accelerometer: specific force comes from velocity and attitude",
    "vel_ned_mps": "velocity: it comes from the position",
    "pos_ned_m": "position: no ground effect",
}

_ABSURD = 1e9
"""Beyond it no unit makes a value one of a flight."""
_LARGEST = {"rate_frd_radps": 300.0, "accel_frd_mps2": 5e3, "vel_ned_mps": 1e3, "acc_ned_mps2": 5e3}
"""What is larger, once units are known, no sensor measures on a vehicle: gyros end at 70 rad/s, accelerometers at
2,000 m/s^2."""

_FREED_SAYS = (
    "PX4's idea of the accelerometer's bias was subtracted: no steady side force below 0.4 m/s^2 can be told from its "
    "errors; a ULog holds the accelerometer as it is"
)


def check(flight: Flight, vehicle: Vehicle, *, ground_d_m: float = 0.0, kinematics_only: bool = False) -> Checked:
    """Check one flight against the vehicle file.

    `ground_d_m`: where the ground lies (down, m).  `kinematics_only`: a log without motor commands is no refusal.
    A refused log has no samples and at least one finding of level refused that says what to record instead.
    """
    signals, findings = settle_clocks(flight.signals, flight.kind)
    signals, more = speeds.commands_of_speeds(signals, vehicle)
    findings += more
    signals, more = _without_absurd(signals, dict.fromkeys(signals, _ABSURD))
    findings += [*more, *_lacking(signals, flight.kind, kinematics_only)]
    if _is_refused(findings):
        return Checked(flight, None, tuple(findings), ())
    signals, more = quality.settle_battery(signals, vehicle)
    findings += more
    signals, more = quality.settle_motors(signals)
    findings += more
    if _is_refused(findings):
        return Checked(flight, None, tuple(findings), ())
    ground_d_m = _ground(flight.kind, signals, ground_d_m, findings)
    span = flying_span(signals, vehicle, ground_d_m)
    if span is None:
        findings.append(_not_flying(flight.kind))
        return Checked(flight, None, tuple(findings), ())
    signals, spikes = without_spikes(signals, span)
    signals, more = conventions.settle(signals, span)
    findings += [*spikes, *more, *judge_rates(signals, span, flight.kind)]
    strange_gyro = partial(quality.settle_gyro, span_s=span)
    for without in (partial(_without_absurd, largest=_LARGEST), _without_few_rows, _without_rare_imu, strange_gyro):
        signals, more = without(signals)
        findings += more
    offsets = find_offsets(signals, span)
    findings += [_late(each) for each in offsets if is_certain(each)]
    signals = shifted(signals, offsets)
    read = replace(flight, signals=signals)
    samples = make_samples(flight.name, signals, vehicle, ground_d_m, estimated=flight.kind in _GROUND_OFF_M)
    if samples is None:
        findings.append(_not_flying(flight.kind))
        return Checked(read, None, tuple(_with_reading(findings)), offsets)
    samples, more = exclude_ground_contact(samples, vehicle, standing_m(signals, vehicle, span, ground_d_m))
    findings += more
    samples, more = exclude_stopped_rotors(samples, vehicle)
    findings += more
    if not samples.valid.any():
        findings.append(_not_flying(flight.kind))
        return Checked(read, None, tuple(_with_reading(findings)), offsets)
    if "motor" in signals:
        if not moves(samples):
            text = f"the motors never move: this is not a flight. Record one ({how_to_record(flight.kind)})"
            findings.append(refused("flight", text))
        else:
            findings += judge_vehicle(samples, vehicle)
    findings.append(_in_the_air(float(np.sum(samples.valid)) * samples.dt_s))
    if FREED in samples.derived:
        findings.append(ok("bias", _FREED_SAYS))
    findings += quality.judge_quality(samples, signals)
    findings += quality.judge_consistency(signals, span, offsets)
    findings = _with_reading(findings)
    return Checked(read, None if _is_refused(findings) else samples, tuple(findings), offsets)


def _in_the_air(seconds: float) -> Finding:
    """How long a flight is, and whether that is enough."""
    if seconds < LEAST_FLIGHT_S:
        return refused("flight", f"only {seconds:.3g} s in the air; it takes {LEAST_FLIGHT_S:.0f}, better a minute")
    if seconds < SHORT_FLIGHT_S:
        return warning("flight", f"only {seconds:.3g} s in the air; little can be told apart")
    return ok("flight", f"{seconds:.1f} s in the air")


def _without_absurd(
    signals: dict[str, Signal], largest: Mapping[str, float]
) -> tuple[dict[str, Signal], list[Finding]]:
    """A value that is none of a flight is a fill value, lost bits or another unit: squared it spoils every sum.

    Where most samples are such, the signal is left out.
    """
    out, findings = dict(signals), []
    for name, most in largest.items():
        if name not in out or not len(out[name].t_s):
            continue
        each = out[name]
        wrong = np.any(np.abs(each.value.reshape(len(each.t_s), -1)) > most, axis=1)
        if not wrong.any():
            continue
        left = ~wrong if wrong.mean() < HALF else np.zeros_like(wrong)
        out[name] = Signal(each.t_s[left], each.value[left], each.source)
        text = f"{name}: {int(wrong.sum())} of {len(wrong)} samples are beyond {most:g}"
        findings.append(warning("spikes", f"{text}; {'left out' if left.any() else 'all of it is left out'}"))
    return {name: each for name, each in out.items() if len(each.t_s)}, findings


def _without_few_rows(signals: dict[str, Signal]) -> tuple[dict[str, Signal], list[Finding]]:
    """What is left of a damaged signal may be a few rows: it is not there."""
    few = {name: len(signals[name].t_s) for name in KINEMATIC if name in signals}
    few = {name: rows for name, rows in few.items() if rows < LEAST_ROWS}
    findings = [warning("signals", f"{name}: only {rows} rows can be used; left out") for name, rows in few.items()]
    return {name: each for name, each in signals.items() if name not in few}, findings


def _without_rare_imu(signals: dict[str, Signal]) -> tuple[dict[str, Signal], list[Finding]]:
    """A gyro below 19 Hz is not used where the attitude, an accelerometer where attitude and velocity, are logged more
    than twice as often: these say what it would, and more.

    Straight lines between rare samples turn and push less than the vehicle did, which passes for inertia or a lag.
    """
    out, findings = dict(signals), []
    for name, others in (
        ("rate_frd_radps", ("q_ned_frd",)),
        ("accel_frd_mps2", ("q_ned_frd", "vel_ned_mps")),
    ):
        if name not in signals or not set(others) <= signals.keys():
            continue
        period = period_s(signals[name])
        if period > SLOWEST_MOTOR_S and all(period_s(signals[other]) < HALF * period for other in others):
            del out[name]
            text = f"{name}: {1.0 / period:.3g} Hz is rarer than {' and '.join(others)}, of which it is made instead"
            findings.append(warning("rate", text))
    return out, findings


def _is_refused(findings: list[Finding]) -> bool:
    return any(each.level == "refused" for each in findings)


def _with_reading(findings: list[Finding]) -> list[Finding]:
    """What is refused with units or frames that the log does not say: they may be what is wrong, as with stamps that
    are off by a second."""
    changed = "; ".join(each.text for each in findings if each.name in ("units", "frames", "quaternion"))
    if not changed:
        return findings
    return [
        replace(each, text=f"{each.text}.  It was not read as it says: {changed}") if each.level == "refused" else each
        for each in findings
    ]


def _not_flying(kind: str) -> Finding:
    text = "no part of the log is a flight: landed, or motors too weak to hold the vehicle. Record 30 s in the air"
    return refused("flight", f"{text} ({how_to_record(kind)})")


def _late(each: Offset) -> Finding:
    word = "late" if each.offset_s > 0.0 else "early"
    low, size, high = sorted(1e3 * abs(value) for value in (each.low_s, each.offset_s, each.high_s))
    return warning("offset", f"{each.signal}: stamps {size:.1f} ms {word} ({low:.1f} to {high:.1f}); put right")


def _lacking(signals: Mapping[str, Signal], kind: str, kinematics_only: bool) -> list[Finding]:
    """What can't be done without."""
    out = []
    if not {"vel_ned_mps", "pos_ned_m", "accel_frd_mps2", "acc_ned_mps2"} & signals.keys():
        text = f"holds neither velocity nor acceleration; record position and IMU ({how_to_record(kind)})"
        out.append(refused("signals", text))
    elif not {"q_ned_frd", "rate_frd_radps", "accel_frd_mps2"} & signals.keys():
        text = (
            f"holds no whole attitude, no gyro and no accelerometer; record roll, pitch and yaw ({how_to_record(kind)})"
        )
        out.append(refused("signals", text))
    if "motor" not in signals:
        text = f"holds no motor commands; record them ({how_to_record(kind)}), or use --kinematics-only"
        out.append(Finding("motors", "warning" if kinematics_only else "refused", text))
    out += [warning("signals", f"holds no {what}") for name, what in _MISSED.items() if name not in signals]
    return out


def _ground(kind: str, signals: Mapping[str, Signal], ground_d_m: float, findings: list[Finding]) -> float:
    """Where an autopilot's own frame has the ground: at its position while it stood before it took off.

    NaN, for not known, where by that the vehicle flies at the ground or below it.
    """
    if kind not in _GROUND_OFF_M or ground_d_m or not {"landed", "pos_ned_m"} <= signals.keys():
        return ground_d_m
    position, landed = signals["pos_ned_m"], signals["landed"]
    at = np.clip(np.searchsorted(landed.t_s, position.t_s, side="right") - 1, 0, len(landed.t_s) - 1)
    stands = landed.value[at] > 0.5
    up = np.flatnonzero(~stands)
    if not len(up):
        return ground_d_m
    stood = stands & (position.t_s < position.t_s[up[0]]) & (position.t_s > position.t_s[up[0]] - STOOD_S)
    if stood.sum() >= 10:
        down = float(np.median(position.value[stood, 2]))
        if abs(down) > _GROUND_OFF_M[kind]:
            text = f"the ground lies at {down:.2f} m down, where the vehicle stood before take-off"
            findings.append(ok("ground", text))
            ground_d_m = down
    low = float(np.mean(ground_d_m - position.value[up, 2] < CLEAR_M))
    if low > 0.5:
        text = f"by its position the vehicle is at or below the ground in {100.0 * low:.0f} % of its flight: not used"
        findings.append(warning("height", text))
        return math.nan
    return ground_d_m
