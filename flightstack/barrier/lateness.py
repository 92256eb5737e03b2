"""How late the commands and the messages of a flight have been so far: what its certificates have to hold for.

Two figures: the longest time between two ticks, and by how much messages come late, but for one tick in a hundred.  A
stream is late from one and a half of its periods on.  Nobody can promise either for the time to come: what is later is
a lapse (`premise_watch`).  Messages that late cost the estimate nothing that counts: turning at 10 rad/s^2 moves an
attitude that is carried on for 4 ms more by 0.1 mrad, an acceleration that changes by 20 m/s^3 a velocity by 0.2 mm/s.
What they stand for is the way of the commands, which nobody sees: the delay is known to so much less.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit
from flightstack.types import F64, Measurement

_PERIODS_S = (0.008, 0.005, 0.004)
"""Of position, attitude and IMU streams at PX4's greatest rates."""
_LATE = 1.5
ROUNDED_S = 0.0005
"""What a tick's own time may be rounded by."""
_LATE_TICKS = 3
"""A loop that was late once is certified for commands that far apart: two deadlines missed in a row."""
_STEP_S, _STEPS, _RARELY, _LEAST_TICKS = 0.001, 5, 0.01, 250
"""Jitter is told in steps, up to 4 ms, by what so few ticks exceed, once there are some.  More is not certified for:
quad-x as it is finds regions for paper-tracking with 4 ms and 12 ms between commands, none with 5 and 16."""


class Lateness:
    """Of the ticks so far; changed in place."""

    __slots__ = ("_late", "_longest_s", "_seen_us")

    def __init__(self) -> None:
        self._seen_us, self._longest_s = -1, 0.0
        self._late = np.zeros(_STEPS)
        """Ticks by how late the latest stream was; the last holds all that is beyond."""

    def take(self, measurement: Measurement) -> None:
        """One tick."""
        if self._seen_us >= 0:
            self._longest_s = max(self._longest_s, 1e-6 * (measurement.t_us - self._seen_us))
        self._seen_us = measurement.t_us
        step = math.ceil(lateness_s(ages_of(measurement)) / _STEP_S)
        self._late[min(max(step, 0), _STEPS - 1)] += 1.0

    def interval_s(self, period_s: float) -> float:
        """For how long a command may be held: a loop's own period, or some of them where it was late."""
        return period_s * (_LATE_TICKS if self._longest_s > period_s + ROUNDED_S else 1)

    @property
    def jitter_s(self) -> float:
        """By how much messages come late."""
        ticks = float(self._late.sum())
        if ticks < _LEAST_TICKS:
            return 0.0
        return _STEP_S * int(np.searchsorted(np.cumsum(self._late), (1.0 - _RARELY) * ticks))


def ages_of(measurement: Measurement) -> F64:
    """(3,) ages of position, attitude and IMU, s."""
    return np.array([measurement.position_age_us, measurement.attitude_age_us, measurement.imu_age_us]) * 1e-6


@njit
def lateness_s(ages_s: F64) -> float:
    """By how much the stream that is latest is older than one and a half of its periods; ages (3,) as `ages_of`."""
    most = -np.inf
    for i in range(3):
        most = max(most, ages_s[i] - _LATE * _PERIODS_S[i])
    return most
