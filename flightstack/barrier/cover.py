"""The proof that a command exists everywhere in a region: boxes that cover it, each with one command right for it all.

At a fixed command u, with one line of alpha, q of `condition` is concave in e and concave in v in a box that no kink of
the barrier cuts: the least q of the box is at one of its four corners, exactly.  (Where a barrier's cross term makes q
curve upwards along v, the most that can be gained is taken off.)  So a box is proven by four evaluations of the very
function that the filter enforces; one that fails is halved.  Boxes wholly outside {h >= inner - eta} are dropped; what
the certificate says of a box holds in all of it, not only inside the region.

Branch and bound; the published certificate's balls with one Lipschitz constant, L. Wang, E. Theodorou, M. Egerstedt,
"Safe Learning of Quadrotor Dynamics Using Barrier Certificates", 2018, lemma III.1, need many more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flightstack.barrier.condition import NEAR_H, Reach, Setting, coefficients, doubt_of, interval
from flightstack.barrier.records import Authority, reach_between
from flightstack.barrier.shapes import (
    BRAKE,
    K_EE,
    K_EV,
    K_VV,
    KIND,
    REACTION,
    SIGN,
    STOPPING,
    Barrier,
    Quadratic,
    Stopping,
    piece_at,
)
from flightstack.jit import njit, njit_called
from flightstack.types import F64

CELL = 6
"""Numbers of a cell: e_low, e_high, v_low, v_high (m, m/s), u (m/s^2), q (1/s)."""
_E_LOW, _E_HIGH, _V_LOW, _V_HIGH, _U, _Q = range(CELL)
_A, _B, _C, _K, _M, _L, _N = range(7)
"""What `condition.coefficients` gives."""
_SLACK = 1e-9
"""Taken off every q, so that rounding can't make it too large; another arithmetic may differ by as much, 1/s."""
_SMALLEST = 2.0**-18
"""A box this small, as a share of the region's, is not halved again."""
_TRIES = 6
"""Evenly spaced commands that are tried; the best is then refined."""
_STACK = 512


@dataclass(frozen=True, slots=True)
class Cover:
    """What the branch and bound found."""

    closed: bool
    """Every point of {h >= inner - eta} lies in a proven cell."""
    cells: F64
    """(m, CELL) as in `records.AxisCertificate`; not all that are needed when `closed` is false."""
    worst_q: float
    """Least proven margin of the cells, 1/s."""
    failed: tuple[float, float] | None
    """(e, v) where no command was found, or where the cells ran out."""


def cover(barrier: Barrier, setting: Setting, authority: Authority, *, most_cells: int = 20000) -> Cover:
    """Cover {h >= inner - eta} with boxes in which one command meets the condition throughout."""
    return cover_bands(barrier, setting, bands(authority), most_cells=most_cells)


def cover_bands(barrier: Barrier, setting: Setting, reaches: F64, *, most_cells: int = 20000) -> Cover:
    """The same with the authority's `bands`."""
    if len(reaches) == 0:
        return Cover(False, np.empty((0, CELL)), math.inf, (0.0, 0.0))
    cells = np.empty((most_cells, CELL))
    setting = Setting(*(float(number) for number in setting))  # compiled once: for floats
    count, worst, e, v = prove(barrier.rows, region_box(barrier, setting.eta - setting.inner), setting, reaches, cells)
    closed = count >= 0
    kept = cells[: count if closed else -count - 1].copy()
    return Cover(closed, kept, worst, None if closed else (e, v))


def region_box(barrier: Barrier, eta: float) -> F64:
    """(4,) e_low, e_high, v_low, v_high of a box that holds {h >= -eta}."""
    if isinstance(barrier, Quadratic):
        low_e, high_e, low_v, high_v = barrier.box
        grow = math.sqrt(1.0 + eta) - 1.0
        more_e, more_v = grow * 0.5 * (high_e - low_e), grow * 0.5 * (high_v - low_v)
    else:
        more = eta * 0.5 * (barrier.high_m - barrier.low_m)
        wider = Stopping(
            barrier.low_m - more, barrier.high_m + more, barrier.reaction_s, barrier.brake_high_mps2,
            barrier.brake_low_mps2,
        )  # fmt: skip
        low_e, high_e, low_v, high_v = wider.box
        more_e = more_v = 0.0
    more_e, more_v = more_e + 1e-9 * (high_e - low_e), more_v + 1e-9 * (high_v - low_v)
    return np.array([low_e - more_e, high_e + more_e, low_v - more_v, high_v + more_v])


def bands(authority: Authority) -> F64:
    """(n - 1, 6) between neighbouring nodes: v_low, v_high and the reach there, `Authority.reach`."""
    return _bands(authority.table)


