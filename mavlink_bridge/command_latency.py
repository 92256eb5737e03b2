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
_GRID_US = GRID_S * 1e6
_RING, _ROOM = 64, 1024
"""Commands that are looked at, and that there is room for before they are moved to the front."""
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
        self._t_us = np.full(_ROOM, -math.inf)
        self._thrust = np.full(_ROOM, math.nan)
        self._end = _RING
        self._square = np.zeros(len(GRID_S))
        self._reports = 0
        self._found_s: list[float] = []

    def sent(self, t_us: int, thrust_norm: float) -> None:
        """Normalised thrust sent at a vehicle time."""
        end = self._end
        if end == _ROOM:
            self._t_us[:_RING], self._thrust[:_RING] = self._t_us[-_RING:], self._thrust[-_RING:]
            end = _RING
        self._t_us[end], self._thrust[end] = t_us, thrust_norm
        self._end = end + 1

    def reported(self, t_us: int, motors: Tuple4) -> None:
        """Normalised motor commands at a vehicle time; those that say nothing are left out."""
        if not (min(motors) > _ENDS and max(motors) < 1.0 - _ENDS):
            return
        a, b, c, d = motors
        thrust = 0.25 * (a + b + c + d)
        kept = slice(self._end - _RING, self._end)
        places = self._t_us[kept].searchsorted(t_us - _GRID_US, side="right") - 1
        if places.item(-1) < 0:
            return
        error = self._thrust[kept].take(places) - thrust
        error *= error
        if not math.isfinite(error.sum()):  # nothing was sent yet so long ago
            return
        self._square += error
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
