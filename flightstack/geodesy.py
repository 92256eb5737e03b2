"""Local north-east metres to latitude and longitude and back.

Azimuthal equidistant projection on a sphere, the one that PX4's estimator uses for its local frame: distance and
bearing from the reference are kept exactly.  Closed form both ways (Snyder, Map Projections, USGS PP 1395, section 25).
"""

from __future__ import annotations

import math
from typing import Final

EARTH_RADIUS_M: Final = 6_371_000.0
_TINY: Final = 1e-12


class LocalFrame:
    """A local NED frame tied to the globe at its origin."""

    __slots__ = ("_cos_lat", "_sin_lat", "altitude_m", "latitude_deg", "longitude_deg")

    def __init__(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        self.latitude_deg = latitude_deg
        self.longitude_deg = longitude_deg
        self.altitude_m = altitude_m
        self._sin_lat = math.sin(math.radians(latitude_deg))
        self._cos_lat = math.cos(math.radians(latitude_deg))

    def to_globe(self, north_m: float, east_m: float) -> tuple[float, float]:
        """(latitude, longitude) in degrees of a local point."""
        angle = math.hypot(north_m, east_m) / EARTH_RADIUS_M
        if angle < _TINY:
            return self.latitude_deg, self.longitude_deg
        x, y = north_m / EARTH_RADIUS_M, east_m / EARTH_RADIUS_M
        sin_c, cos_c = math.sin(angle), math.cos(angle)
        latitude = math.asin(max(-1.0, min(1.0, cos_c * self._sin_lat + x * sin_c * self._cos_lat / angle)))
        turn = math.atan2(y * sin_c, angle * self._cos_lat * cos_c - x * self._sin_lat * sin_c)
        return math.degrees(latitude), self.longitude_deg + math.degrees(turn)

    def to_local(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """(north, east) in metres of a point on the globe."""
        latitude = math.radians(latitude_deg)
        turn = math.radians(longitude_deg - self.longitude_deg)
        sin_lat, cos_lat, cos_turn = math.sin(latitude), math.cos(latitude), math.cos(turn)
        x = self._cos_lat * sin_lat - self._sin_lat * cos_lat * cos_turn
        y = cos_lat * math.sin(turn)
        sin_c = math.hypot(x, y)
        cos_c = self._sin_lat * sin_lat + self._cos_lat * cos_lat * cos_turn
        scale = EARTH_RADIUS_M * (math.atan2(sin_c, cos_c) / sin_c if sin_c > _TINY else 1.0)
        return scale * x, scale * y


PX4_SIH: Final = LocalFrame(47.397742, 8.545594, 489.4)
"""Where PX4's internal simulator puts its vehicle."""
