"""A site: polygon, floor, ceiling, places to keep out of; local metres (north, east) and heights above a place.

What is wrong with one is one line that names the edge.  A site on the globe is laid out flat round the place of arming
(`Site.local`) by the projection of PX4's own local frame (`flightstack.geodesy`), so that a corner lies where PX4 says
that it is; an edge is straight there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from flightstack.geodesy import LocalFrame
from flightstack.types import F64, InputError

MOST_EDGES = 1000
_NO_AREA_M2 = 1e-9
FAR_M = 10_000.0
"""A site farther from the vehicle than this is another site."""


@dataclass(frozen=True, slots=True, eq=False)
class KeepOut:
    """A polygon or a cylinder with floor and ceiling, or a sphere."""

    name: str
    polygon: F64 | None
    """(n, 2) corners; None: round."""
    centre: tuple[float, float] = (0.0, 0.0)
    radius_m: float = 0.0
    floor_m: float = -math.inf
    ceiling_m: float = math.inf
    height_m: float = math.nan
    """Of a sphere's centre; NaN where it is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Everything that a site says.  Coordinates are north and east in metres, or latitude and longitude in degrees."""

    source: str
    is_global: bool
    inside: F64
    """(n, 2) corners."""
    floor_m: float
    ceiling_m: float
    keep_outs: tuple[KeepOut, ...] = ()
    chute_m: float | None = None
    """Radius round the places of take-off and landing within which the floor does not bind; None: what is needed."""

    @property
    def edges(self) -> int:
        """Of all polygons."""
        return len(self.inside) + sum(len(each.polygon) for each in self.keep_outs if each.polygon is not None)

    def local(self, latitude_deg: float, longitude_deg: float) -> Site:
        """The same in metres round a place on the globe; InputError where it lies elsewhere, or is swapped."""
        if not self.is_global:
            return self
        frame = LocalFrame(latitude_deg, longitude_deg, 0.0)
        inside = _metres(frame, self.inside)
        if not (away := _away_m(inside)) < FAR_M:
            swapped = _away_m(_metres(frame, self.inside[:, ::-1])) < FAR_M
            hint = ": latitude and longitude are swapped" if swapped else ""
            raise InputError(
                f"{self.source}: the site lies {away / 1000.0:.0f} km from the vehicle, "
                f"which is at {latitude_deg:.6f}, {longitude_deg:.6f}{hint}"
            )
        moved = tuple(_moved(frame, each) for each in self.keep_outs)
        return checked(replace(self, is_global=False, inside=inside, keep_outs=moved))


def _metres(frame: LocalFrame, corners: F64) -> F64:
    """(n, 2) north and east of (n, 2) degrees."""
    return np.array([frame.to_local(*corner) for corner in corners.tolist()]).reshape(-1, 2)


def _away_m(corners: F64) -> float:
    """How far the origin is from a polygon, (n, 2); 0 within it."""
    following, closer, within = np.roll(corners, -1, axis=0), math.inf, False
    for (an, ae), (bn, be) in zip(corners.tolist(), following.tolist(), strict=True):
        dn, de = bn - an, be - ae
        share = min(max(-(an * dn + ae * de) / max(dn * dn + de * de, 1e-12), 0.0), 1.0)
        closer = min(closer, math.hypot(an + share * dn, ae + share * de))
        if (ae > 0.0) != (be > 0.0) and an - ae * dn / de > 0.0:
            within = not within
    return 0.0 if within else closer


def _moved(frame: LocalFrame, each: KeepOut) -> KeepOut:
    """A keep-out in metres."""
    polygon = None if each.polygon is None else _metres(frame, each.polygon)
    return replace(each, polygon=polygon, centre=frame.to_local(*each.centre))


def checked(site: Site) -> Site:
    """The site itself; InputError, one line, where it is none."""
    if not site.floor_m < site.ceiling_m:
        raise InputError(f"{site.source}: floor_m = {site.floor_m:g} must be below ceiling_m = {site.ceiling_m:g}")
    count = site.edges + sum(each.polygon is None for each in site.keep_outs)  # what is round takes as long as an edge
    if count > MOST_EDGES:
        raise InputError(f"{site.source}: {count} edges in all, at most {MOST_EDGES} are taken: simplify it")
    for name, polygon in _polygons(site):
        _check_polygon(f"{site.source}: {name}", polygon, site.is_global)
    for each in site.keep_outs:
        if not each.floor_m < each.ceiling_m:
            raise InputError(
                f"{site.source}: {each.name}: floor_m = {each.floor_m:g} must be below ceiling_m = {each.ceiling_m:g}"
            )
        if each.polygon is None and site.is_global:
            _check_degrees(f"{site.source}: {each.name}: centre", np.array([each.centre]))
    return site


