"""The earths that JSBSim flies over: its own, round and turning, and a still ball that leaves the vehicle alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from flightstack.geodesy import PX4_SIH
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_sim.jsbsim.readings import F_DT, F_ORIGIN, F_RADII, F_TURN, FRAME

LATITUDE_RAD: Final = math.radians(PX4_SIH.latitude_deg)
LONGITUDE_RAD: Final = math.radians(PX4_SIH.longitude_deg)
ALTITUDE_M: Final = PX4_SIH.altitude_m
"""Where flights begin."""
_SEMI_MAJOR_M: Final = 6_378_137.0
_FLATTENING: Final = 1.0 / 298.257223563
_GM_M3PS2: Final = 3.986004418e14
_J2: Final = 1.08262982e-3
_TURN_RADPS: Final = 7.292115e-5
_BALL_M: Final = 6_371_000.0


def effective_gravity_mps2() -> float:
    """Gravity and the turning earth's pull together, as a hovering vehicle feels it where flights begin.

    JSBSim's field: a point mass and the oblateness J2 (Stevens and Lewis, Aircraft Control and Simulation, section
    1.4), with the constants of WGS 84.  It lies 4e-6 over normal gravity, which knows the higher terms as well.
    """
    squared = _FLATTENING * (2.0 - _FLATTENING)
    sin, cos = math.sin(LATITUDE_RAD), math.cos(LATITUDE_RAD)
    across = _SEMI_MAJOR_M / math.sqrt(1.0 - squared * sin * sin)
    x, z = (across + ALTITUDE_M) * cos, (across * (1.0 - squared) + ALTITUDE_M) * sin
    radius = math.hypot(x, z)
    oblate, polar = 1.5 * _J2 * (_SEMI_MAJOR_M / radius) ** 2, 5.0 * (z / radius) ** 2
    pull = _GM_M3PS2 / radius**3
    inwards = pull * x * (1.0 + oblate * (1.0 - polar)) - _TURN_RADPS**2 * x
    return math.hypot(inwards, pull * z * (1.0 + oblate * (3.0 - polar)))


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


TURNING: Final = Earth(effective_gravity_mps2(), _SEMI_MAJOR_M, _FLATTENING)
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
