"""A state that agrees with itself: the slow disagreement of an estimator's velocity with its own position.

An autopilot's filter may report a velocity that is not the derivative of the position that it reports,

    c = d(position)/dt - velocity

by 0.1 to 0.3 m/s over seconds where its model of the noise is wrong (PX4 with its simulator SIH at stock parameters).
Feedback of both turns c into a position error of 3 c / pole.  An observer of third order integrates the velocity and
is corrected by the position; with c' = s, e the position's innovation, dt apart, and a = exp(-w dt), all poles at w:

    p^ = p^ + dt (v + c^) + (1 - a^3) e,  c^ = c^ + dt s^ + 1.5 (1 - a)^2 (1 + a) e / dt,  s^ = s^ + (1 - a)^3 e / dt^2

(the critically damped alpha-beta-gamma filter; P. R. Kalata, "The tracking index", IEEE Trans. AES 20(2), 1984).  It
follows a c that rises evenly; one of second order stays behind it by 2 / w of its rise, and what it stays behind is
flown (a quarter of a c of 0.2 Hz at 8 rad/s).  What is added to the velocity is weight c^, axis by axis,

    weight = r^2 / (r^2 + n^2 + (0.03 m/s)^2)

with r^2 the mean square of c^ below 0.5 Hz and n^2 that of the rest: Wiener's share of what is slow, less of what is
too small to matter.  Where position and velocity agree but for noise, as with motion capture, next to nothing is added.

Why there are two observers: `state_observer` is a Kalman filter with the statistics of a grade whose errors of position
and velocity are independent (simulated motion capture, GPS); where it flies, this one corrects nothing.  A real PX4's
errors are not independent, velocity's is the derivative of position's: no such statistics hold, and this one corrects.
It always runs, as it says how well the two streams agree; it bounds nothing.

Position is left as it was received.  rms of c^ is a figure of the estimator's health.  A reset that the estimator
counts, and any jump, moves p^ to the new position; what was known of c stays.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit
from flightstack.rows import VEL_D, VEL_E, VEL_N
from flightstack.types import F64, Tuple3

POOR_MPS = 0.15
"""rms(c) above which the estimator is warned of: a position error of 0.1 m and more by feedback."""
_POLE_RADPS = 6.0
_SLOW_S = 1.0 / (2.0 * math.pi * 0.5)
_MEMORY_S = 15.0
_GAP_MAX_S = 0.1
_JUMP_M = 0.25
_SMALL_MPS = 0.03
"""A slow c of this size costs a centimetre of position: less than half of it is followed."""

# The row: p^, c^, slow part of c^, mean squares of the slow part and of the rest, of c^, last velocity, s^, time,
# weight of the means.
_POS, _C, _SLOW, _SLOW_SQUARE, _REST_SQUARE, _SQUARE, _VEL, _SLOPE, _TIME, _SEEN_S = 0, 3, 6, 9, 12, 15, 18, 21, 24, 25
_ROW = 26


class EstimateObserver:
    """The observer of one vehicle's position stream; mutable, one row of numbers."""

    __slots__ = ("row",)

    def __init__(self) -> None:
        self.row = np.zeros(_ROW)
        self.row[_TIME] = -1.0

    def position(self, t_us: int, pos_ned_m: Tuple3, vel_ned_mps: Tuple3) -> None:
        """A sample of position and velocity, with the vehicle's stamp; an older one than the last changes nothing."""
        observe(self.row, 1e-6 * t_us, np.array([*pos_ned_m, *vel_ned_mps]))

    def reset(self) -> None:
        """The estimator has counted a reset: the next position is where it is, and c is what it was slowly."""
        row = self.row
        row[_TIME] = -1.0
        row[_C : _C + 3] = row[_SLOW : _SLOW + 3]
        row[_SLOPE : _SLOPE + 3] = 0.0

    @property
    def disagreement_ned_mps(self) -> F64:
        """(3,) c^ now, m/s."""
        return self.row[_C : _C + 3].copy()

    @property
    def rms_ned_mps(self) -> F64:
        """(3,) root mean square of c^ over the last 15 s, m/s."""
        return np.sqrt(self.row[_SQUARE : _SQUARE + 3])

    @property
    def weight(self) -> F64:
        """(3,) share of c^ that is added to the velocity, 0..1."""
        return np.array([_weight(self.row, i) for i in range(3)])

    def correct(self, vel_ned_mps: F64) -> None:
        """Add what is known of the disagreement to a velocity (3,), in place."""
        correct(self.row, vel_ned_mps)


@njit
def distrusted(row: F64) -> float:
    """As `EstimateObserver.distrust`."""
    return max(_weight(row, 0), _weight(row, 1), _weight(row, 2))


@njit
def correct(row: F64, vel: F64) -> None:
    """As `EstimateObserver.correct`."""
    for i in range(3):
        vel[i] += _weight(row, i) * row[_C + i]


@njit
def _weight(row: F64, i: int) -> float:
    slow = row[_SLOW_SQUARE + i]
    return float(slow / (slow + row[_REST_SQUARE + i] + _SMALL_MPS * _SMALL_MPS))


@njit
def observe(row: F64, t: float, sample: F64) -> None:
    """One sample (6,) of position and velocity; what is not finite changes nothing."""
    n, e, d, vn, ve, vd = sample[0], sample[1], sample[2], sample[VEL_N], sample[VEL_E], sample[VEL_D]
    if not math.isfinite(n + e + d + vn + ve + vd):
        return
    dt = t - row[_TIME]
    if row[_TIME] >= 0.0 and dt <= 0.0:
        return
    begun = row[_TIME] >= 0.0 and dt <= _GAP_MAX_S
    row[_TIME] = t
    decay = math.exp(-_POLE_RADPS * dt) if begun else 0.0
    slower = 1.0 - math.exp(-dt / _SLOW_S) if begun else 0.0
    if begun:
        row[_SEEN_S] = min(row[_SEEN_S] + dt, _MEMORY_S)
    share = dt / max(row[_SEEN_S], 1.0) if begun else 0.0
    for i, (pos, vel) in enumerate(((n, vn), (e, ve), (d, vd))):
        moved = row[_POS + i] + dt * (0.5 * (vel + row[_VEL + i]) + row[_C + i] + 0.5 * dt * row[_SLOPE + i])
        error = pos - moved
        row[_VEL + i] = vel
        if not begun or abs(error) > _JUMP_M:
            row[_POS + i] = pos
            if begun:
                row[_C + i] = row[_SLOW + i]
                row[_SLOPE + i] = 0.0
            continue
        row[_POS + i] = moved + (1.0 - decay**3) * error
        row[_C + i] += dt * row[_SLOPE + i] + 1.5 * (1.0 - decay) ** 2 * (1.0 + decay) * error / dt
        row[_SLOPE + i] += (1.0 - decay) ** 3 * error / (dt * dt)
        c = row[_C + i]
        row[_SLOW + i] += slower * (c - row[_SLOW + i])
        slow = row[_SLOW + i]
        row[_SLOW_SQUARE + i] += share * (slow * slow - row[_SLOW_SQUARE + i])
        row[_REST_SQUARE + i] += share * ((c - slow) ** 2 - row[_REST_SQUARE + i])
        row[_SQUARE + i] += share * (c * c - row[_SQUARE + i])
