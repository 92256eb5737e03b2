"""Smoothness: how much a command may push towards what is near, and the acceleration nearest to the wanted one.

The guarantee is the committed way out (`backup`); alone it would let a vehicle race up to a wall and then brake as hard
as is certified.  So a command is changed before: for each near thing at distance d, approached at the speed v,

    h = d - radius - t v - max(v, 0)^2 / (2 a) >= 0,    h' >= -gamma h

which bounds the acceleration along the normal from below.  The acceleration nearest to the wanted one that keeps all
bounds is found by Hildreth's iteration; where it does not come to an end in time (no such acceleration), the way out is
still there.  Compiled.  Source: C. Hildreth, "A quadratic programming procedure", 1957.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit, njit_called
from flightstack.site.clearance import (
    _BOTTOM,
    _EAST,
    _HIGH,
    _LOW,
    _NORTH,
    _POLYGON,
    _ROUND,
    _STAY,
    _TALL,
    _TOP,
    _WIDE,
    CEILING,
    CEILING_CODE,
    CHUTES,
    FLOOR,
    FLOOR_CODE,
    GROUND,
    HEAD,
    POLYGONS,
    ROUND_CODE,
    ROUNDS,
    in_chute,
    is_within,
    nearest_on_edge,
)
from flightstack.types import F64

MOST_ROWS = 48
BOUND, CODE, WEIGHT = 3, 4, 5
"""Of a row, after the normal."""
RADIUS, HALF, SLOW_S, BRAKE, GAMMA, UP, DOWN, LED_JERK, SOFT = range(9)
"""Of the parameters: radius across and half height kept, time and deceleration of the approach across, gamma, what
slows a fall and a climb; the jerk of a reference that is led."""
_ROUNDS_OF_ITERATION = 40
_NEVER_MPS2 = -25.0
_ON_TOP = 1e-6
LANDING_MPS = 0.7
"""A vehicle in the chute touches the ground no faster: PX4's MPC_LAND_SPEED."""


@njit
def _row(rows: F64, count: int, code: int, normal: tuple[float, float, float], room: float, v: F64, s: F64) -> int:
    """Add the bound of one near thing; normal (NED) points away from it, `room` is what is left beyond the radius."""
    speed = -(normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2])
    brake = s[BRAKE]
    if normal[2] != 0.0:
        steep = abs(normal[2])
        brake = (1.0 - steep) * brake + steep * (s[UP] if normal[2] < 0.0 else s[DOWN])
    towards = max(speed, 0.0)
    h = room - s[SLOW_S] * speed - 0.5 * towards * towards / brake
    least = (speed - s[GAMMA] * h) / (s[SLOW_S] + towards / brake)
    if least < _NEVER_MPS2 or count >= MOST_ROWS:
        return count
    rows[count, 0], rows[count, 1], rows[count, 2] = normal
    rows[count, BOUND] = min(least, 2.0 * brake)
    rows[count, CODE], rows[count, WEIGHT] = code, 0.0
    return count + 1


@njit
def _flat_row(rows: F64, count: int, code: int, n: float, e: float, room: float, v: F64, s: F64) -> int:
    """The same of a horizontal distance (n, e) to the vehicle from what is near."""
    size = math.sqrt(n * n + e * e)
    if size < _ON_TOP:
        return count
    return _row(rows, count, code, (n / size, e / size, 0.0), size - room, v, s)


@njit
def _upright_row(rows: F64, count: int, code: int, is_below: bool, room: float, v: F64, s: F64) -> int:
    """The same of what is below the vehicle, or above it."""
    return _row(rows, count, code, (0.0, 0.0, -1.0 if is_below else 1.0), room, v, s)


