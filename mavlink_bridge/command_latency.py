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

from flightstack.jit import Entry, njit
from flightstack.types import F64, Tuple4

GRID_S: F64 = np.arange(0.0, 0.0601, 0.001)
_GRID_US = GRID_S * 1e6
_DELAYS = len(GRID_S)
_RING = 64
"""Commands that are looked at."""
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
        self.sent_row = np.full(1 + 2 * _RING, math.nan)
        """Where the next command goes, then the times of the last ones and their thrusts; a ring."""
        self.sent_row[0], self.sent_row[1 : 1 + _RING] = 0.0, -math.inf
        self.square_row = np.zeros(1 + len(GRID_S))
        """Reports of this window, then the square error of each delay."""
        self._found_s: list[float] = []

    def sent(self, t_us: int, thrust_norm: float) -> None:
        """Normalised thrust sent at a vehicle time."""
        SENT.call(self.sent_row, t_us, thrust_norm)

    def reported(self, t_us: int, motors: Tuple4) -> None:
        """Normalised motor commands at a vehicle time; those that say nothing are left out."""
        compare_report(self.sent_row, self.square_row, float(t_us), np.array(motors))
        self.look()

    def look(self) -> None:
        """Close the window that is full."""
        if self.square_row.item(0) >= _WINDOW:
            self._close_window()

    @property
    def latency_s(self) -> float:
        """Seconds; NaN: not evident."""
        if len(self._found_s) < _LEAST_WINDOWS:
            return math.nan
        low, middle, high = np.percentile(self._found_s, [25, 50, 75])
        return float(middle) if high - low <= _STEP_S else math.nan

    def _close_window(self) -> None:
        square = self.square_row[1:] / self.square_row[0]
        self.square_row[:] = 0.0
        alike = np.flatnonzero(square <= _ALIKE * (square.min() + _FLOOR))
        first, last = GRID_S[alike[0]], GRID_S[alike[-1]]
        if last - first <= _STEP_S + 1e-9 and last < GRID_S[-1]:
            self._found_s.append(float(0.5 * (first + last)))


@njit
def _send(row: F64, t_us: float, thrust_norm: float) -> None:
    place = int(row[0])
    row[1 + place], row[1 + _RING + place] = t_us, thrust_norm
    row[0] = (place + 1) % _RING


@njit
def compare_report(sent: F64, square: F64, t_us: float, motors: F64) -> None:
    """A report (4,) at a vehicle time, into the rows of a CommandLatency; one that says nothing is left out."""
    if not (motors.min() > _ENDS and motors.max() < 1.0 - _ENDS):
        return
    thrust = motors.mean()
    errors = np.empty(_DELAYS)
    place = int(sent[0]) + _RING - 1  # the newest
    oldest = place - _RING + 1
    for k in range(_DELAYS):
        while sent[1 + place % _RING] > t_us - _GRID_US[k]:
            place -= 1
            if place < oldest:
                return
        errors[k] = (sent[1 + _RING + place % _RING] - thrust) ** 2
    if not math.isfinite(errors.sum()):  # nothing was sent yet so long ago
        return
    square[0] += 1.0
    for k in range(_DELAYS):
        square[1 + k] += errors[k]


SENT = Entry(_send, "f8[::1], f8, f8")
