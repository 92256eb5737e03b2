"""Whether the premises of the certificate in force hold, tick by tick, as far as a flight can see them.

While the filter is engaged every premise is compared with what was measured at this tick.  One tick of breach is told
and counted; breach for BREACH_S, what holds in between paid back at a quarter of the time, ends the certificate: the
vehicle is brought to rest, through the filter, where it is (`WatchState.rest`), and stays there; the flight ends.
Another certificate, with premises of its own, begins anew.

**Lapses.**  A command or a message that came late is over when it is over: the proof begins anew at every command, from
any state inside.  Such a lapse is told and counted, and ends the certificate where at the tick after it the vehicle is
not inside with the h that the filter engages at (then braking is all that is left), or where lapses add up to
LAPSED_S: of an interval what is beyond the certificate's, of late messages the ticks.  Nothing is promised meanwhile.

The newest sample's age is compared with the certificate's, the streams' with one and a half of each one's periods, the
jitter, and what the link always takes (`lateness`), as far as the age shows it; of the rest each is
compared with its own range (`premises`).  What the estimate is off by cannot be seen here: its bound is scored against
the truth in simulation.

**The gain.**  At nearly constant thrust the slope that is learned and the constant beside it trade against each other;
only what they give together is known, and a certificate's bounds are about nothing else.  So where down is certified
the learner's acceleration at the estimated state is compared with the certificate's mean there, at both ends of the
certified thrust.  D apart is told as a gain, the certificate's less D / (cos(tilt) times the greatest thrust), which
is within the premise's range where D is within the certificate's bound.  Of thrust that changes by a share it is the
changed gain; what of it is taken for a constant, which no slope tells, counts as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.barrier.assess import CHANGED, ENGAGE_H, PASSED, column_at
from flightstack.barrier.lateness import ROUNDED_S, ages_of, always_s, lateness_s
from flightstack.barrier.premises import Premises
from flightstack.frames import quat_to_matrix
from flightstack.jit import Entry, njit
from flightstack.rows import (
    F_H,
    F_H_STATE,
    F_STATUS,
    L_APPLIED,
    L_GAIN,
    L_LATENCY,
    L_RESIDUAL,
    L_STAGE,
    VEL_D,
    VEL_E,
    VEL_N,
)
from flightstack.types import (
    F64,
    STANDARD_GRAVITY_MPS2,
    Command,
    Filtered,
    FlatOutput,
    Learned,
    Measurement,
    Tuple3,
    made,
)

NAMES = (
    "", "speed north", "speed east", "speed down", "lean north", "lean east", "thrust", "applied thrust",
    "thrust gain", "delay", "link", "command interval", "battery", "rate gains",
)  # fmt: skip
"""Premises by their number; 0: none is broken."""
_LATE_LINK, _LATE_COMMAND = 10, 11
RATE_GAINS = 13
"""Told by the vehicle, not seen in a tick."""
_LAPSES = _LATE_LINK, _LATE_COMMAND
BREACH_S = 0.02
LAPSED_S = 0.2
"""In all, what holds in between paid back likewise: a loop or a link that is often late is not what was certified."""
_PAID_BACK = 0.25
_GAP_MAX_S = 0.1
_VALID = 2.0
_AHEAD_S = 0.3
"""Where a vehicle at this speed is brought to rest: so far on its way."""
_NUMBERS = 26
_NO_TABLE = np.empty((7, 0))
_LEAST_UP = 0.5
"""Of the thrust axis' part along down: beyond it, where no certificate holds, the slope alone is compared."""


class WatchState(NamedTuple):
    """What the watch remembers."""

    version: int = -1
    """Of the certificate that is watched."""
    numbers: F64 = np.zeros(_NUMBERS)
    """Its premises for compiled code."""
    down: F64 = _NO_TABLE
    """(7, n) what it says of acceleration along down (`Authority.table`); empty where it says nothing."""
    broken_s: float = 0.0
    """How long premises were broken of late, but for lapses."""
    lapsed_s: float = 0.0
    """How long lapses were of late."""
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
    is_inside: bool = True
    """At the tick before the filter found the vehicle inside with the h that it engages at."""