@njit_called
def bounds(site: F64, p: F64, v: F64, s: F64, rows: F64) -> int:
    """Every near thing's bound at a place and velocity (NED, 3): rows (MOST_ROWS, 6) of normal, bound, code, weight."""
    count, height = 0, -p[2]
    if not in_chute(site, p[0], p[1], s[RADIUS]):
        count = _upright_row(rows, count, FLOOR_CODE, True, height - site[FLOOR] - s[HALF], v, s)
    elif site[GROUND] > 0.0:
        slower = v.copy()
        slower[2] -= LANDING_MPS
        count = _upright_row(rows, count, FLOOR_CODE, True, height, slower, s)
    count = _upright_row(rows, count, CEILING_CODE, False, site[CEILING] - height - s[HALF], v, s)
    at = HEAD + 2 * int(site[CHUTES])
    for i in range(int(site[ROUNDS])):
        solid, code = site[at : at + _ROUND], ROUND_CODE + i
        n, e = p[0] - solid[_NORTH], p[1] - solid[_EAST]
        if not math.isnan(solid[_TALL]):
            tall = height - solid[_TALL]
            size = max(math.sqrt(n * n + e * e + tall * tall), _ON_TOP)
            kept = s[RADIUS] * math.sqrt(n * n + e * e) / size + s[HALF] * abs(tall) / size
            count = _row(rows, count, code, (n / size, e / size, -tall / size), size - solid[_WIDE] - kept, v, s)
        else:
            over = max(solid[_LOW] - height, height - solid[_HIGH]) - s[HALF]
            if over > math.sqrt(n * n + e * e) - solid[_WIDE] - s[RADIUS]:
                count = _upright_row(rows, count, code, height > solid[_HIGH], over, v, s)
            else:
                count = _flat_row(rows, count, code, n, e, solid[_WIDE] + s[RADIUS], v, s)
        at += _ROUND
    first = 0
    for _ in range(int(site[POLYGONS])):
        corners = int(site[at])
        head, flat = site[at : at + _POLYGON], site[at + _POLYGON : at + _POLYGON + 2 * corners]
        count = _of_polygon(head, flat, first, p, v, s, rows, count)
        at += _POLYGON + 2 * corners
        first += corners
    return count


@njit
def _of_polygon(head: F64, corners: F64, first: int, p: F64, v: F64, s: F64, rows: F64, count: int) -> int:
    edges = len(corners) // 2
    if head[_STAY] == 0.0:
        height = -p[2]
        over = max(head[_BOTTOM] - height, height - head[_TOP]) - s[HALF]
        nearest = np.inf
        for i in range(edges):
            pn, pe = nearest_on_edge(p[0], p[1], corners, i)
            nearest = min(nearest, (p[0] - pn) ** 2 + (p[1] - pe) ** 2)
        flat = -math.sqrt(nearest) if is_within(p[0], p[1], corners) else math.sqrt(nearest)
        if over > flat - s[RADIUS]:
            return _upright_row(rows, count, first, height > head[_TOP], over, v, s)
        if flat < 0.0:
            return count
    for i in range(edges):
        pn, pe = nearest_on_edge(p[0], p[1], corners, i)
        count = _flat_row(rows, count, first + i, p[0] - pn, p[1] - pe, s[RADIUS], v, s)
    return count


@njit
def nearest_within(rows: F64, count: int, u: F64) -> tuple[bool, int]:
    """Move u (3,) to the nearest acceleration that keeps every row; whether it was moved, and what moved it most."""
    moved, code, most = False, 0, 0.0
    for _ in range(_ROUNDS_OF_ITERATION):
        change = 0.0
        for i in range(count):
            n = rows[i]
            short = n[BOUND] - (n[0] * u[0] + n[1] * u[1] + n[2] * u[2])
            weight = max(n[WEIGHT] + short, 0.0)
            step = weight - n[WEIGHT]
            if step != 0.0:
                moved = True
                for k in range(3):
                    u[k] += step * n[k]
                n[WEIGHT] = weight
                change = max(change, abs(step))
        if change < 1e-6:
            break
    for i in range(count):
        if rows[i, WEIGHT] > most:
            most, code = rows[i, WEIGHT], int(rows[i, CODE])
    return moved, code
