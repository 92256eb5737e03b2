"""Arcs from rest to rest on one axis, flown with constant accelerations that begin and end smoothly.

An arc speeds up, reaches its greatest speed where the acceleration passes through zero, and brakes to a stop:

    acceleration   0 -> +a, held, -> -b, held, -> 0

Each change of acceleration follows 10 s^3 - 15 s^4 + 6 s^5 (s the share of its time), so jerk and snap are continuous
and each part is a polynomial of degree 7: what `trajectory.Polynomial` flies.  `table` (n, 6) holds a part a row: start
time, duration, acceleration at its start and end, position and velocity at its start.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flightstack.jit import njit
from flightstack.trajectory import Polynomial
from flightstack.types import F64

_POWERS = 8
_START, _SPAN, _FIRST, _LAST, PLACE, _SPEED = range(6)
_YAW = 3


@njit
def fly_through(
    position_m: float, speed_mps: float, accelerate_mps2: float, brake_mps2: float, ramp_s: float, turn_s: float
) -> tuple[bool, F64]:
    """(5, 6) the arc whose greatest speed is `speed_mps` (its sign is the direction), reached at `position_m`.

    `accelerate_mps2` and `brake_mps2` are magnitudes; `turn_s` is the time of the change from one to the other,
    `ramp_s` of the two others.  False where the changes alone would be faster than the speed.
    """
    way = 1.0 if speed_mps > 0.0 else -1.0
    up, down = accelerate_mps2, brake_mps2
    turn = share_at(up / (up + down))  # where the acceleration passes through zero
    gain = turn_s * (up * turn - (up + down) * turn**4 * (2.5 - 3.0 * turn + turn * turn))
    lost = gain - 0.5 * turn_s * (up - down)  # gained before the greatest speed, lost after it
    hold_up = (abs(speed_mps) - gain) / up - 0.5 * ramp_s
    hold_down = (abs(speed_mps) - lost) / down - 0.5 * ramp_s
    spans = np.array([ramp_s, hold_up, turn_s, hold_down, ramp_s])
    levels = way * np.array([0.0, up, up, -down, -down, 0.0])
    table = from_rest(0.0, spans, levels)
    if hold_up < 0.0 or hold_down < 0.0:
        return False, table
    table[:, PLACE] += position_m - at(table, table[2, _START] + turn * turn_s)[0]
    return True, table


@njit
def from_rest(position_m: float, spans_s: F64, levels_mps2: F64) -> F64:
    """(n, 6) the table of parts of `spans_s` (n,) between accelerations `levels_mps2` (n + 1,), from rest."""
    table = np.zeros((len(spans_s), 6))
    t, p, v = 0.0, position_m, 0.0
    for i in range(len(spans_s)):
        span, first, step = spans_s[i], levels_mps2[i], levels_mps2[i + 1] - levels_mps2[i]
        table[i, _START], table[i, _SPAN], table[i, _FIRST], table[i, _LAST] = t, span, first, first + step
        table[i, PLACE], table[i, _SPEED] = p, v
        p += span * v + span * span * (0.5 * first + step / 7.0)
        v += span * (first + 0.5 * step)
        t += span
    return table


def at_rest(position_m: float, span_s: float) -> F64:
    """(1, 6) standing still."""
    return from_rest(position_m, np.array([span_s]), np.zeros(2))


def duration_s(table: F64) -> float:
    """Length of an arc."""
    return float(table[-1, _START] + table[-1, _SPAN])


@njit
def at(table: F64, t: float) -> tuple[float, float, float]:
    """Position, velocity and acceleration at `t` seconds since the start; at rest before and after."""
    row = table[0]
    for i in range(table.shape[0]):
        if table[i, _START] <= t:
            row = table[i]
    span = row[_SPAN]
    s = min(max((t - row[_START]) / span, 0.0), 1.0) if span > 0.0 else 1.0
    step = row[_LAST] - row[_FIRST]
    cube = s * s * s
    a = row[_FIRST] + step * cube * (10.0 - 15.0 * s + 6.0 * s * s)
    v = row[_SPEED] + span * (row[_FIRST] * s + step * cube * s * (2.5 - 3.0 * s + s * s))
    p = (
        row[PLACE]
        + span * row[_SPEED] * s
        + span * span * (0.5 * row[_FIRST] * s * s + step * cube * s * s * (0.5 - 0.5 * s + s * s / 7.0))
    )
    return p, v, a


def path(tables: Sequence[F64], axis: int, zero_ned_m: F64, yaw_rad: float) -> Polynomial:
    """The arcs one after the other along `axis`, the other axes at rest at `zero_ned_m` (3,); positions are relative
    to it."""
    knots, segments = [0.0], []
    for table in tables:
        for row in table:
            _, span, first, last, p, v = row.tolist()
            if span <= 0.0:
                continue
            coefficients = np.zeros((4, _POWERS))
            coefficients[:3, 0], coefficients[_YAW, 0] = zero_ned_m, yaw_rad
            step = span * span * (last - first)
            own = coefficients[axis]
            own[:3] += p, span * v, 0.5 * span * span * first
            own[5:] += 0.5 * step, -0.5 * step, step / 7.0
            knots.append(knots[-1] + span)
            segments.append(coefficients)
    return Polynomial(np.array(knots), np.array(segments))


@njit
def share_at(value: float) -> float:
    """s at which 10 s^3 - 15 s^4 + 6 s^5 is `value`, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        if middle**3 * (10.0 - 15.0 * middle + 6.0 * middle * middle) < value:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def peak(arc: F64) -> tuple[float, float]:
    """Position and velocity where an arc of `fly_through` is fastest."""
    start, span, first, last = arc[2, :4].tolist()
    p, v, _ = at(arc, start + share_at(first / (first - last)) * span)
    return float(p), float(v)
