"""A flight made ready for comparison: smoothed states, what the sensors say of its motion, and the common low-pass.

Twelve columns are compared.  The first six (`gap.records.SIGNALS`) are the physics: specific force and angular
acceleration.  The last six (`gap.records.KINEMATICS`) hold no physics at all: body rates against the attitude's
derivative and specific force against the velocity's; only sensor effects show there, which is what tells them from
forces and torques.

A derivative is a central difference, and whatever it is compared with passes Simpson's mean over the same two steps;
then both pass the same zero-phase Butterworth low-pass.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flightstack.gap import filters
from flightstack.gap.fusion import CROSSOVER_HZ, complementary, fused, integrated
from flightstack.gap.records import Samples
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_logs.turn import conjugate, continuous, multiply, rotate, rotate_inverse, rotation_vector

COLUMNS = 12
CUTOFF_HZ = 20.0
"""Of the common low-pass, where the log's bandwidth allows it: above it the gyro's derivative is mostly noise."""
SETTLE_S = 1.0
"""At the start of a log nobody knows what the rotors did before: never judged."""
_SLOWEST_STEP_S = 0.004
_HELD_SHARE = 0.3
_SAME_MPS2 = 1e-6
_ROWS = (
    "t_s", "pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "accel_frd_mps2", "motor", "battery_v",
    "height_m", "valid",
)  # fmt: skip
_TRACK_ROWS = (
    "pos_ned_m",
    "path_ned_m",
    "vel_ned_mps",
    "q_ned_frd",
    "rate_frd_radps",
    "acc_ned_mps2",
    "vel_rate_ned_mps2",
    "turn_frd_radps",
    "measured",
    "usable",
)
_HIGH_M = 1e6
_SAME_M = 1e-6
GRAVITY_NED_MPS2 = np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])


@dataclass(frozen=True, slots=True, eq=False)
class ProcessedFlight:
    """One flight, ready: arrays of N samples."""

    samples: Samples
    pos_ned_m: F64
    """(N, 3) smoothed; its last entry is minus the height over ground (very high where that is unknown)."""
    path_ned_m: F64
    """(N, 3) smoothed position in the log's own coordinates."""
    vel_ned_mps: F64
    vel_std_mps: F64
    """(3,) NED, of the smoothed velocity's error; 0 where unknown."""
    q_ned_frd: F64
    rate_frd_radps: F64
    acc_ned_mps2: F64
    """(N, 3) acceleration over ground, of the accelerometer where there is one."""
    vel_rate_ned_mps2: F64
    """(N, 3) derivative of the measured velocity, not smoothed further."""
    turn_frd_radps: F64
    """(N, 3) body rates that the attitude's derivative says."""
    measured: F64
    """(N, 12) what the sensors say, before the low-pass; NaN columns where they don't."""
    averaged: tuple[bool, ...]
    """Of each of the six physical columns: is it measured by a central difference?"""
    blind: NDArray[np.int64]
    """Columns that the log can't measure."""
    usable: NDArray[np.bool_]
    """(N,) valid, rotors known, and away from gaps and ends by what the filters reach."""
    commands: F64
    """(N * every, 4) motor commands for the run-through."""
    every: int
    """Steps of the run-through in a sample."""
    side: float
    """`simpson`'s weight for what is compared with a central difference."""
    cutoff_hz: float
    missing: frozenset[str]
    """Names of signals that the log lacks, those derived from others included."""

    @property
    def step_s(self) -> float:
        """Length of a step of the run-through."""
        return self.samples.dt_s / self.every

    def smooth(self, columns: F64) -> F64:
        """The common low-pass along the first axis, of finite numbers."""
        return _both_ways(columns, self.cutoff_hz, self.samples.dt_s)

    def lowpass(self, columns: F64) -> F64:
        """The common low-pass along the first axis; NaN columns stay NaN."""
        return lowpass(columns, self.cutoff_hz, self.samples.dt_s)