_LEAN, _THRUST, _DELAY, _JITTER, _INTERVAL, _BATTERY, _DRAG, _AGE = 6, 10, 16, 18, 19, 20, 22, 25
"""Of a watch's numbers, after the speeds: what has a range takes two."""


def is_inside(filtered: Filtered) -> bool:
    """Whether the filter found the vehicle inside with the h that it engages at, and a command that keeps it there."""
    said = filtered.row.item
    return said(F_STATUS) in (PASSED, CHANGED) and min(said(F_H), said(F_H_STATE)) >= ENGAGE_H


def watched(
    version: int, premises: Premises, down: F64 = _NO_TABLE, drag_per_s: Tuple3 = (0.0, 0.0, 0.0)
) -> WatchState:
    """The watch of a certificate that is taken.

    `down` (7, n): its bounds along down, empty where there are none; `drag_per_s`: the believed drag along the body's
    axes, which the learner's residual leaves out.
    """
    low, high = zip(*premises.speeds_mps, strict=True)
    numbers = [
        *low, *high, *premises.leans[0], *premises.leans[1], *premises.thrust_mps2, *premises.applied_share,
        *premises.thrust_gain, *premises.delay_s, premises.jitter_s, premises.command_interval_s, *premises.battery_v,
        *drag_per_s, premises.age_s,
    ]  # fmt: skip
    return WatchState(version, np.array([*numbers, *([0.0] * (_NUMBERS - len(numbers)))]), np.ascontiguousarray(down))


def interrupted(state: WatchState) -> WatchState:
    """After somebody else flew: a lapse, whose length says nothing of this loop."""
    return state._replace(broken=_LATE_COMMAND) if state.version >= 0 else state


def ended_by(state: WatchState, measurement: Measurement, premise: int) -> WatchState:
    """After a premise that no tick sees was broken for good; a certificate that has ended stays as it ended."""
    if state.version < 0 or state.ended:
        return state
    w, x, y, z = measurement.q_ned_frd.tolist()
    yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return state._replace(broken=premise, ended=premise, rest=_rest(measurement, yaw_rad))


def watch(state: WatchState, measurement: Measurement, seen: Seen, mass_kg: float, yaw_rad: float) -> WatchState:
    """One tick with an engaged filter."""
    ages_s, learned = ages_of(measurement), seen.learned
    latency_s = _latency_s(measurement, learned, state.numbers.item(_DELAY))
    gain = math.nan
    if learned.row.item(L_STAGE) >= _VALID:
        applied_mps2 = learned.row.item(L_APPLIED) / mass_kg
        gain = _GAIN.call(state.numbers, state.down, measurement.row, learned.row, applied_mps2)
    ranged = seen.sent.thrust_n / mass_kg, seen.applied_ratio, gain, latency_s
    broken = _BROKEN.call(state.numbers, measurement.row, ages_s, ranged, seen.interval_s, measurement.battery_v)
    span_s = min(max(seen.interval_s, 0.0), _GAP_MAX_S)
    lapse = broken in _LAPSES
    broken_s = _summed(state.broken_s, span_s if broken and not lapse else 0.0, span_s)
    lapsed_s = _summed(state.lapsed_s, _lapse_s(broken, seen.interval_s, state.numbers.item(_INTERVAL)), span_s)
    version, numbers, down, *_, ended, rest = state
    after = made(WatchState, (version, numbers, down, broken_s, lapsed_s, broken, ended, rest))
    strayed = state.broken in _LAPSES and not seen.is_inside
    if state.ended or not (broken_s >= BREACH_S or lapsed_s >= LAPSED_S or strayed):
        return after
    return after._replace(ended=state.broken if strayed else broken, rest=_rest(measurement, yaw_rad))


