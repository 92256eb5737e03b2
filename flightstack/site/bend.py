"""The reference, bent: one that leads through a wall is led along it instead; compiled.

Where the reference keeps its distance it passes, to the bit.  Where it does not, or comes near too fast, a place that
does follows it, no faster than the reference itself plus a little, and slides along what is in the way.  Where the
reference jumps, the straight way to it must be clear as well, and it is led there (`approach`): no vehicle can jump.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit, njit_called
from flightstack.rows import JERK_N, WAY_HALF, WAY_RADIUS
from flightstack.site import approach, slide
from flightstack.site.clearance import JUMP_CODE, clear_of
from flightstack.types import F64

BENT, KNOWN, EDGE, PLACE, SPEED, ACC, SIZE = 0, 1, 2, 3, 6, 9, 12
"""Of the memory: 1 while bent, 1 once a place is known; what is in the way; the place (3, NED), its velocity (3), its
acceleration (3)."""
_BACK_M, _BACK_MPS = 0.02, 0.1
_LEAD_M = 0.15
_JUMP_M = 0.3
_PUSHES, _SLOWED = 12, 3


@njit
def _is_clear(site: F64, s: F64, to: F64, origin: F64, way: F64) -> tuple[bool, int]:
    """Whether the straight way from a place (3, NED) to another keeps the distance."""
    length = math.sqrt((to[0] - origin[0]) ** 2 + (to[1] - origin[1]) ** 2 + (to[2] - origin[2]) ** 2)
    count = min(1 + int(length / _JUMP_M), len(way))
    for k in range(count):
        share = (k + 1.0) / count
        for i in range(2):
            way[k, i] = origin[i] + share * (to[i] - origin[i])
        way[k, 2] = -(origin[2] + share * (to[2] - origin[2]))
        spacing = 0.5 * length / count if count > 1 else 0.0
        way[k, WAY_RADIUS], way[k, WAY_HALF] = s[slide.RADIUS] + spacing, s[slide.HALF] + spacing
    clearance, edge = clear_of(site, way, count, 1.0)
    return clearance >= 0.0, edge


@njit
def _pushed(site: F64, s: F64, place: F64, rows: F64) -> int:
    """Move a place (3, NED) to where it keeps its distance from everything near; what moved it most, or 0."""
    still, code, most = np.zeros(3), 0, 0.0
    for _ in range(_PUSHES):
        count = slide.bounds(site, place, still, s, rows)
        worst, at = 1e-9, -1
        for i in range(count):
            if rows[i, slide.BOUND] > worst:
                worst, at = rows[i, slide.BOUND], i
        if at < 0:
            break
        short = worst * s[slide.SLOW_S] / s[slide.GAMMA]
        for i in range(3):
            place[i] += rows[at, i] * short
        if short > most:
            most, code = short, int(rows[at, slide.CODE])
    return code


@njit
def _slowed(site: F64, s: F64, place: F64, v: F64, rows: F64) -> int:
    """Take from a velocity (3,) what approaches anything faster than it could be stopped; what was nearest, or -3."""
    still, code, most = np.zeros(3), -3, 0.0
    count = slide.bounds(site, place, still, s, rows)
    for _ in range(_SLOWED):
        for i in range(count):
            n, slow_s = rows[i], s[slide.SLOW_S]
            room = max(-n[slide.BOUND] * slow_s / s[slide.GAMMA], 0.0)
            brake = s[slide.BRAKE] if n[2] == 0.0 else (s[slide.UP] if n[2] < 0.0 else s[slide.DOWN])
            allowed = brake * (math.sqrt(slow_s * slow_s + 2.0 * room / brake) - slow_s)
            over = -(n[0] * v[0] + n[1] * v[1] + n[2] * v[2]) - allowed
            if over > 0.0:
                for k in range(3):
                    v[k] += over * n[k]
                if over > most:
                    most, code = over, int(n[slide.CODE])
    return code


def begin(n: F64, measured: F64, origin_ned_m: F64) -> None:
    """Begin where the vehicle is, as it moves."""
    n[KNOWN], n[PLACE : PLACE + 3], n[SPEED : SPEED + 3] = 1.0, measured[:3] - origin_ned_m, measured[3:6]


@njit_called
def bend(n: F64, site: F64, s: F64, reference: F64, dt: float, rows: F64, way: F64, out: F64) -> bool:
    """The reference (17,), relative to the origin, as it is to be followed, in `out` (17,); whether it was changed."""
    for i in range(17):
        out[i] = reference[i]
    place, speed, way_of, v = n[PLACE : PLACE + 3], n[SPEED : SPEED + 3], n[PLACE : PLACE + approach.SIZE], np.empty(3)
    free, edge = _is_clear(site, s, reference, place, way)
    if free:
        for i in range(3):
            v[i] = reference[3 + i]
        slowed = _slowed(site, s, reference, v, rows)
        free, edge = slowed == -3, slowed
    away = apart = jump = 0.0
    for i in range(3):
        away += (reference[i] - place[i]) ** 2
        apart += (reference[3 + i] - speed[i]) ** 2
        jump += (reference[i] - place[i] - dt * speed[i]) ** 2
    away = math.sqrt(away)
    if n[BENT] == 0.0 and jump > _LEAD_M * _LEAD_M:
        free, edge = False, JUMP_CODE
    if free and (n[BENT] == 0.0 or (away < _BACK_M and apart < _BACK_MPS**2)):
        n[BENT] = 0.0
        for i in range(3):
            place[i], speed[i], n[ACC + i] = reference[i], reference[3 + i], reference[6 + i]
        return False
    if n[BENT] == 0.0:
        n[EDGE] = edge
    n[BENT] = 1.0
    approach.towards(way_of, reference[:12], s[slide.LED_JERK], dt, v)
    slowed = _slowed(site, s, place, v, rows)
    if slowed != -3:
        n[EDGE] = slowed
    jerk = reference[JERK_N : JERK_N + 3]
    own = min(math.sqrt(jerk[0] ** 2 + jerk[1] ** 2 + jerk[2] ** 2), approach.JERK_MOST_MPS3)
    approach.advance(way_of, v, s[slide.LED_JERK] + own, dt)
    _pushed(site, s, place, rows)
    for i in range(9):
        out[i] = way_of[i]
    for i in range(9, 15):
        out[i] = 0.0
    return True