@njit_called
def _bands(table: F64) -> F64:
    found = np.empty((table.shape[1] - 1, 6))
    for i in range(len(found)):
        found[i, 0], found[i, 1] = table[0, i], table[0, i + 1]
        found[i, 2], found[i, 3], found[i, 4], found[i, 5] = reach_between(table, i)
    return found


@njit_called
def prove(rows: F64, box: F64, setting: Setting, reaches: F64, cells: F64) -> tuple[int, float, float, float]:
    """Fill `cells`; (count, least q, 0, 0) when closed, else (-count - 1, least q, e, v) with where it failed."""
    count, worst = 0, np.inf
    cuts = _cuts(rows, box, reaches)
    wide_e, wide_v = box[_E_HIGH] - box[_E_LOW], box[_V_HIGH] - box[_V_LOW]
    stack = np.empty((_STACK, 4))
    for i in range(cuts.size - 1):
        k = _band(reaches, cuts[i], cuts[i + 1])
        reach = Reach(reaches[k, 2], reaches[k, 3], reaches[k, 4], reaches[k, 5])
        known = cuts[i] >= reaches[k, 0] and cuts[i + 1] <= reaches[k, 1] and reach.u_low <= reach.u_high
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = box[0], box[1], cuts[i], cuts[i + 1]
        left = 1
        while left > 0:
            left -= 1
            e_low, e_high, v_low, v_high = stack[left, 0], stack[left, 1], stack[left, 2], stack[left, 3]
            if outside(rows, e_low, e_high, v_low, v_high, setting.eta - setting.inner):
                continue
            e, v = 0.5 * (e_low + e_high), 0.5 * (v_low + v_high)
            if known:
                u, q, along_v = best_command(rows, e_low, e_high, v_low, v_high, setting, reach)
                if q >= 0.0:
                    if count == cells.shape[0]:
                        return -count - 1, worst, e, v
                    cell = cells[count]
                    _set_box(cell, e_low, e_high, v_low, v_high)
                    cell[_U], cell[_Q] = u, q
                    count, worst = count + 1, min(worst, q)
                    continue
            else:
                along_v = (v_high - v_low) * wide_e > (e_high - e_low) * wide_v
            small_e = e_high - e_low < _SMALLEST * wide_e
            small_v = v_high - v_low < _SMALLEST * wide_v
            if (small_e and small_v) or left + 2 > _STACK or _refuted(rows, e, v, setting, reach, known):
                return -count - 1, worst, e, v
            along_v = (along_v and not small_v) or small_e
            for j in range(2):
                _set_box(stack[left + j], e_low, e_high, v_low, v_high)
            if along_v:
                stack[left, 2], stack[left + 1, 3] = v, v
            else:
                stack[left, 0], stack[left + 1, 1] = e, e
            left += 2
    return count, worst, 0.0, 0.0


@njit
def _set_box(row: F64, e_low: float, e_high: float, v_low: float, v_high: float) -> None:
    row[_E_LOW], row[_E_HIGH], row[_V_LOW], row[_V_HIGH] = e_low, e_high, v_low, v_high


@njit
def _cuts(rows: F64, box: F64, reaches: F64) -> F64:
    """The speeds at which boxes begin: the box's ends, the authority's nodes and the pieces' kinks between.

    Rising, each once.  Sorted here, for NumPy's own way takes 2 s to compile.
    """
    cuts = np.empty(reaches.shape[0] + 3 + rows.shape[0])
    cuts[0] = box[_V_LOW]
    n = _insert(cuts, 1, box[_V_HIGH])
    for i in range(reaches.shape[0] + 1 + rows.shape[0]):
        if i < reaches.shape[0]:
            v = reaches[i, 0]
        elif i == reaches.shape[0]:
            v = reaches[i - 1, 1]
        else:
            row = rows[i - reaches.shape[0] - 1]
            v = -row[SIGN] * row[BRAKE] * row[REACTION] if row[KIND] == STOPPING else box[_V_LOW]
        if box[_V_LOW] < v < box[_V_HIGH]:
            n = _insert(cuts, n, v)
    return cuts[:n]


@njit
def _insert(rising: F64, count: int, v: float) -> int:
    """Put `v` among the first `count` where it is not there yet; how many there are then."""
    place = count
    while place > 0 and rising[place - 1] > v:
        place -= 1
    if place > 0 and rising[place - 1] == v:
        return count
    for i in range(count, place, -1):
        rising[i] = rising[i - 1]
    rising[place] = v
    return count + 1


