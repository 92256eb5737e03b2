"""Whether the premises of the certificate in force hold, tick by tick, as far as a flight can see them.

While the filter is engaged every premise is compared with what was measured at this tick.  One tick of breach is told
and counted; breach for BREACH_S, what holds in between paid back at a quarter of the time, ends the certificate: the
vehicle is brought to rest, through the filter, where it is (`WatchState.rest`), and stays there; the flight ends.
Another certificate, with premises of its own, begins anew.

Stream ages are compared with one and a half of each stream's periods and the certificate's jitter; of the rest each is
compared with its own range (`premises`).  What the estimate is off by cannot be seen here: its bound is scored against
the truth in simulation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier.premises import Premises
from flightstack.frames import quat_to_matrix
from flightstack.jit import njit
from flightstack.types import F64, Command, FlatOutput, Learned, Measurement

NAMES = (
    "", "speed north", "speed east", "speed down", "lean north", "lean east", "thrust", "applied thrust",
    "thrust gain", "delay", "link", "command interval", "battery",
)  # fmt: skip
"""Premises by their number; 0: none is broken."""
BREACH_S = 0.02
_PAID_BACK = 0.25
_PERIODS_S = (0.008, 0.005, 0.004)
"""Of position, attitude and IMU streams at PX4's greatest rates."""
_LATE = 1.5
_TICK_S = 0.0005
"""What a tick's own time may be rounded by."""
_GAP_MAX_S = 0.1
_VALID = 2.0
_AHEAD_S = 0.3
"""Where a vehicle at this speed is brought to rest: so far on its way."""
_NUMBERS = 24


class WatchState(NamedTuple):
    """What the watch remembers."""

    version: int = -1
    """Of the certificate that is watched."""
    numbers: F64 = np.zeros(_NUMBERS)
    """Its premises for compiled code."""
    broken_s: float = 0.0
    """How long premises were broken of late."""
    broken: int = 0
    """Number of the premise that is broken at this tick."""
    ended: int = 0
    """Number of the premise that ended the certificate; 0 while it stands."""
    rest: FlatOutput | None = None
    """Where the flight is brought to rest after that."""


class Seen(NamedTuple):
    """What a tick knows besides the measurement."""

    sent: Command
    learned: Learned
    applied_ratio: float
    """Thrust by the motors' word over thrust sent."""
    interval_s: float
    """Since the command before."""


def watched(version: int, premises: Premises) -> WatchState:
    """The watch of a certificate that is taken."""
    low, high = zip(*premises.speeds_mps, strict=True)
    numbers = [
        *low, *high, premises.lean, *premises.thrust_mps2, *premises.applied_share, *premises.thrust_gain,
        *premises.delay_s, premises.jitter_s, premises.command_interval_s, *premises.battery_v,
    ]  # fmt: skip
    return WatchState(version, np.array([*numbers, *([0.0] * (_NUMBERS - len(numbers)))]))


def watch(state: WatchState, measurement: Measurement, seen: Seen, mass_kg: float, yaw_rad: float) -> WatchState:
    """One tick with an engaged filter."""
    ages_s = np.array([measurement.position_age_us, measurement.attitude_age_us, measurement.imu_age_us]) * 1e-6
    learned = seen.learned
    latency_s = learned.latency_s if learned.latency_s > 0.0 else math.nan
    gain = learned.thrust_gain if learned.stage >= _VALID else math.nan
    broken = _broken(
        state.numbers, measurement.row, ages_s, seen.sent.thrust_n / mass_kg, seen.applied_ratio, gain, latency_s,
        seen.interval_s, measurement.battery_v,
    )  # fmt: skip
    span_s = min(max(seen.interval_s, 0.0), _GAP_MAX_S)
    broken_s = state.broken_s + span_s if broken else max(state.broken_s - _PAID_BACK * span_s, 0.0)
    if state.ended or broken_s < BREACH_S:
        return state._replace(broken=broken, broken_s=broken_s)
    return state._replace(broken=broken, broken_s=broken_s, ended=broken, rest=_rest(measurement, yaw_rad))


def _rest(measurement: Measurement, yaw_rad: float) -> FlatOutput:
    """At rest a little ahead."""
    zero = np.zeros(3)
    return FlatOutput.of(measurement.pos_ned_m + _AHEAD_S * measurement.vel_ned_mps, zero, zero, zero, zero, yaw_rad)


@njit
def _broken(
    p: F64, row: F64, ages_s: F64, thrust_mps2: float, applied: float, gain: float, latency_s: float,
    interval_s: float, battery_v: float,
) -> int:  # fmt: skip
    """Number of the first premise that does not hold; what is not known (NaN) breaks none."""
    for i in range(3):
        if not p[i] <= row[3 + i] <= p[3 + i]:
            return 1 + i
    r = quat_to_matrix(row[6:10])
    for i in range(2):
        if not abs(r[i, 2]) <= p[6]:
            return 4 + i
    for i, value in enumerate((thrust_mps2, applied, gain, latency_s)):
        if value < p[7 + 2 * i] - 1e-9 or value > p[8 + 2 * i] + 1e-9:
            return 6 + i
    for i in range(3):
        if ages_s[i] > _LATE * _PERIODS_S[i] + p[15]:
            return 10
    if interval_s > p[16] + _TICK_S:
        return 11
    return 12 if battery_v < p[17] or battery_v > p[18] else 0