def simpson(x: F64, side: float = 1.0 / 6.0) -> F64:
    """Mean over two steps round each sample along the first axis: what a central difference of its integral sees.

    `side` is the weight of either neighbour: of Simpson's rule, or less where the difference's steps are shorter.
    """
    out = (1.0 - 2.0 * side) * x
    out[0], out[-1] = x[0], x[-1]
    out[1:-1] += side * (x[:-2] + x[2:])
    return out


def derivative(x: F64, dt_s: float) -> F64:
    """Central differences along the first axis, one-sided at the ends."""
    return np.asarray(np.gradient(x, dt_s, axis=0))


@lru_cache(maxsize=8)
def track(samples: Samples) -> ProcessedFlight:
    """Make a flight ready; kept for the last few flights, as every step of the workflow asks for it.

    A flight whose commands or bias alone are another's changed is ready but for these.
    """
    like = next((flight for flight in _READY if _same_but_commands(flight.samples, samples)), None)
    if like is None:
        like = _made(samples)
        _READY.append(like)
        return like
    commands = step_commands(samples, like.every, samples.command_late_s)
    measured = _less_bias(like.measured, like.samples.bias_frd_mps2, samples.bias_frd_mps2)
    usable = _usable(samples, like.cutoff_hz)
    return replace(like, samples=samples, commands=commands, usable=usable, measured=measured)


def _less_bias(measured: F64, was: F64 | None, now: F64 | None) -> F64:
    """Measured (N, 12) whose specific force is less this slow error instead of that one."""
    if was is now:
        return measured
    out = measured.copy()
    out[:, 0:3] += (0.0 if was is None else was) - (0.0 if now is None else now)
    return out


_READY: deque[ProcessedFlight] = deque(maxlen=4)


def _same_but_commands(a: Samples, b: Samples) -> bool:
    """Whether all but the motors' commands, their lateness and the bias is the very same."""
    names = (f.name for f in fields(a) if f.name not in ("motor", "command_late_s", "bias_frd_mps2"))
    return all(getattr(a, name) is getattr(b, name) for name in names)


def _made(samples: Samples) -> ProcessedFlight:
    dt = samples.dt_s
    missing = _missing(samples)
    cutoff = _cutoff(samples)
    q = _smooth_attitude(samples, cutoff, missing)
    turn = _turn(q, dt)
    rate = turn if "rate_frd_radps" in missing else _filled(samples.rate_frd_radps)
    velocity = _velocity(samples, missing)
    vel_rate = derivative(velocity, dt)
    force, differentiated = _force(samples, q, vel_rate, missing)
    acc = rotate(q, force) + GRAVITY_NED_MPS2
    inertial = not differentiated and not {"q_ned_frd", "vel_ned_mps"} & missing
    smooth, velocity_std = lowpass(velocity, cutoff, dt), np.zeros(3)
    if inertial:
        whole = "pos_ned_m" not in missing and not {"pos_ned_m", "vel_ned_mps"} & set(samples.derived)
        position = _filled(samples.pos_ned_m) if whole else None
        smooth, velocity_std = fused(velocity, position, acc, dt, (q, force, samples.valid))
    path = complementary(_filled(samples.pos_ned_m), smooth, CROSSOVER_HZ, dt)
    measured = _less_bias(_measured(force, rate, dt, missing, differentiated), None, samples.bias_frd_mps2)
    if "motor" in missing:  # no simulation without commands; from their mean it is that of the side force
        measured[:, slice(2, 6) if np.isfinite(samples.motor).any() else slice(6)] = np.nan
    every = max(1, int(np.ceil(dt / _SLOWEST_STEP_S - 1e-6)))
    return ProcessedFlight(
        samples,
        _position(path, samples, missing),
        integrated(smooth, dt) if "pos_ned_m" in missing else path,
        smooth,
        velocity_std,
        q,
        lowpass(rate, cutoff, dt),
        acc,
        vel_rate,
        turn,
        measured,
        (differentiated,) * 3 + (True,) * 3,
        np.flatnonzero(np.isnan(measured).all(axis=0)),
        _usable(samples, cutoff),
        step_commands(samples, every, samples.command_late_s),
        every,
        1.0 / 6.0,
        cutoff,
        missing,
    )


