"""How wide a tube is: the furthest that a search (`worst`) finds the loop driven from rest and from ways out.

The loop's pole is the one that is driven least far at rest.  Ways out from some motions are searched then: those that
begin with little motion, with more, and with a lean that is not the one they brake with (`backup.wide`).  Claimed is
ROOM times what is found, for a search may find too little.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from flightstack.rows import ACC_E, ACC_N, VEL_N
from flightstack.site import backup as b
from flightstack.site.tube import STEP_S, LoopBounds, Tube, across
from flightstack.site.worst import Held, Loop, course_of, worst
from flightstack.types import F64

_POLES_PS = tuple(0.6 + 0.2 * k for k in range(21))
_RESTING_S, ROOM = (0.8, 1.4, 2.2, 3.2), 1.05
_LITTLE = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (1.0, 1.7, 1.7), (0.0, 3.0, 0.0), (2.0, -3.0, 0.0))
_MUCH = ((3.0, 0.0, 0.0), (5.0, 0.0, 0.0), (6.0, 0.0, 0.0), (8.0, 0.0, 0.0), (2.0, 4.0, 0.0), (3.0, 0.0, 4.0))
_LEANT = (
    (0.0, 6.0, 0.0), (1.0, 4.5, 2.5), (1.0, 0.0, 4.0), (2.0, 0.0, 6.0), (2.0, -1.5, 5.0), (2.0, -5.0, 2.5),
    (3.0, -2.3, 1.3), (3.0, -2.5, 5.5), (3.0, -4.0, 0.0), (4.0, -4.0, 0.5), (4.0, -6.0, 0.7), (6.0, -4.5, 1.0),
    (6.0, -6.0, 0.0), (6.0, -3.0, 5.0), (5.0, 2.5, 6.0), (1.5, 5.5, 5.5),
)  # fmt: skip
"""Ways whose worst is searched for, with little motion at first, with more, and leaning: speed north, lean north,
east."""
_MOMENTS, _STILL_S, _STARTS = tuple(0.12 + 0.07 * k for k in range(10)), 2.5, 12
"""Shares of a way's time.  Half of the first courses find up to a third less, sixteen times as many a tenth more of
single ways."""


@lru_cache(maxsize=64)
def resting(lags_s: tuple[float, float], doubts: LoopBounds, held: Held) -> Tube:
    """The loop that is driven least far from rest: its pole is searched."""
    still, best, least = course_of(np.zeros((1, b.ROW)), _RESTING_S[-1]), None, math.inf
    for pole in _POLES_PS:
        tube = across(pole, lags_s, doubts)
        if tube is None:
            continue
        found = worst(Loop.of(tube.gains, lags_s), held, still, _RESTING_S, rounds=8)[0]
        if found < least:
            best, least = tube, found
    assert best is not None
    return best


def searched(rows: F64, tube: Tube, held: Held, lags_s: tuple[float, float]) -> Tube:
    """The loop with what its ways can be left by, which the rows are told: those that brake as hard as any by the last
    one, the others by the first one as well."""
    loop = Loop.of(tube.gains, lags_s)
    whole = np.all(rows[:, [b.ACROSS, b.LEAN]] == rows[-1, [b.ACROSS, b.LEAN]], axis=1)
    found = np.zeros((2, 3))
    for at in [-1] if whole.all() else [-1, 0]:
        ends = held._replace(lean_mps2=float(rows[at, b.LEAN]))
        row = tuple(rows[at].tolist())
        little, much, leant = ([ROOM * _left(row, loop, ends, each) for each in of] for of in (_LITTLE, _MUCH, _LEANT))
        rest = max(found[-1, 0], ROOM * float(tube.radius_m[-1]), *little)
        most = max(found[-1, 1], rest, *much)
        found[at] = rest, most, max(found[-1, 2], _per_lean(rows[at], (rest, most), leant))
    rows[:, b.REST_RADIUS :] = np.where(whole[:, None], found[-1], found[0])
    return tube._replace(radius_m=np.full(len(tube.radius_m), rows[0, b.REST_RADIUS]))


def _per_lean(row: F64, radii_m: tuple[float, float], left_m: list[float]) -> float:
    """By how much a tube grows for a lean (s^2), so that it holds what `_LEANT` are left by."""
    given, most = np.array([*row[: b.REST_RADIUS], *radii_m, 0.0]), 0.0
    for motion, left in zip(_LEANT, left_m, strict=True):
        points = _laid_out(given, motion)
        if left > b.widest(points, len(points), given):
            most = max(most, (left - radii_m[0]) / max(b.leant(points[0], given) - b.LITTLE_MPS2, 0.1))
    return most


def _laid_out(row: F64, motion: tuple[float, float, float]) -> F64:
    """The points of the way from a motion; none where there is no way."""
    start, points, way = np.zeros(b.ROW), np.zeros((b.STEPS, b.ROW)), np.zeros((b.STEPS, 5))
    start[VEL_N], start[ACC_N], start[ACC_E] = motion
    return points[: b.roll(start, row, np.zeros(b.STEPS), points, way)]


@lru_cache(maxsize=1024)
def _left(row: tuple[float, ...], loop: Loop, held: Held, motion: tuple[float, float, float]) -> float:
    """How far the way from a motion can be left; 0 where there is none."""
    points = _laid_out(np.array(row), motion)
    if not len(points):
        return 0.0
    course = course_of(points, _STILL_S)
    moments = tuple(STEP_S * len(course) * each for each in _MOMENTS)
    return worst(loop, held, course, moments, rounds=30, starts=_STARTS)[0]