@njit
def _band(reaches: F64, v_low: float, v_high: float) -> int:
    """The band that holds the middle of two neighbouring cuts, or the nearest."""
    v = 0.5 * (v_low + v_high)
    k = 0
    while k < reaches.shape[0] - 1 and v > reaches[k, 1]:
        k += 1
    return k


@njit
def outside(rows: F64, e_low: float, e_high: float, v_low: float, v_high: float, eta: float) -> bool:
    """Whether h < -eta in the whole box: a piece is concave, so it lies below its tangent plane at the centre."""
    e, v = 0.5 * (e_low + e_high), 0.5 * (v_low + v_high)
    for i in range(rows.shape[0]):
        h, h_e, h_v = piece_at(rows[i], e, v)
        if h + 0.5 * (abs(h_e) * (e_high - e_low) + abs(h_v) * (v_high - v_low)) < -eta - _SLACK:
            return True
    return False


@njit
def _refuted(rows: F64, e: float, v: float, setting: Setting, reach: Reach, known: bool) -> bool:
    """Whether the region is not certifiable because of this very point."""
    for i in range(rows.shape[0]):
        if piece_at(rows[i], e, v)[0] < setting.inner - setting.eta:
            return False
    return not known or interval(rows, e, v, setting, reach)[2] < 0.0


@njit
def best_command(
    rows: F64, e_low: float, e_high: float, v_low: float, v_high: float, setting: Setting, reach: Reach
) -> tuple[float, float, bool]:
    """A command, the q it proves in the whole box (less the slack), and whether q varies more along v than along e.

    No kink of a piece may lie inside (v_low, v_high).
    """
    quad = np.empty((4 * rows.shape[0], 7))
    for i in range(rows.shape[0]):
        h, he, hv = piece_at(rows[i], 0.5 * (e_low + e_high), 0.5 * (v_low + v_high))
        steep = h - setting.inner - doubt_of(rows[i], he, hv, setting.off_m, setting.off_mps) > NEAR_H
        slope = setting.gamma_ps + (setting.inside_ps if steep else 0.0)
        lift = curvature_lift(rows[i], setting, slope, v_high - v_low)
        for j in range(4):
            e, v = (e_high if j & 1 else e_low), (v_high if j & 2 else v_low)
            corner = coefficients(rows[i], e, v, setting, reach, steep)
            for k in range(7):
                quad[4 * i + j, k] = corner[k]
            quad[4 * i + j, _C] -= lift + _SLACK
    span = reach.u_high - reach.u_low
    best_u, best_q = reach.u_low, -np.inf
    for k in range(_TRIES + 1):
        u = reach.u_high if k == _TRIES else reach.u_low + span * k / _TRIES
        q = _least(quad, u)
        if q > best_q:
            best_u, best_q = u, q
    step = 0.5 * span / _TRIES
    for _ in range(3):
        middle = best_u
        for side in (-1.0, 1.0):
            u = min(max(middle + side * step, reach.u_low), reach.u_high)
            q = _least(quad, u)
            if q > best_q:
                best_u, best_q = u, q
        step *= 0.5
    along_e, along_v = 0.0, 0.0
    for i in range(rows.shape[0]):
        q0, q1, q2, q3 = (
            _at(quad[4 * i], best_u),
            _at(quad[4 * i + 1], best_u),
            _at(quad[4 * i + 2], best_u),
            _at(quad[4 * i + 3], best_u),
        )
        along_e = max(along_e, abs(q1 - q0), abs(q3 - q2))
        along_v = max(along_v, abs(q2 - q0), abs(q3 - q1))
    return best_u, best_q, along_v > along_e


@njit
def _at(quad: F64, u: float) -> float:
    kinked = abs(quad[_K] + quad[_M] * u) + abs(quad[_L] + quad[_N] * u)
    return float((quad[_A] * u + quad[_B]) * u + quad[_C] - kinked)


@njit
def _least(quad: F64, u: float) -> float:
    least = np.inf
    for i in range(quad.shape[0]):
        least = min(least, _at(quad[i], u))
    return float(least)


@njit
def curvature_lift(row: F64, setting: Setting, slope_ps: float, width_mps: float) -> float:
    """How far q may lie above its chord along v over this width: 0 unless a quadratic's cross term curves it upwards.

    q's second derivative along v is at most -2 Kev - slope Kvv - dt Kee, alpha being a line; along e it is
    never positive.
    """
    if row[0] != 0.0:
        return 0.0
    upward = -2.0 * row[K_EV] - slope_ps * row[K_VV] - setting.dt_s * row[K_EE]
    return float(0.125 * max(upward, 0.0) * width_mps * width_mps)
