"""Where an axis' certificate is limited most, and the arc that is flown through there to learn about it.

Everything here is relative to the region's centre, e its distance and v its rate, and follows from the certificate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flightstack import arcs
from flightstack.barrier.condition import Reach, Setting, interval
from flightstack.barrier.design import at_speed
from flightstack.barrier.records import N_ERROR_HIGH, N_ERROR_LOW, N_HIGH, N_LOW, AxisCertificate
from flightstack.barrier.shapes import Barrier, gradient, piece_at, value
from flightstack.jit import njit
from flightstack.types import F64


@dataclass(frozen=True, slots=True)
class TargetSearch:
    """Constants of the search for targets and arcs."""

    grow: float = 1.1
    rays: int = 72
    moving: float = 0.2
    """Share of the greatest speed below which a limit is none that flying through could lift."""
    keep_h: float = 0.1
    """h along an arc, at least."""
    ramp_s: tuple[float, float] = (0.4, 0.35)
    """Time for a change of acceleration: lateral, vertical."""
    shares: tuple[float, ...] = (0.9, 0.7, 0.5, 0.3, 0.15)
    """Of the acceleration at hand, hardest first."""
    accelerate_max_mps2: float = 3.0


class Limit(NamedTuple):
    """A state on the boundary of the candidate, and what it lacks."""

    ray: int
    e_m: float
    v_mps: float
    margin_ps: float
    error_mps2: float
    score_ps: float


def limits(axis: AxisCertificate, search: TargetSearch) -> list[Limit]:
    """States on the candidate's boundary that have a speed to speak of, the one that limits most first."""
    candidate = at_speed(axis.barrier, search.grow)
    found = []
    for ray, (e, v) in enumerate(boundary(candidate, search.rays)):
        reach = axis.authority.reach(v)
        _, _, margin = interval(candidate.rows, e, v, axis.setting, reach)
        _, slope = gradient(candidate, e, v)
        error = reach.error_low if slope < 0.0 else reach.error_high
        found.append(Limit(ray, e, v, margin, error, abs(slope) * error - margin))
    fastest = max(abs(limit.v_mps) for limit in found)
    moving = [limit for limit in found if abs(limit.v_mps) > search.moving * fastest]
    return sorted(moving, key=lambda limit: -limit.score_ps)


def boundary(barrier: Barrier, rays: int) -> list[tuple[float, float]]:
    """(e, v) where h is 0, on rays at equal angles from the region's middle, its box scaled to a square."""
    e_low, e_high, v_low, v_high = barrier.box
    e0, v0 = 0.5 * (e_low + e_high), 0.5 * (v_low + v_high)
    points = []
    for ray in range(rays):
        angle = 2.0 * math.pi * (ray + 0.5) / rays
        de, dv = 0.5 * (e_high - e_low) * math.cos(angle), 0.5 * (v_high - v_low) * math.sin(angle)
        near, far = 0.0, 1.5
        for _ in range(40):
            middle = 0.5 * (near + far)
            if value(barrier, e0 + middle * de, v0 + middle * dv) >= 0.0:
                near = middle
            else:
                far = middle
        points.append((e0 + near * de, v0 + near * dv))
    return points


def states_near(axis: AxisCertificate, limit: Limit) -> list[tuple[float, float]]:
    """States to fly through for a limit, the best first: the bound depends on the speed, so that comes first."""
    e_low, e_high, _, _ = axis.barrier.box
    places = sorted((e_low + (e_high - e_low) * i / 12.0 for i in range(1, 12)), key=lambda e: abs(e - limit.e_m))
    return [(e, limit.v_mps * (1.0 - 0.06 * k)) for k in range(15) for e in places]


