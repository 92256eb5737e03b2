"""The earths that JSBSim flies over: its own, round and turning, and a still ball on which only the vehicle is tested."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from sim.geodesy import PX4_SIH
from sim.jsbsim.readings import F_DT, F_ORIGIN, F_RADII, F_TURN, FRAME

LATITUDE_RAD: Final = math.radians(PX4_SIH.latitude_deg)
LONGITUDE_RAD: Final = math.radians(PX4_SIH.longitude_deg)
ALTITUDE_M: Final = PX4_SIH.altitude_m
"""Where flights begin."""
_SEMI_MAJOR_M: Final = 6_378_137.0
_FLATTENING: Final = 1.0 / 298.257223563
_BALL_M: Final = 6_371_000.0


def effective_gravity_mps2(latitude_rad: float, altitude_m: float) -> float:
    """Gravity and the turning earth's pull together, as a hovering vehicle feels it.

    Normal gravity of WGS 84: Somigliana's formula and its series in height (NIMA TR8350.2, equations 4-1 and 4-3).
    """
    a, f, m = _SEMI_MAJOR_M, _FLATTENING, 0.00344978650684
    sin2 = math.sin(latitude_rad) ** 2
    ground = 9.7803253359 * (1.0 + 0.00193185265241 * sin2) / math.sqrt(1.0 - 0.00669437999014 * sin2)
    return ground * (1.0 - 2.0 / a * (1.0 + f + m - 2.0 * f * sin2) * altitude_m + 3.0 * (altitude_m / a) ** 2)


@dataclass(frozen=True, slots=True)
class Earth:
    """What lies under a flight."""

    gravity_mps2: float
    """As a hovering vehicle feels it where flights begin."""
    semi_major_m: float
    flattening: float
    planet: str = ""
    """JSBSim's planet file; empty: its own earth, WGS 84, turning."""

    def frame(self, origin_ecef_ft: F64, dt_s: float) -> F64:
        """The readings' frame row (FRAME,) for an origin where flights begin; the force's scale is left at 0."""
        row = np.zeros(FRAME)
        sin_lat, cos_lat = math.sin(LATITUDE_RAD), math.cos(LATITUDE_RAD)
        sin_lon, cos_lon = math.sin(LONGITUDE_RAD), math.cos(LONGITUDE_RAD)
        row[F_ORIGIN : F_ORIGIN + 3] = origin_ecef_ft
        row[F_TURN : F_TURN + 9] = (
            -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat,
            -sin_lon, cos_lon, 0.0,
            -cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat,
        )  # fmt: skip
        squared = self.flattening * (2.0 - self.flattening)
        w = 1.0 - squared * sin_lat**2
        row[F_RADII] = self.semi_major_m * (1.0 - squared) / w**1.5 + ALTITUDE_M
        row[F_RADII + 1] = self.semi_major_m / math.sqrt(w) + ALTITUDE_M
        row[F_DT] = dt_s
        return row


TURNING: Final = Earth(effective_gravity_mps2(LATITUDE_RAD, ALTITUDE_M), _SEMI_MAJOR_M, _FLATTENING)
STILL: Final = Earth(
    STANDARD_GRAVITY_MPS2,
    _BALL_M,
    0.0,
    '<?xml version="1.0"?>\n<planet name="still">'
    f'<semimajor_axis unit="M">{_BALL_M!r}</semimajor_axis><semiminor_axis unit="M">{_BALL_M!r}</semiminor_axis>'
    '<rotation_rate unit="RAD/SEC">0</rotation_rate>'
    f'<GM unit="M3/SEC2">{STANDARD_GRAVITY_MPS2 * (_BALL_M + ALTITUDE_M) ** 2!r}</GM><J2>0</J2></planet>\n',
)
"""A ball at rest with the native plant's gravity: what is left between the plants on it is the vehicle's physics."""
