"""How wide a tube is: the furthest that a search (`worst`) finds the loop driven from rest and from ways out.

The loop's pole is the one that is driven least far at rest.  Ways out from some motions are searched then: those that
begin with little motion, with more, with a lean that is not the one they brake with (`backup.wide`), and turning.
Claimed is ROOM times what is found, for a search may find too little.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from flightstack.kept import kept
from flightstack.rows import ACC_E, ACC_N, JERK_E, JERK_N, VEL_N
from flightstack.site import backup as b
from flightstack.site.tube import STEP_S, LoopBounds, Tube, across
from flightstack.site.worst import Held, Loop, course_of, worst
from flightstack.types import F64, Mask

_POLES_PS = tuple(0.6 + 0.2 * k for k in range(21))
_RESTING_S, ROOM = (0.8, 1.4, 2.2, 3.2), 1.05
_LITTLE = ((2.0, 0.0, 0.0), (1.0, 1.7, 1.7), (0.0, 3.0, 0.0), (2.0, -3.0, 0.0))
_MUCH = ((6.0, 0.0, 0.0), (2.0, 4.0, 0.0), (3.0, 0.0, 4.0))
_LEANT = (
    (0.0, 6.0, 0.0), (2.0, 0.0, 6.0), (3.0, -2.3, 1.3), (3.0, -2.5, 5.5),
    (4.0, -4.0, 0.5), (6.0, -4.5, 1.0), (6.0, -6.0, 0.0), (1.5, 5.5, 5.5), (5.0, 0.8, -2.8, 1.2, -1.1),
)  # fmt: skip
_TURNING = (
    (2.0, 1.2, 2.8, 4.5, 0.3), (3.0, 0.9, 3.3, -21.5, 5.0), (4.0, -2.9, 4.2, 19.6, -5.2),
    (1.5, -2.9, -1.2, 24.2, 0.2), (6.0, -0.8, -1.3, 7.4, -15.7), (4.0, -4.4, -1.6, -5.8, 0.2),
    (3.0, 4.8, -3.0, -10.0, -8.2), (1.5, 0.7, -2.9, -0.9, -5.4), (1.5, -4.5, 1.2, 22.3, 8.7),
    (6.0, -3.8, -0.6, 12.7, -10.5), (5.0, 0.0, 0.0, 13.3, 4.3),
)  # fmt: skip
"""Ways whose worst is searched for, with little motion at first, with more, leaning, and turning: speed north, lean
north, east, how fast that turns north, east."""
_LEANING = 3
_MOMENTS, _STILL_S, _STARTS = tuple(0.12 + 0.07 * k for k in range(10)), 2.5, 12
"""Shares of a way's time.  Half of the first courses find up to a third less, sixteen times as many a tenth more of
single ways."""


@lru_cache(maxsize=64)
def resting(lags_s: tuple[float, float], doubts: LoopBounds, held: Held) -> Tube:
    """The loop that is driven least far from rest: its pole is searched."""
    still = course_of(np.zeros((1, b.ROW)), _RESTING_S[-1])
    tubes = [tube for pole in _POLES_PS if (tube := across(pole, lags_s, doubts)) is not None]
    loops = [Loop.of(tube.gains, lags_s) for tube in tubes]
    found = kept(
        __name__, ("resting", loops, held), lambda: [worst(of, held, still, _RESTING_S, rounds=8)[0] for of in loops]
    )
    return tubes[int(np.argmin(found))]


def searched(rows: F64, tube: Tube, held: Held, lags_s: tuple[float, float]) -> Tube:
    """The loop with what its ways can be left by, which the rows are told: those that brake as hard as any by the last
    one, the others by the first one as well."""
    question = "searched", rows.tolist(), tube.gains, float(tube.radius_m[-1]), held, lags_s
    found = np.reshape(kept(__name__, question, lambda: _found(rows, tube, held, lags_s).ravel().tolist()), (2, 4))
    rows[:, b.REST_RADIUS :] = np.where(_brake_alike(rows)[:, None], found[-1], found[0])
    return tube._replace(radius_m=np.full(len(tube.radius_m), rows[0, b.REST_RADIUS]))


def _brake_alike(rows: F64) -> Mask:
    """Which rows brake as hard as the last one."""
    alike: Mask = np.all(rows[:, [b.ACROSS, b.LEAN]] == rows[-1, [b.ACROSS, b.LEAN]], axis=1)
    return alike


def _found(rows: F64, tube: Tube, held: Held, lags_s: tuple[float, float]) -> F64:
    """(2, 4) what the first row and the last are told; the first's are 0 where all brake as hard."""
    loop, found = Loop.of(tube.gains, lags_s), np.zeros((2, 4))
    for at in [-1] if _brake_alike(rows).all() else [-1, 0]:
        ends = held._replace(lean_mps2=float(rows[at, b.LEAN]))
        row = tuple(rows[at].tolist())
        little, much, leant, turning = (
            [ROOM * _left(row, loop, ends, each) for each in of] for of in (_LITTLE, _MUCH, _LEANT, _TURNING)
        )
        rest = max(found[-1, 0], ROOM * float(tube.radius_m[-1]), *little)
        most = max(found[-1, 1], rest, *much)
        per_lean = max(found[-1, 2], _per_lean(rows[at], (rest, most), leant))
        found[at] = rest, most, per_lean, max(found[-1, 3], _per_turn(rows[at], (rest, most, per_lean), turning))
    found[:, 3] = found[:, 3].max()  # drawn ways of the lightest need what the heaviest's do
    return found


