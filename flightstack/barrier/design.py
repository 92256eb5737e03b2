"""The largest barrier that a safe set and the command's authority allow, by area, and what of it remains on a slice.

Volume is maximised, not the trace of P: that would let one axis grow for another.  The search is deterministic: for
each shape, given by a few ratios, the largest size that lies in the safe set and meets the condition on points
(`design_search`); over the ratios a grid and then a pattern search.  The cover is the proof: where it does not close,
a little more margin is asked of the points.

Families: `quadratic` (cross term and free centre), `centred` (1 - z^T M z, M positive definite), `mu` (the published
scalar parameter, no cross term), `stopping`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flightstack.barrier.condition import Setting
from flightstack.barrier.cover import Cover, bands, cover_bands
from flightstack.barrier.design_search import (
    QUADRATIC,
    STOPPING,
    build,
    climb,
    farthest,
    fit,
    largest_size,
    overlap,
    speeds,
)  # fmt: skip
from flightstack.barrier.records import Authority, Response
from flightstack.barrier.shapes import (
    BRAKE,
    CENTRE_E,
    CENTRE_V,
    LIMIT,
    P11,
    P12,
    P22,
    REACTION,
    ROW,
    Barrier,
    Quadratic,
    Stopping,
)
from flightstack.region import Region
from flightstack.types import F64

_MOST_CELLS = 4000
"""What a proof may cost; beyond, the barrier is made smaller instead."""
_FEW_CELLS = 1500
"""What it may cost in flight."""
_SPARE_PS = (0.003, 0.01, 0.03, 0.1)
"""Margins asked of the points, 1/s, until the cover closes: the less, the more cells."""
_INSIDE = 1.0 - 1e-4
"""Share of the safe set that the search uses: its own test of an edge is on points."""
_STARTS = 3
"""Points of the grid that are climbed from."""
_AREA_SPEEDS = 2000


@dataclass(frozen=True, slots=True)
class SafeSet:
    """What the barrier's region must lie in: |e| <= limit_m, or e^2 / limit_m^2 + v^2 / limit_mps^2 <= 1."""

    limit_m: float
    limit_mps: float | None = None
    """None: any speed."""

    @property
    def table(self) -> F64:
        """(2,) for compiled code; the strip is an ellipse without end."""
        return np.array([self.limit_m, 1e9 if self.limit_mps is None else self.limit_mps])

    def holds(self, barrier: Barrier) -> bool:
        """Whether the region {h >= 0} lies inside; exact, but for rounding."""
        if self.limit_mps is None:
            e_low, e_high = barrier.box[:2]
            return bool(max(-e_low, e_high) <= self.limit_m)
        if isinstance(barrier, Quadratic):
            return bool(farthest(barrier.rows[0], self.table) <= 1.0)
        v_low, v_high = speeds(barrier.rows, 0.0)
        t = barrier.reaction_s
        return self._holds_edge(barrier.high_m, t, barrier.brake_high_mps2, v_low, v_high) and self._holds_edge(
            -barrier.low_m, t, barrier.brake_low_mps2, -v_high, -v_low
        )

    def _holds_edge(self, limit_m: float, t_s: float, brake_mps2: float, v_low: float, v_high: float) -> bool:
        """One edge, e = limit - t v - v^2 / (2 brake): the farthest of its ends and of the roots of the derivative."""
        ratio = (self.limit_m / self.table[1]) ** 2
        e = np.polynomial.Polynomial([limit_m, -t_s, -0.5 / brake_mps2])
        far = e * e + ratio * np.polynomial.Polynomial([0.0, 0.0, 1.0])
        slow = max(-brake_mps2 * t_s, v_low)
        at = [slow, v_high, *(x for x in far.deriv().roots().real if slow < x < v_high)]
        flat = float(e(slow)) ** 2 + ratio * v_low * v_low  # at lower speeds the edge is straight
        return bool(max(flat, *(float(far(x)) for x in at)) <= self.limit_m**2)