def reachable(axis: AxisCertificate, limit: Limit, search: TargetSearch) -> F64 | None:
    """(5, 6) the arc through the best state that can be reached and left inside the certified region, braking
    hardest."""
    states = [
        state for state in states_near(axis, limit) if value(axis.barrier, *state) - axis.setting.inner >= search.keep_h
    ]
    if not states:
        return None
    at_hand = np.array([_at_hand(axis, v) for _, v in states])
    at_hand[:, 0] = np.minimum(at_hand[:, 0], search.accelerate_max_mps2)
    ramp = search.ramp_s[int(axis.axis == 2)]
    found, arc = _first(
        axis.barrier.rows, axis.authority.table, axis.setting, np.array(states), at_hand, np.array(search.shares), ramp,
        search.keep_h,
    )  # fmt: skip
    return arc if found else None


def _at_hand(axis: AxisCertificate, v_mps: float) -> tuple[float, float]:
    """Acceleration that the command gives for sure at every speed up to `v_mps`: along it, and against it."""
    low, high = -math.inf, math.inf
    for share in np.linspace(0.0, 1.0, 9):
        reach = axis.authority.reach(float(share) * v_mps)
        low, high = max(low, reach.u_low + reach.error_low), min(high, reach.u_high - reach.error_high)
    return (high, -low) if v_mps > 0.0 else (-low, high)


@njit
def _first(
    rows: F64, table: F64, setting: Setting, states: F64, at_hand: F64, shares: F64, ramp_s: float, keep_h: float
) -> tuple[bool, F64]:
    """The first admissible arc: by state (n, 2), by braking, then by acceleration and the time to turn between them."""
    for k in range(states.shape[0]):
        if min(at_hand[k, 0], at_hand[k, 1]) <= 0.05:
            continue
        for brake in shares:
            for push in shares:
                for turn in range(1, 5):
                    good, arc = arcs.fly_through(
                        states[k, 0], states[k, 1], push * at_hand[k, 0], brake * at_hand[k, 1], ramp_s, turn * ramp_s
                    )
                    if good and admissible(rows, table, setting, arc, keep_h):
                        return True, arc
    return False, np.zeros((5, 6))


def transit(axis: AxisCertificate, from_m: float, to_m: float, search: TargetSearch) -> F64 | None:
    """A calm arc from rest to rest inside the certified region; None where even a slow one would leave it."""
    way = to_m - from_m
    if abs(way) < 1e-6:
        return arcs.at_rest(from_m, 0.05)
    ramp = 2.0 * search.ramp_s[int(axis.axis == 2)]
    for _ in range(12):  # three ramps: up, over, down; their way is the acceleration times the square of a ramp's time
        a = way / (ramp * ramp)
        arc = arcs.from_rest(from_m, np.full(3, ramp), np.array([0.0, a, -a, 0.0]))
        gentle = abs(a) <= 1.0
        if gentle and admissible(axis.barrier.rows, axis.authority.table, axis.setting, arc, search.keep_h):
            return arc
        ramp *= 1.2
    return None


@njit
def admissible(rows: F64, table: F64, setting: Setting, arc: F64, keep_h: float) -> bool:
    """Whether the filter would let an arc pass: h and the condition at its states, 60 of them.

    `rows` of the barrier, `table` (7, n) of the authority, `arc` (n, 6).
    """
    last = arc.shape[0] - 1
    total = arc[last, 0] + arc[last, 1]
    for k in range(61):
        e, v, a = arcs.at(arc, total * k / 60.0)
        h = np.inf
        for i in range(rows.shape[0]):
            h = min(h, piece_at(rows[i], e, v)[0])
        if h - setting.inner < keep_h:
            return False
        low, high, margin = interval(rows, e, v, setting, _reach(table, v))
        if margin < 0.0 or a < low or a > high:
            return False
    return True


@njit
def _reach(table: F64, v: float) -> Reach:
    """`Authority.reach` of its table."""
    nodes = table.shape[1]
    i = min(max(np.searchsorted(table[0], v) - 1, 0), nodes - 2)
    return Reach(
        max(table[N_LOW, i], table[N_LOW, i + 1]), min(table[N_HIGH, i], table[N_HIGH, i + 1]),
        max(table[N_ERROR_LOW, i], table[N_ERROR_LOW, i + 1]), max(table[N_ERROR_HIGH, i], table[N_ERROR_HIGH, i + 1]),
    )  # fmt: skip