def _polygons(site: Site) -> Iterator[tuple[str, F64]]:
    yield "inside", site.inside
    for each in site.keep_outs:
        if each.polygon is not None:
            yield f"{each.name}: polygon", each.polygon


def _check_polygon(where: str, corners: F64, is_global: bool) -> None:
    if len(corners) < 3:
        raise InputError(f"{where} is empty: {len(corners)} corners, at least 3 are needed")
    if not np.isfinite(corners).all():
        bad = int(np.flatnonzero(~np.isfinite(corners).all(axis=1))[0])
        raise InputError(f"{where}: corner {bad} is not a number")
    if is_global:
        _check_degrees(where, corners)
        corners = _metres(LocalFrame(float(corners[0, 0]), float(corners[0, 1]), 0.0), corners)
    elif float(np.abs(corners).max()) > 2.0 * FAR_M:
        bad = int(np.abs(corners).max(axis=1).argmax())
        raise InputError(
            f"{where}: corner {bad} is {np.abs(corners).max():.0f} m away, at most {2.0 * FAR_M:g} m count"
        )
    following = np.roll(corners, -1, axis=0)
    short = np.flatnonzero((corners == following).all(axis=1))
    if len(short):
        raise InputError(f"{where}: edge {int(short[0])} has no length: a corner is there twice")
    away = corners - corners[0]
    if float(np.abs(away[:, :1] * away[:, 1:].T - away[:, 1:] * away[:, :1].T).max()) <= _NO_AREA_M2:
        raise InputError(f"{where} is empty: its corners lie on one line")
    crossing = _first_crossing(corners, following)
    if crossing is not None:
        raise InputError(f"{where} crosses itself: edges {crossing[0]} and {crossing[1]} (the first edge is 0)")


def _check_degrees(where: str, places: F64) -> None:
    for i, (latitude, longitude) in enumerate(places.tolist()):
        if max(abs(latitude), abs(longitude)) > 720.0:  # no turn more or less of the globe
            raise InputError(
                f"{where}: corner {i} at {latitude:.0f}, {longitude:.0f} is not in degrees: a map's metres (UTM, Web "
                "Mercator) are not taken, export latitude and longitude of WGS 84"
            )
        if not abs(latitude) <= 90.0:
            raise InputError(
                f"{where}: corner {i} has latitude {latitude:g}, beyond 90: are latitude and longitude swapped?"
            )
        if not abs(longitude) <= 180.0:
            raise InputError(f"{where}: corner {i} has longitude {longitude:g}, which is beyond 180")


def _first_crossing(a: F64, b: F64) -> tuple[int, int] | None:
    """Numbers of the first two edges (a[i], b[i]) that meet elsewhere than where one follows the other."""
    n = len(a)
    for i in range(n - 1):
        others = np.arange(i + 1, n)
        c, d = a[others], b[others]
        first = _side(a[i], b[i], c), _side(a[i], b[i], d)
        second = _side(c, d, a[i]), _side(c, d, b[i])
        crosses = (first[0] * first[1] <= 0.0) & (second[0] * second[1] <= 0.0)
        low, high = np.minimum(a[i], b[i]), np.maximum(a[i], b[i])
        crosses &= ((np.minimum(c, d) <= high) & (np.maximum(c, d) >= low)).all(axis=1)  # on one line: must overlap
        neighbours = (others == i + 1) | ((others + 1) % n == i)
        if n > 3:  # neighbours share a corner; they cross where they run back over each other
            back = np.where(others == i + 1, _turns_back(a[i], b[i], d), _turns_back(b[i], a[i], c))
        else:
            back = np.zeros(len(others), bool)
        found = np.flatnonzero(crosses & np.where(neighbours, back, True))
        if len(found):
            return i, int(others[found[0]])
    return None


def _side(a: F64, b: F64, c: F64) -> F64:
    """On which side of the line a b the point c is: sign of twice the triangle's area."""
    ab, ac = b - a, c - a
    side: F64 = ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]
    return side


def _turns_back(a: F64, b: F64, c: F64) -> F64:
    """Whether the way a b c runs back over itself."""
    ab, bc = b - a, c - b
    back: F64 = (_side(a, b, c) == 0.0) & ((ab * bc).sum(axis=-1) < 0.0)
    return back