def safe_sets(region: Region, axes: tuple[int, ...]) -> dict[int, SafeSet]:
    """Each axis' ellipse in (position, velocity); their product lies in the region."""
    shrink = 1.0 if region.kind == "axes" else 1.0 / math.sqrt(len(axes))
    return {i: SafeSet(shrink * region.semi_axes_m[i], shrink * region.semi_axes_mps[i]) for i in axes}


@dataclass(frozen=True, slots=True)
class RegionDesign:
    """The largest barrier found, with its proof."""

    barrier: Barrier | None
    """None: no size of the family closes."""
    cover: Cover | None


def largest(
    safe: SafeSet, setting: Setting, authority: Authority, response: Response, *, family: str = "quadratic"
) -> RegionDesign:
    """The barrier of a family that is largest on the slice of zero commanded acceleration (`slice_area`)."""
    setting = _plain(setting)
    table, limits, shear = bands(authority), safe.table * _INSIDE, response.c1_s + response.delay_s
    kind = STOPPING if family == "stopping" else QUADRATIC
    starts, steps = _grid(family, safe)
    rows = np.zeros((2, ROW))
    asked = _with(setting, _SPARE_PS[0])
    ranked = sorted(starts, key=lambda x: -fit(kind, x, limits, asked, table, shear, rows)[0])[:_STARTS]
    for spare in _SPARE_PS:
        asked = _with(setting, spare)
        climbs = [climb(kind, x, steps, limits, asked, table, shear) for x in ranked]
        x, area, size = max(climbs, key=lambda found: found[1])
        if area <= 0.0:
            break
        build(kind, x, size, limits, table, rows)
        design = _proven(_barrier(rows, kind), safe, setting, table, _MOST_CELLS)
        if design.barrier is not None:
            return design
        ranked = [x]
    return RegionDesign(None, None)


def grow(
    shape: Barrier,
    safe: SafeSet,
    setting: Setting,
    authority: Authority,
    *,
    change: Callable[[Barrier, float], Barrier] | None = None,
    most: float = 20.0,
) -> RegionDesign:
    """The same shape at the largest size that lies in the safe set and closes: quick enough for flight.

    `change` makes the shape of a size from 0 to `most`: `at_level` (the default) or `at_speed`.
    """
    of_size = change or at_level
    setting, table = _plain(setting), bands(authority)
    highest = most
    if not safe.holds(of_size(shape, most)):
        highest = _last(lambda size: safe.holds(of_size(shape, size)), 0.0, most, 16)
    for spare in _SPARE_PS[1:]:
        size = largest_size(shape.rows, change is at_speed, highest, _with(setting, spare), table)
        if size <= 0.0:
            break
        design = _proven(of_size(shape, size), safe, setting, table, _FEW_CELLS)
        if design.barrier is not None:
            return design
    return RegionDesign(None, None)


def at_level(shape: Barrier, level: float) -> Barrier:
    """The shape with its distances times the root of level.

    An ellipse's speeds and centre grow alike (1 - z^T P z / level when it is centred); a stopping way stays as it is.
    """
    by = math.sqrt(level)
    if isinstance(shape, Quadratic):
        return Quadratic(
            by * shape.centre_m, by * shape.centre_mps, shape.p11 / level, shape.p12 / level, shape.p22 / level
        )
    return Stopping(by * shape.low_m, by * shape.high_m, shape.reaction_s, shape.brake_high_mps2, shape.brake_low_mps2)


def at_speed(shape: Barrier, by: float) -> Barrier:
    """The shape with its speeds times `by` and its distances as they are: h_mu with mu / by^2."""
    if isinstance(shape, Quadratic):
        return Quadratic(shape.centre_m, by * shape.centre_mps, shape.p11, shape.p12 / by, shape.p22 / (by * by))
    more = by * by
    return Stopping(
        shape.low_m, shape.high_m, shape.reaction_s / by, more * shape.brake_high_mps2, more * shape.brake_low_mps2
    )


