"""How old the commands are that the motors follow: thrust as it was sent against SERVO_OUTPUT_RAW.

The mean of the four motor commands is the thrust that PX4 follows (its mixing takes roll, pitch and yaw out of the
mean while no motor is at its end).  Every report is compared with what had been sent by D earlier, for each delay D of
a grid; the wrong ones leave an error wherever the thrust moved.  Both ends work in steps of 4 ms, so a stretch of
delays explains a window of reports equally well: its middle counts where the stretch is no longer than a step.  The
answer is the middle window's; not evident where too few windows count or they contradict each other (somebody else
flew).  Times are those that the state comes by (`vehicle_clock`), so the way of the streams counts too.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.types import F64, Tuple4

GRID_S: F64 = np.arange(0.0, 0.0601, 0.001)
_RING = 64
_WINDOW = 50
"""Reports: half a second of them."""
_LEAST_WINDOWS = 5
_ALIKE = 2.0
"""Delays whose mean square error is at most so many times the least one's are not told apart from it."""
_PULSE = 1e-3
"""A whole microsecond of 1000: the reports' resolution; the mean of four has a quarter of its deviation squared."""
_FLOOR = _PULSE**2 / 12.0 / 4.0
_STEP_S = 0.004
_ENDS = 0.02
"""A motor that is nearer to its ends may be cut off."""


class CommandLatency:
    """Fed with what is sent and what is reported; `latency_s` is the answer."""

    def __init__(self) -> None:
        self._t_us = np.full(_RING, -(2**62), dtype=np.int64)
        self._thrust = np.full(_RING, math.nan)
        self._square = np.zeros(len(GRID_S))
        self._reports = 0
        self._found_s: list[float] = []

    def sent(self, t_us: int, thrust_norm: float) -> None:
        """Normalised thrust sent at a vehicle time."""
        self._t_us[:-1], self._thrust[:-1] = self._t_us[1:], self._thrust[1:]
        self._t_us[-1], self._thrust[-1] = t_us, thrust_norm

    def reported(self, t_us: int, motors: Tuple4) -> None:
        """Normalised motor commands at a vehicle time; those that say nothing are left out."""
        if not (min(motors) > _ENDS and max(motors) < 1.0 - _ENDS):
            return
        a, b, c, d = motors
        thrust = 0.25 * (a + b + c + d)
        places = np.searchsorted(self._t_us, t_us - GRID_S * 1e6, side="right") - 1
        if places[-1] < 0:
            return
        error = self._thrust[places] - thrust
        if not np.isfinite(error).all():
            return
        self._square += error * error
        self._reports += 1
        if self._reports == _WINDOW:
            self._close_window()

    @property
    def latency_s(self) -> float:
        """Seconds; NaN: not evident."""
        if len(self._found_s) < _LEAST_WINDOWS:
            return math.nan
        low, middle, high = np.percentile(self._found_s, [25, 50, 75])
        return float(middle) if high - low <= _STEP_S else math.nan

    def _close_window(self) -> None:
        square = self._square / self._reports
        self._square, self._reports = np.zeros(len(GRID_S)), 0
        alike = np.flatnonzero(square <= _ALIKE * (square.min() + _FLOOR))
        first, last = GRID_S[alike[0]], GRID_S[alike[-1]]
        if last - first <= _STEP_S + 1e-9 and last < GRID_S[-1]:
            self._found_s.append(float(0.5 * (first + last)))
