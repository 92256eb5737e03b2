"""How far a way is from everything that a site forbids; compiled, for a way of any number of discs.

A way is a row of discs: place (north, east), height, radius across, half height.  A disc is clear by the distance from
its rim to what is forbidden; a solid is met only where both rim and heights overlap.  The floor does not bind within
the chutes.  All numbers of a site lie in one array (`packed`), so that compiled code is entered with one.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit, njit_called
from flightstack.rows import WAY_HALF
from flightstack.site.shape import Site
from flightstack.types import F64

FLOOR, CEILING, CHUTE, POLYGONS, ROUNDS, CHUTES, OPEN, GROUND, HEAD = range(9)
"""Places in a packed site: floor, ceiling, radius of the chutes as it counts now (-1: shut), how many polygons, round
solids and chutes, radius of the chutes when they are open, 1 while the ground under them slows a fall (in the air, the
chutes not left yet); then the chutes (2 each), the round solids (6 each: north, east, height of a sphere or NaN,
radius, floor, ceiling), and the polygons (each: corners, floor, ceiling, inside-out, then 2 a corner).  The first
polygon is the one to stay in."""
_ROUND, _POLYGON = 6, 4
_NORTH, _EAST, _TALL, _WIDE, _LOW, _HIGH = range(_ROUND)
_BOTTOM, _TOP, _STAY = range(1, _POLYGON)
FAR = 1e9
FLOOR_CODE, CEILING_CODE, TILT_CODE, JUMP_CODE, ROUND_CODE = -1, -2, -4, -5, 1_000_000
"""What is nearest: an edge by its number over all polygons, floor, ceiling, or a round solid from ROUND_CODE on; or
that the command tilts further than any way out may begin with, or that a reference jumps."""


def packed(site: Site, chutes: F64, chute_m: float) -> F64:
    """A site in local metres as one array; `chutes` (n, 2): places of take-off and landing."""
    rounds = [each for each in site.keep_outs if each.polygon is None]
    polygons = [(site.inside, -math.inf, math.inf, 1.0)]
    polygons += [
        (each.polygon, each.floor_m, each.ceiling_m, 0.0) for each in site.keep_outs if each.polygon is not None
    ]
    parts: list[object] = [
        [site.floor_m, site.ceiling_m, chute_m, len(polygons), len(rounds), len(chutes), chute_m, 0.0],
        chutes.ravel(),
    ]
    for each in rounds:
        parts.append([*each.centre, each.height_m, each.radius_m, each.floor_m, each.ceiling_m])
    for corners, low, high, inside in polygons:
        parts.append([len(corners), low, high, inside])
        parts.append(corners.ravel())
    return np.concatenate([np.asarray(part, dtype=np.float64) for part in parts])


def edge_name(site: Site, code: int) -> str:
    """What a code means, in words."""
    if code == FLOOR_CODE:
        return "floor"
    if code == CEILING_CODE:
        return "ceiling"
    if code in (TILT_CODE, JUMP_CODE):
        return "tilt" if code == TILT_CODE else "jump of the reference"
    rounds = [each for each in site.keep_outs if each.polygon is None]
    if code >= ROUND_CODE:
        return rounds[code - ROUND_CODE].name
    if code < len(site.inside):
        return f"edge {code}"
    code -= len(site.inside)
    for each in site.keep_outs:
        if each.polygon is not None:
            if code < len(each.polygon):
                return f"{each.name}: edge {code}"
            code -= len(each.polygon)
    return "nowhere"


@njit
def nearest_on_edge(n: float, e: float, corners: F64, i: int) -> tuple[float, float]:
    """The point of edge i nearest to a place; corners flat, 2 each."""
    k = (i + 1) % (len(corners) // 2)
    an, ae = corners[2 * i], corners[2 * i + 1]
    dn, de = corners[2 * k] - an, corners[2 * k + 1] - ae
    share = min(max(((n - an) * dn + (e - ae) * de) / (dn * dn + de * de), 0.0), 1.0)
    return an + share * dn, ae + share * de


@njit
def is_within(n: float, e: float, corners: F64) -> bool:
    """Whether a place is inside a polygon (even-odd rule)."""
    count, inside = len(corners) // 2, False
    k = count - 1
    for i in range(count):
        ie, ke = corners[2 * i + 1], corners[2 * k + 1]
        if (ie > e) != (ke > e):
            if n < (corners[2 * k] - corners[2 * i]) * (e - ie) / (ke - ie) + corners[2 * i]:
                inside = not inside
        k = i
    return inside


@njit
def in_chute(site: F64, n: float, e: float, radius: float) -> bool:
    """Whether a disc lies within a chute."""
    for i in range(int(site[CHUTES])):
        dn, de = n - site[HEAD + 2 * i], e - site[HEAD + 2 * i + 1]
        room = site[CHUTE] - radius
        if room >= 0.0 and dn * dn + de * de <= room * room:
            return True
    return False


@njit_called
def clear_of(site: F64, way: F64, count: int, most: float) -> tuple[float, int]:
    """The least clearance of the first `count` discs of a way (n, 5), and what it is from; at most `most`.

    Negative: forbidden, by at least so much of the rim.  It ends at the first disc that is not clear.
    """
    least, nearest = most, FLOOR_CODE
    low_n = low_e = np.inf
    high_n = high_e = -np.inf
    for k in range(count):
        n, e, height, across, half = way[k]
        low_n, high_n = min(low_n, n - across), max(high_n, n + across)
        low_e, high_e = min(low_e, e - across), max(high_e, e + across)
        top = site[CEILING] - height - half
        if top < least:
            least, nearest = top, CEILING_CODE
        bottom = height - half - site[FLOOR]
        if bottom < least and not in_chute(site, n, e, across):
            least, nearest = bottom, FLOOR_CODE
        if least < 0.0:
            return least, nearest
    at = HEAD + 2 * int(site[CHUTES])
    for i in range(int(site[ROUNDS])):
        least, nearest = _clear_of_round(site[at : at + _ROUND], way, count, least, nearest, ROUND_CODE + i)
        if least < 0.0:
            return least, nearest
        at += _ROUND
    first = 0
    for _ in range(int(site[POLYGONS])):
        corners = int(site[at])
        flat = site[at + _POLYGON : at + _POLYGON + 2 * corners]
        least, nearest = _clear_of_polygon(
            site[at : at + _POLYGON], flat, way, count, least, nearest, first, (low_n, low_e, high_n, high_e)
        )
        if least < 0.0:
            return least, nearest
        at += _POLYGON + 2 * corners
        first += corners
    return least, nearest


@njit
def _clear_of_round(solid: F64, way: F64, count: int, least: float, nearest: int, code: int) -> tuple[float, int]:
    for k in range(count):
        n, e, height, across, half = way[k]
        flat = max(math.sqrt((n - solid[_NORTH]) ** 2 + (e - solid[_EAST]) ** 2) - across, 0.0)
        if math.isnan(solid[_TALL]):
            over = max(solid[_LOW] - height - half, height - half - solid[_HIGH])
            gap = max(flat - solid[_WIDE], over)
            if flat - solid[_WIDE] > 0.0 and over > 0.0:
                gap = math.sqrt((flat - solid[_WIDE]) ** 2 + over * over)
        else:
            tall = max(abs(height - solid[_TALL]) - half, 0.0)
            gap = math.sqrt(flat * flat + tall * tall) - solid[_WIDE]
        if gap < least:
            least, nearest = gap, code
            if least < 0.0:
                break
    return least, nearest


@njit
def _clear_of_polygon(
    head: F64, corners: F64, way: F64, count: int, least: float, nearest: int, first: int,
    box: tuple[float, float, float, float],
) -> tuple[float, int]:  # fmt: skip
    """Of one polygon: to stay in, where its head says so, else to keep out of within its heights."""
    stay = head[_STAY] > 0.0
    if stay and not is_within(way[0, 0], way[0, 1], corners):
        return -FAR, first
    edges, (from_n, from_e, far_n, far_e) = len(corners) // 2, box
    if not stay:  # far away: none of it counts
        low_n = low_e = np.inf
        high_n = high_e = -np.inf
        for i in range(edges):
            low_n, high_n = min(low_n, corners[2 * i]), max(high_n, corners[2 * i])
            low_e, high_e = min(low_e, corners[2 * i + 1]), max(high_e, corners[2 * i + 1])
        apart = max(max(low_n - far_n, from_n - high_n), max(low_e - far_e, from_e - high_e))
        if apart > least:
            return least, nearest
    middle_n, middle_e = 0.5 * (from_n + far_n), 0.5 * (from_e + far_e)
    reach = math.sqrt((far_n - middle_n) ** 2 + (far_e - middle_e) ** 2)
    for i in range(edges):
        pn, pe = nearest_on_edge(middle_n, middle_e, corners, i)
        apart = math.sqrt((pn - middle_n) ** 2 + (pe - middle_e) ** 2) - reach
        if apart > least:
            continue
        for k in range(count):
            n, e, height, across, half = way[k]
            over = max(head[_BOTTOM] - height - half, height - half - head[_TOP])
            pn, pe = nearest_on_edge(n, e, corners, i)
            flat = math.sqrt((n - pn) ** 2 + (e - pe) ** 2) - across
            gap = max(flat, over)
            if gap < least:
                least, nearest = gap, first + i
                if least < 0.0:
                    return least, nearest
    if not stay:
        for k in range(count):
            over = max(head[_BOTTOM] - way[k, 2] - way[k, WAY_HALF], way[k, 2] - way[k, WAY_HALF] - head[_TOP])
            if over < least and is_within(way[k, 0], way[k, 1], corners):
                return over, first
    return least, nearest
