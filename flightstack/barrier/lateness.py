"""How late the commands and the messages of a flight have been so far: what its certificates have to hold for.

Three figures: the longest time between two ticks, and, but for one tick in a hundred, the age of the newest sample and
by how much messages come later than the quickest.  A stream is late from one and a half of its periods on, and by what
the link takes besides: the least age of a newest sample so far, of which one IMU period is none.  Nobody can promise
any of them for the time to come: what is later is a lapse (`premise_watch`).  Messages that late cost the estimate
nothing that counts: turning at 10 rad/s^2 moves an attitude that is carried on for 4 ms more by 0.1 mrad, an
acceleration that changes by 20 m/s^3 a velocity by 0.2 mm/s.  What they stand for is the way of the commands, which
nobody sees: the delay is known to so much less.  What an age costs is a line of the ledger.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.barrier.records import Certificate
from flightstack.jit import Entry, njit
from flightstack.types import F64, I64, Measurement, Tuple3

_PERIODS_S = (0.008, 0.005, 0.004)
"""Of position, attitude and IMU streams at PX4's greatest rates."""
_LATE = 1.5
ROUNDED_S = 0.0005
"""What a tick's own time may be rounded by."""
_LATE_TICKS = 3
"""A loop that was late once is certified for commands that far apart: two deadlines missed in a row."""
_STEP_S, _STEPS, _OLDEST, _RARELY, _LEAST_TICKS = 0.001, 5, 51, 0.01, 250
"""Jitter is told in steps, up to 4 ms, by what so few ticks exceed, once there are some.  More is not certified for:
quad-x as it is finds regions for paper-tracking with 4 ms and 12 ms between commands, none with 5 and 16."""


class Lateness:
    """Of the ticks so far; changed in place."""

    __slots__ = ("_ages", "_late", "_longest_s", "_quickest_s", "_seen_us")

    def __init__(self) -> None:
        self._seen_us, self._longest_s, self._quickest_s = -1, 0.0, math.inf
        self._ages = np.zeros(_OLDEST, np.int64)
        """Ticks by the age of the newest sample; over the last nothing is carried."""
        self._late = np.zeros(_STEPS, np.int64)
        """Ticks by how late the latest stream was; the last holds all that is beyond."""

    def take(self, measurement: Measurement) -> None:
        """One tick."""
        if self._seen_us >= 0:
            self._longest_s = max(self._longest_s, 1e-6 * (measurement.t_us - self._seen_us))
        self._seen_us = measurement.t_us
        self._quickest_s = _COUNTED.call(ages_of(measurement), self._quickest_s, self._late, self._ages)

    def interval_s(self, period_s: float) -> float:
        """For how long a command may be held: a loop's own period, or some of them where it was late."""
        return period_s * (_LATE_TICKS if self._longest_s > period_s + ROUNDED_S else 1)

    @property
    def jitter_s(self) -> float:
        """By how much messages come late."""
        return _mostly_s(self._late)

    @property
    def age_s(self) -> float:
        """How old the newest sample is."""
        return _mostly_s(self._ages)


def _mostly_s(ticks: I64) -> float:
    """What all but few ticks keep within; 0 while there are too few to say."""
    count = float(ticks.sum())
    return _STEP_S * int(np.searchsorted(np.cumsum(ticks), (1.0 - _RARELY) * count)) if count >= _LEAST_TICKS else 0.0


def ages_of(measurement: Measurement) -> Tuple3:
    """Ages of position, attitude and IMU, s."""
    return measurement.position_age_us * 1e-6, measurement.attitude_age_us * 1e-6, measurement.imu_age_us * 1e-6


def _always_s(quickest_s: float) -> float:
    """What the link always takes, of a newest sample that old when it came quickest."""
    return max(quickest_s - _PERIODS_S[2], 0.0)


def _lateness_s(ages_s: Tuple3) -> float:
    """By how much the stream that is latest is older than one and a half of its periods; ages as `ages_of`."""
    position, attitude, imu = _PERIODS_S
    return max(ages_s[0] - _LATE * position, ages_s[1] - _LATE * attitude, ages_s[2] - _LATE * imu)


always_s, lateness_s = njit(_always_s), njit(_lateness_s)
"""The same for compiled code."""


@njit
def _counted(ages_s: Tuple3, quickest_s: float, late: I64, ages: I64) -> float:
    """One tick more in both counts; the least age of a newest sample so far."""
    newest_s = min(ages_s[0], ages_s[1], ages_s[2])
    quickest_s = min(quickest_s, newest_s)
    late[_step(lateness_s(ages_s) - always_s(quickest_s), _STEPS)] += 1
    ages[_step(newest_s, _OLDEST)] += 1
    return quickest_s


@njit
def _step(span_s: float, steps: int) -> int:
    """The step that a time belongs to, of so many; the last holds all that is beyond."""
    return int(min(max(math.ceil(span_s / _STEP_S - 1e-6), 0), steps - 1))


_COUNTED = Entry(_counted, "UniTuple(f8, 3), f8, i8[::1], i8[::1]")


def carried_off(certificate: Certificate) -> tuple[F64, F64]:
    """(3,), (3,): how far position and velocity may be off at a tick, of a sample as old as the certificate allows.

    Beyond the estimate's bounds along each certified axis: the model's error E over the age A, and commands that act
    by d later or sooner than believed: A E + min(A, d) S of velocity, and what that and the velocity's bound give.
    """
    premises = certificate.premises
    assert premises is not None
    pos, vel = np.array(premises.estimate.pos_m), np.array(premises.estimate.vel_mps)
    old, (soonest, latest) = premises.age_s, premises.delay_s
    late = min(old, 0.5 * (latest - soonest))
    for each in certificate.axes:
        table, i = each.authority, each.axis
        error = max(table.error_low_mps2.max(), table.error_high_mps2.max())
        more = old * error + late * (table.u_high_mps2 - table.u_low_mps2).max()
        pos[i] += old * (vel[i] + more)
        vel[i] += more
    return pos, vel