def _per_lean(row: F64, radii_m: tuple[float, float], left_m: list[float]) -> float:
    """By how much a tube grows for a lean (s^2), so that it holds what `_LEANT` are left by."""
    given, most = np.array([*row[: b.REST_RADIUS], *radii_m, 0.0, 0.0]), 0.0
    for motion, left in zip(_LEANT, left_m, strict=True):
        points = _laid_out(given, motion)
        if left > b.widest(points, len(points), given):
            most = max(most, (left - radii_m[0]) / max(b.leant(points[0], given) - b.LITTLE_MPS2, 0.1))
    return most


def _per_turn(row: F64, radii: tuple[float, float, float], left_m: list[float]) -> float:
    """By how much it grows for turning (s^6/m), so that it holds what `_TURNING` are left by."""
    given, most = np.array([*row[: b.REST_RADIUS], *radii, 0.0]), 0.0
    for motion, left in zip(_TURNING, left_m, strict=True):
        points = _laid_out(given, motion)
        if len(points):
            most = max(most, (left - b.widest(points, len(points), given)) / b.turns(points[0], given))
    return most


def _laid_out(row: F64, motion: tuple[float, ...]) -> F64:
    """The points of the way from a motion; none where there is no way."""
    start, points, way = np.zeros(b.ROW), np.zeros((b.STEPS, b.ROW)), np.zeros((b.STEPS, 5))
    start[VEL_N] = motion[0]
    start[ACC_N : ACC_E + 1] = motion[1:3]
    if len(motion) > _LEANING:
        start[JERK_N : JERK_E + 1] = start[b.ASKED_N : b.ASKED_N + 2] = motion[3:]
    return points[: b.roll(start, row, np.zeros(b.STEPS), points, way)]


@lru_cache(maxsize=1024)
def _left(row: tuple[float, ...], loop: Loop, held: Held, motion: tuple[float, ...]) -> float:
    """How far the way from a motion can be left; 0 where there is none."""
    points = _laid_out(np.array(row), motion)
    if not len(points):
        return 0.0
    course = course_of(points, _STILL_S)
    moments = tuple(STEP_S * len(course) * each for each in _MOMENTS)
    return worst(loop, held, course, moments, rounds=30, starts=_STARTS)[0]