def slice_area(
    barrier: Barrier, response: Response, a_mps2: float = 0.0, under_way_mps2: float = 0.0, inner: float = 0.0
) -> float:
    """Area of the (p, v) that the filter takes for inside at an acceleration a, m^2/s: they and their z
    (where h is at least `inner`) lie in it.

    The commands under way are taken as constant over the delay, and the rate of the acceleration as zero.
    """
    c1, c2, delay = response.c1_s, response.c2_s2, response.delay_s
    shift_m = (c2 + delay * c1) * a_mps2 + 0.5 * delay * delay * under_way_mps2
    shift_mps = c1 * a_mps2 + delay * under_way_mps2
    return float(overlap(barrier.rows, c1 + delay, shift_m, shift_mps, _AREA_SPEEDS, inner))


def worst_slice_area(
    barrier: Barrier, response: Response, u_low_mps2: float, u_high_mps2: float, inner: float = 0.0
) -> float:
    """Least `slice_area` over all accelerations and commands under way in a range.

    The root of the area in common of two convex sets is concave in how far one is moved (Brunn and Minkowski), so the
    least is at a corner.
    """
    ends = (u_low_mps2, u_high_mps2)
    return min(slice_area(barrier, response, a, under_way, inner) for a in ends for under_way in ends)


def _proven(barrier: Barrier, safe: SafeSet, setting: Setting, table: F64, most_cells: int) -> RegionDesign:
    if not safe.holds(barrier):
        return RegionDesign(None, None)
    proof = cover_bands(barrier, setting, table, most_cells=most_cells)
    return RegionDesign(barrier, proof) if proof.closed else RegionDesign(None, None)


def _plain(setting: Setting) -> Setting:
    """The same as floats: compiled code is made once for each type it meets."""
    return Setting(*(float(number) for number in setting))


def _with(setting: Setting, spare_ps: float) -> Setting:
    return setting._replace(rate_ps=setting.rate_ps + spare_ps)


def _last(holds: Callable[[float], bool], low: float, high: float, halvings: int) -> float:
    """The greatest number at which it still holds, within the range halved so often; it holds at low, not at high."""
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _barrier(rows: F64, kind: int) -> Barrier:
    row = [float(number) for number in rows[0]]
    if kind == QUADRATIC:
        return Quadratic(row[CENTRE_E], row[CENTRE_V], row[P11], row[P12], row[P22])
    return Stopping(-float(rows[1, LIMIT]), row[LIMIT], row[REACTION], row[BRAKE], float(rows[1, BRAKE]))


def _grid(family: str, safe: SafeSet) -> tuple[list[F64], F64]:
    """Ratios to begin with (`design_search.build`) and the first steps of the climb; 0 holds a ratio."""
    strip = safe.limit_mps is None
    if family == "stopping":
        times = (0.03, 0.06, 0.12, 0.25)
        brakes = (0.6, 0.8, 1.0) if strip else (0.05, 0.1, 0.2, 0.4, 0.8)
        edges = (1.0,) if strip else (1.0, 0.85, 0.7)
        step = 0.0 if strip else 0.08
        return [np.array([t, b, high, low]) for t, b, high, low in itertools.product(times, brakes, edges, edges)], (
            np.array([0.015, 0.08, step, step])
        )
    cross = (0.0,) if family == "mu" else tuple(np.linspace(0.05, 0.85, 9))
    speed = tuple(np.linspace(-0.9, 0.9, 7)) if family == "quadratic" else (0.0,)
    width = (1.0,) if strip else (1.0, 0.85, 0.7)
    shift = (0.0,) if strip or family != "quadratic" else (-0.2, 0.0, 0.2)
    free = np.array([family == "quadratic", family != "mu", not strip, family == "quadratic" and not strip])
    starts = [np.array([v, c, w, e]) for v, c, w, e in itertools.product(speed, cross, width, shift)]
    return starts, np.where(free, 0.08, 0.0)