@lru_cache(maxsize=2)
def thinned(flight: ProcessedFlight, k: int) -> ProcessedFlight:
    """Every k-th sample of a flight; rotors still run through all its commands.  Kept for the last two flights."""
    samples = flight.samples
    rows = {name: getattr(samples, name)[::k] for name in _ROWS}
    thin: dict[str, Any] = {name: np.ascontiguousarray(getattr(flight, name)[::k]) for name in _TRACK_ROWS}
    count = len(rows["t_s"])
    padding = np.repeat(flight.commands[-1:], max(0, count * k * flight.every - len(flight.commands)), axis=0)
    return replace(
        flight,
        samples=replace(samples, dt_s=samples.dt_s * k, **rows),
        commands=np.vstack([flight.commands, padding]),
        every=flight.every * k,
        side=flight.side / k**2,  # the same loss at low frequencies
        **thin,
    )


def _missing(samples: Samples) -> frozenset[str]:
    names = ("pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "accel_frd_mps2", "height_m", "motor")
    gone = {name for name in names if not np.isfinite(getattr(samples, name)).any()}
    gone |= {name for name in ("rate_frd_radps", "accel_frd_mps2", "motor", "command") if name in samples.derived}
    if "vel_ned_mps" in gone and "pos_ned_m" not in gone:
        gone.remove("vel_ned_mps")
    return frozenset(gone if np.any(samples.battery_v > 0.0) else gone | {"battery_v"})


def _force(samples: Samples, q: F64, vel_rate: F64, missing: frozenset[str]) -> tuple[F64, bool]:
    """Measured specific force (N, 3), and whether it is the velocity's derivative.

    A derived one is turned again with the smoothed attitude; it may also come from an acceleration that was logged.
    """
    if "accel_frd_mps2" not in missing:
        return _filled(samples.accel_frd_mps2), False
    if not np.isfinite(samples.accel_frd_mps2).any():
        return rotate_inverse(q, vel_rate - GRAVITY_NED_MPS2), True
    raw = _filled(continuous(samples.q_ned_frd))
    acc = rotate(raw, _filled(samples.accel_frd_mps2)) + GRAVITY_NED_MPS2
    if np.median(np.abs(acc - vel_rate)) < _SAME_MPS2:
        acc = vel_rate
    return rotate_inverse(q, acc - GRAVITY_NED_MPS2), acc is vel_rate


def _measured(force: F64, rate: F64, dt_s: float, missing: frozenset[str], differentiated: bool) -> F64:
    """(N, 12) before the low-pass."""
    out = np.full((len(force), COLUMNS), np.nan)
    if not differentiated or not {"q_ned_frd", "vel_ned_mps"} & missing:
        out[:, 0:3] = force
    if not {"rate_frd_radps", "q_ned_frd"} <= missing:
        out[:, 3:6] = derivative(rate, dt_s)
    if not {"rate_frd_radps", "q_ned_frd"} & missing:
        out[:, 6:9] = simpson(rate)
    if not {"accel_frd_mps2", "vel_ned_mps", "q_ned_frd"} & missing:
        out[:, 9:12] = simpson(force)
    return out


def _cutoff(samples: Samples) -> float:
    """What the log carries, kept well below its Nyquist frequency."""
    band = samples.bandwidth_hz if samples.bandwidth_hz > 0.0 else 0.5 / samples.dt_s
    return min(CUTOFF_HZ, 0.8 * band, 0.35 / samples.dt_s)


def lowpass(columns: F64, cutoff_hz: float, dt_s: float) -> F64:
    """Zero-phase second-order Butterworth, forwards and backwards, along the first axis; NaN columns stay NaN."""
    flat = columns.reshape(len(columns), -1)
    out = np.full_like(flat, np.nan)
    seen = np.isfinite(flat).any(axis=0)
    still = seen & ~np.any(flat, axis=0)  # no need to filter nothing, and sensitivities are mostly that
    out[:, still] = 0.0
    seen &= ~still
    if not seen.any():
        return out.reshape(columns.shape)
    out[:, seen] = _both_ways(_filled(flat[:, seen]), cutoff_hz, dt_s)
    return out.reshape(columns.shape)


def _both_ways(x: F64, cutoff_hz: float, dt_s: float) -> F64:
    pad = min(len(x) - 1, int(3.0 / (cutoff_hz * dt_s)) + 3)
    return filters.both_ways(filters.lowpass(cutoff_hz, dt_s), x, pad)


def _filled(x: F64) -> F64:
    """NaN rows by linear interpolation, all-NaN columns as 0."""
    bad = ~np.isfinite(x)
    if not bad.any():
        return x
    out = x.copy()
    at = np.arange(len(x))
    for j in range(x.shape[1]):
        good = ~bad[:, j]
        out[:, j] = np.interp(at, at[good], x[good, j]) if good.any() else 0.0
    return out


def _position(path: F64, samples: Samples, missing: frozenset[str]) -> F64:
    """The smoothed path over ground: a height that is the position's own is as smooth, another's is taken as it is."""
    pos = path.copy()
    if "height_m" in missing:
        pos[:, 2] = -_HIGH_M
        return pos
    down = -_filled(samples.height_m[:, None])[:, 0]
    over = down - _filled(samples.pos_ned_m)[:, 2]
    if "pos_ned_m" not in missing and np.ptp(over) < _SAME_M:
        pos[:, 2] += float(np.median(over))
    else:
        pos[:, 2] = down
    return pos


def _velocity(samples: Samples, missing: frozenset[str]) -> F64:
    if not np.isfinite(samples.vel_ned_mps).any() and "pos_ned_m" not in missing:
        return derivative(_filled(samples.pos_ned_m), samples.dt_s)
    return _filled(samples.vel_ned_mps)


def _smooth_attitude(samples: Samples, cutoff_hz: float, missing: frozenset[str]) -> F64:
    if "q_ned_frd" in missing:
        return np.tile([1.0, 0.0, 0.0, 0.0], (len(samples.t_s), 1))
    q = _filled(continuous(samples.q_ned_frd))
    q = lowpass(q, cutoff_hz, samples.dt_s)
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))


