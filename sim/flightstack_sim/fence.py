"""The geofence that clients store: polygons and circles to stay inside of and outside of.

A place is allowed that lies inside any of the inclusions (where there are some) and outside of all exclusions.  A
polygon is judged by the even-odd rule in latitude and longitude, as PX4 does: one that crosses itself has holes.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from flightstack.geodesy import LocalFrame
from flightstack.types import Tuple3
from flightstack_sim.autopilot import notices
from flightstack_sim.autopilot.notices import Notice
from flightstack_sim.autopilot.params import Params
from flightstack_sim.plans import CIRCLES, FENCE, POLYGONS, Item, ItemCmd, Plans, corners

_INSIDE: Final = (ItemCmd.POLYGON_INSIDE, ItemCmd.CIRCLE_INSIDE)


class Shape(NamedTuple):
    """A polygon, or with one corner a circle."""

    inside: bool
    """Whether to stay inside of it."""
    corners_deg: tuple[tuple[float, float], ...]
    """Latitude and longitude."""
    radius_m: float = math.nan

    def contains(self, lat_deg: float, lon_deg: float) -> bool:
        """Whether a place lies in it."""
        if len(self.corners_deg) == 1:
            place = LocalFrame(*self.corners_deg[0], 0.0).to_local(lat_deg, lon_deg)
            return math.hypot(*place) < self.radius_m  # never for a radius that is none
        within = False
        before_lat, before_lon = self.corners_deg[-1]
        for lat, lon in self.corners_deg:
            if (lon >= lon_deg) != (before_lon >= lon_deg):
                if lat_deg <= lat + (before_lat - lat) * (lon_deg - lon) / (before_lon - lon):
                    within = not within
            before_lat, before_lon = lat, lon
        return within

    def allows(self, lat_deg: float, lon_deg: float) -> bool:
        """Whether this shape alone allows a place."""
        return self.contains(lat_deg, lon_deg) is self.inside


def shapes_of(items: tuple[Item, ...]) -> tuple[Shape, ...]:
    """The shapes of a stored fence; what stands after a polygon that lacks corners is lost."""
    shapes, at = [], 0
    while at < len(items):
        item = items[at]
        if item.command in CIRCLES:
            shapes.append(Shape(item.command in _INSIDE, ((item.x, item.y),), item.params[0]))
        elif item.command in POLYGONS:
            count = corners(item)
            ring = items[at : at + count]
            if len(ring) < count or any((one.command, corners(one)) != (item.command, count) for one in ring):
                break
            shapes.append(Shape(item.command in _INSIDE, tuple((one.x, one.y) for one in ring)))
            at += count - 1
        at += 1
    return tuple(shapes)


def allowed(shapes: tuple[Shape, ...], lat_deg: float, lon_deg: float) -> bool:
    """Whether the fence allows a place."""
    inclusions = [shape for shape in shapes if shape.inside]
    if inclusions and not any(shape.contains(lat_deg, lon_deg) for shape in inclusions):
        return False
    return not any(shape.contains(lat_deg, lon_deg) for shape in shapes if not shape.inside)


class FenceWatch:
    """Looks after the stored fence: which of its shapes count, and whether a place lies outside.

    As PX4 does, a shape that a client stores counts only where it allows home, and in the air the vehicle's place.
    """

    __slots__ = ("_frame", "_params", "_plans", "_version", "shapes")

    def __init__(self, plans: Plans, params: Params, frame: LocalFrame) -> None:
        self._plans, self._params, self._frame = plans, params, frame
        self._version = 0
        self.shapes: tuple[Shape, ...] = ()

    def renew(self, pos_ned_m: Tuple3, home_ned_m: Tuple3 | None, *, landed: bool) -> tuple[Notice, ...]:
        """Take over what a client has stored since; what is to be said about it."""
        if self._version == self._plans.version[FENCE]:
            return ()
        self._version = self._plans.version[FENCE]
        shapes = shapes_of(self._plans.fence)
        said = []
        if self._acts:
            if home_ned_m is not None:
                home = self._frame.to_globe(*home_ned_m[:2])
                kept = tuple(shape for shape in shapes if shape.allows(*home))
                if len(kept) < len(shapes):
                    said.append(notices.FENCE_WITHOUT_HOME)
                shapes = kept
            if not landed:
                here = self._frame.to_globe(*pos_ned_m[:2])
                kept = tuple(shape for shape in shapes if shape.allows(*here))
                if len(kept) < len(shapes):
                    said.append(notices.FENCE_WITHOUT_VEHICLE)
                shapes = kept
        self.shapes = shapes
        return tuple(said)

    @property
    def _acts(self) -> bool:
        return self._params.get("GF_ACTION") != 0.0

    def outside(self, north_m: float, east_m: float) -> bool:
        """Whether a place, local metres, lies outside."""
        return bool(self.shapes) and not allowed(self.shapes, *self._frame.to_globe(north_m, east_m))

    def forbids(self, north_m: float, east_m: float) -> bool:
        """Whether going there is refused."""
        return self._acts and math.isfinite(north_m + east_m) and self.outside(north_m, east_m)
