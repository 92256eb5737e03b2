"""A flight's kinematic signals on one grid for the checks, band-limited as a comparison needs it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.checks.grid import attitude_on_grid, on_grid, period_s
from flightstack.gap.filters import bandpass, both_ways, lowpass
from flightstack.gap.records import Signal
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_logs.turn import conjugate, multiply

G_NED = np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
KINEMATIC = ("pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "accel_frd_mps2")
LEAST_ROWS = 9
"""Of a signal that says anything of a motion."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Signals by name, (N, k) each, on a grid of `dt_s`; NaN nowhere (gaps are bridged by straight lines)."""

    t_s: F64
    dt_s: float
    columns: Mapping[str, F64]
    known: NDArray[np.bool_]
    """(N,) where every signal stands on samples."""

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> F64:
        return self.columns[name]


def motion(signals: Mapping[str, Signal], span_s: tuple[float, float], dt_s: float) -> Motion | None:
    """The kinematic signals within a span of time; None where nothing is in it."""
    used = {name: signals[name] for name in KINEMATIC if name in signals and len(signals[name].t_s) >= LEAST_ROWS}
    if not used:
        return None
    begin = max(span_s[0], *(float(each.t_s[0]) for each in used.values()))
    end = min(span_s[1], *(float(each.t_s[-1]) for each in used.values()))
    if end - begin < 64 * dt_s:
        return None
    t_s: F64 = begin + dt_s * np.arange(int((end - begin) / dt_s), dtype=np.float64)
    known = np.ones(len(t_s), np.bool_)
    columns: dict[str, F64] = {}
    for name, each in used.items():
        columns[name], good = (attitude_on_grid if name == "q_ned_frd" else on_grid)(each, t_s)
        known &= good
    return Motion(t_s, dt_s, columns, known)


def rates_of(q: F64, dt_s: float) -> F64:
    """Body rates (N, 3) of attitudes on a grid, by central differences."""
    turn = multiply(conjugate(q[:-2]), q[2:])
    turn *= np.where(turn[:, :1] < 0.0, -1.0, 1.0)
    size = np.linalg.norm(turn[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(size, turn[:, 0])
    inner = turn[:, 1:] * (angle / np.maximum(size, 1e-12) / (2.0 * dt_s))[:, None]
    return np.concatenate([inner[:1], inner, inner[-1:]])


def band(values: F64, dt_s: float, low_hz: float, high_hz: float) -> F64:
    """Band-limited without a shift in time (Butterworth, second order, both ways); low_hz 0 is a low pass."""
    nyquist = 0.5 / dt_s
    high_hz = min(high_hz, 0.9 * nyquist)
    if low_hz > 0.0:
        sections = bandpass(low_hz, high_hz, dt_s)
    else:
        sections = lowpass(high_hz, dt_s)
    pad = min(len(values) - 1, int(1.5 / max(low_hz, 0.3) / dt_s))
    return both_ways(sections, values, pad)


def integrated(values: F64, dt_s: float) -> F64:
    """Running integral by the trapezoidal rule, 0 at the first row."""
    steps = 0.5 * dt_s * (values[1:] + values[:-1])
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(steps, axis=0)])


def rate_hz(signal: Signal | None) -> float:
    """Usual rate; 0 for none."""
    return 0.0 if signal is None or len(signal.t_s) < 2 else 1.0 / period_s(signal)