def _turn(q: F64, dt_s: float) -> F64:
    """Body rates of an attitude's central differences."""
    out = np.empty((len(q), 3))
    out[1:-1] = rotation_vector(multiply(conjugate(q[:-2]), q[2:])) / (2.0 * dt_s)
    out[0], out[-1] = out[1], out[-2]
    return out


def step_commands(samples: Samples, every: int, late_s: float = 0.0) -> F64:
    """(N * every, 4) commands of the run-through's steps, all `late_s` late.

    Between samples they are interpolated: a log holds samples of a faster loop's commands.  Where the log itself holds
    them for several samples, they are held.
    """
    motor = _filled(samples.motor)
    count = len(motor)
    held = np.mean(np.all(motor[1:] == motor[:-1], axis=1)) > _HELD_SHARE
    at = np.repeat(np.arange(count), every) + (0.0 if held else np.tile((np.arange(every) + 0.5) / every, count))
    at = np.clip(at - late_s / samples.dt_s, 0.0, count - 1.0)
    before = at.astype(np.int64)
    share = (at - before)[:, None]
    after = np.minimum(before + 1, count - 1)
    return np.asarray((1.0 - share) * motor[before] + share * motor[after])


def _usable(samples: Samples, cutoff_hz: float) -> NDArray[np.bool_]:
    reach = int(np.ceil(0.5 / (cutoff_hz * samples.dt_s)))
    commanded = np.isfinite(samples.motor)
    good = samples.valid & (commanded.all(axis=1) | ~commanded.any())
    bad = np.convolve(~good, np.ones(2 * reach + 1), mode="same") > 0.5
    out = ~bad & (samples.t_s >= samples.t_s[0] + SETTLE_S)
    out[len(out) - reach :] = False
    return np.asarray(out)