def _latency_s(measurement: Measurement, learned: Learned, least_s: float) -> float:
    """What is known of the commands' latency; NaN: nothing.  The link's part of it breaks no lower end."""
    known_s = learned.row.item(L_LATENCY)
    if known_s > 0.0:
        return known_s
    return max(1e-6 * measurement.late_us, least_s) if measurement.late_us else math.nan


def _summed(before_s: float, more_s: float, span_s: float) -> float:
    """Breaches add up, what holds is paid back."""
    return before_s + more_s if more_s > 0.0 else max(before_s - _PAID_BACK * span_s, 0.0)


def _lapse_s(broken: int, interval_s: float, certified_s: float) -> float:
    """How long a lapse was in which nothing was promised."""
    if broken == _LATE_COMMAND:
        return interval_s - certified_s
    return min(interval_s, certified_s) if broken == _LATE_LINK else 0.0


def _rest(measurement: Measurement, yaw_rad: float) -> FlatOutput:
    """At rest a little ahead."""
    zero = np.zeros(3)
    return FlatOutput.of(measurement.pos_ned_m + _AHEAD_S * measurement.vel_ned_mps, zero, zero, zero, zero, yaw_rad)


@njit
def _gain_at_ends(p: F64, down: F64, row: F64, learned: F64, applied_mps2: float) -> float:
    """The learner's gain as compared with the certificate's (see above): at the end where they are further apart.

    `row`: a Measurement's, `learned`: a Learned's.
    """
    slope = learned[L_GAIN]
    r = quat_to_matrix(row[6:10])
    up = r[2, 2]
    if down.shape[1] == 0 or up < _LEAST_UP:
        return slope  # type: ignore[no-any-return]
    gain = column_at(down, 2, row[VEL_D])
    apart = STANDARD_GRAVITY_MPS2 - up * applied_mps2
    for i in range(3):
        along = r[0, i] * row[VEL_N] + r[1, i] * row[VEL_E] + r[2, i] * row[VEL_D]
        apart += r[2, i] * (learned[L_RESIDUAL + i] - p[_DRAG + i] * along)
    apart -= column_at(down, 1, row[VEL_D]) - gain * up * applied_mps2
    if math.isnan(apart):
        return slope  # type: ignore[no-any-return]
    worst = 0.0
    for i in range(_THRUST, _THRUST + 2):
        at = apart / up + (gain - slope) * (p[i] - applied_mps2)
        if abs(at) > abs(worst):
            worst = at
    return gain - worst / p[_THRUST + 1]  # type: ignore[no-any-return]


@njit
def _broken(
    p: F64, row: F64, ages_s: Tuple3, ranged: tuple[float, float, float, float], interval_s: float, battery_v: float
) -> int:
    """Number of the first premise that does not hold; what is not known (NaN) breaks none.

    ranged: thrust (m/s^2), its share applied, gain, latency (s).
    """
    for i in range(3):
        if not p[i] <= row[3 + i] <= p[3 + i]:
            return 1 + i
    r = quat_to_matrix(row[6:10])
    for i in range(2):
        if not p[_LEAN + 2 * i] <= r[i, 2] <= p[_LEAN + 2 * i + 1]:
            return 4 + i
    for i, value in enumerate(ranged):
        if value < p[_THRUST + 2 * i] - 1e-9 or value > p[_THRUST + 1 + 2 * i] + 1e-9:
            return 6 + i
    always = always_s(p[_AGE] - p[_JITTER])
    if min(ages_s) > p[_AGE] + ROUNDED_S or lateness_s(ages_s) - always > p[_JITTER] + 1e-9:
        return _LATE_LINK
    if interval_s > p[_INTERVAL] + ROUNDED_S:
        return _LATE_COMMAND
    return 12 if battery_v < p[_BATTERY] or battery_v > p[_BATTERY + 1] else 0


_GAIN = Entry(_gain_at_ends, "f8[::1], f8[:, ::1], f8[::1], f8[::1], f8")
_BROKEN = Entry(_broken, "f8[::1], f8[::1], UniTuple(f8, 3), UniTuple(f8, 4), f8, f8")
