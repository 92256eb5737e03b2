"""From topics with stamps of their own to one uniform grid.

Topics faster than the grid are averaged over its period (so that nothing above half its rate folds down), slower ones
interpolated; motor commands are what acted from one grid point to the next.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.records import Signal
from flightstack.types import F64
from flightstack_logs.turn import continuous

GRID_HZ = (125.0, 250.0)
"""The grid's rate is the fastest of IMU, attitude and motors, kept within these."""
SLOWEST_MOTOR_S = 1.0 / 19.0
"""Motors slower than the rest, but not slower than this, set the grid's rate: what they did between is not known."""
_GAP_PERIODS = 3.5
_ENOUGH = 20_001
"""Stamps from which a period is taken."""
_FAST = 1.6
"""A topic this much faster than the grid is averaged."""


def period_s(signal: Signal) -> float:
    """The usual distance of two stamps; infinite where there are not two."""
    return float(np.median(np.diff(signal.t_s[:_ENOUGH]))) if len(signal.t_s) > 1 else np.inf


def grid_period_s(signals: dict[str, Signal]) -> float:
    """Whole fractions of the log's own period are kept: a log of 100 Hz stays one of 100 Hz."""
    names = ("accel_frd_mps2", "rate_frd_radps", "q_ned_frd", "vel_ned_mps", "motor")
    periods = [period_s(signals[name]) for name in names if name in signals]
    fastest = min((period for period in periods if np.isfinite(period)), default=1.0 / GRID_HZ[0])
    motors = period_s(signals["motor"]) if "motor" in signals else np.inf
    if fastest < motors < SLOWEST_MOTOR_S:
        fastest = motors
    least, most = 1.0 / GRID_HZ[1], 1.0 / GRID_HZ[0]
    if fastest < 0.8 * least:
        return least
    return float(round(fastest, 6)) if fastest > 0.8 * most else float(round(max(fastest, least), 6))


def on_grid(signal: Signal, t_s: F64) -> tuple[F64, NDArray[np.bool_]]:
    """Values (N, ...) at the grid's times, and where they stand on samples near enough."""
    value = signal.value
    period, step = period_s(signal), float(t_s[1] - t_s[0])
    if _FAST * period < step:
        value_at = _averaged(signal.t_s, value, t_s, step)
    elif value.ndim == 1:
        value_at = np.interp(t_s, signal.t_s, value)
    else:
        value_at = np.stack([np.interp(t_s, signal.t_s, column) for column in value.T], axis=-1)
    return value_at, near(signal, t_s)


def held(signal: Signal, t_s: F64) -> F64:
    """The last value at or before each time."""
    at = np.searchsorted(signal.t_s, t_s + 1e-9, side="right") - 1
    return np.asarray(signal.value[np.clip(at, 0, len(signal.t_s) - 1)])


def near(signal: Signal, t_s: F64) -> NDArray[np.bool_]:
    """Whether a grid time lies between two samples not further apart than three of the topic's periods."""
    most = _GAP_PERIODS * period_s(signal)
    after = np.searchsorted(signal.t_s, t_s, side="left")
    last = len(signal.t_s) - 1
    gap = signal.t_s[np.clip(after, 0, last)] - signal.t_s[np.clip(after - 1, 0, last)]
    on_sample = np.abs(signal.t_s[np.clip(after, 0, last)] - t_s) < 1e-7
    inside = (t_s >= signal.t_s[0] - 1e-9) & (t_s <= signal.t_s[-1] + 1e-9)
    return np.asarray(inside & ((gap <= most) | on_sample))


def _averaged(stamps: F64, value: F64, t_s: F64, step: float) -> F64:
    """Mean over one grid period round each grid time, of the straight lines between the samples."""
    ends = np.clip(np.concatenate([t_s - 0.5 * step, [t_s[-1] + 0.5 * step]]), stamps[0], stamps[-1])
    covered = np.maximum(np.diff(ends), 1e-3 * step)[:, None]
    columns = value.reshape(len(stamps), -1)
    width = np.diff(stamps)[:, None]
    area = np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(0.5 * width * (columns[1:] + columns[:-1]), 0)])
    at = np.clip(np.searchsorted(stamps, ends, side="right") - 1, 0, len(stamps) - 2)
    into = np.clip(ends - stamps[at], 0.0, np.diff(stamps)[at])[:, None]
    slope = (columns[at + 1] - columns[at]) / np.diff(stamps)[at][:, None]
    integral = area[at] + into * (columns[at] + 0.5 * slope * into)
    return np.asarray((np.diff(integral, axis=0) / covered).reshape((len(t_s), *value.shape[1:])))


def attitude_on_grid(signal: Signal, t_s: F64) -> tuple[F64, NDArray[np.bool_]]:
    """Attitudes as neighbouring signs interpolated and made unit again."""
    q, good = on_grid(Signal(signal.t_s, continuous(signal.value), signal.source), t_s)
    size = np.linalg.norm(q, axis=1, keepdims=True)
    return q / np.where(size > 1e-9, size, 1.0), good & (size[:, 0] > 0.5)


def motors_on_grid(signal: Signal, t_s: F64) -> tuple[F64, NDArray[np.bool_]]:
    """The command that acts, on average, from each grid time to the next.

    A command is held until the next one.  Where the log has them rarer than the grid, commands between were sent and
    not logged: straight lines between the logged ones are late by nothing, holding them would be by half a period.
    """
    period, step = period_s(signal), float(t_s[1] - t_s[0])
    if period > 1.2 * step:
        value = np.stack([np.interp(t_s, signal.t_s, column) for column in signal.value.T], axis=-1)
        return value, near(signal, t_s)
    ends = np.concatenate([t_s, [t_s[-1] + step]])
    held = np.diff(signal.t_s, append=signal.t_s[-1] + period)[:, None] * signal.value
    area = np.concatenate([np.zeros((1, signal.value.shape[1])), np.cumsum(held, axis=0)])
    at = np.clip(np.searchsorted(signal.t_s, ends + 1e-7, side="right") - 1, 0, len(signal.t_s) - 1)
    integral = area[at] + np.maximum(ends - signal.t_s[at], 0.0)[:, None] * signal.value[at]
    return np.diff(integral, axis=0) / step, near(signal, t_s) | near(signal, t_s + step)
