"""What physics allows of the published barrier: the least mu that any controller could certify.

    h_mu = 1 - sum_i (e_i^2 / a_i^2 + v_i^2 / b_i^2),    b_down^2 = 1 / mu

With attitude taken as instant, t = T z_b / m (thrust pushes by -t) may be any vector of length at most R in a cone of
`tilt_max_rad` round down.  On h = 0 near rest the velocity's direction is free, so that one needs, for every e in the
ellipsoid, t = g + wind + (b_i^2 e_i / a_i^2): the ellipsoid E of required accelerations, semi-axes b_i^2 / a_i, moved
to (wind_n, wind_e, g + wind_d), must lie in that set.  Faster states on the boundary have smaller e, inner ones gamma h
besides: this is the whole condition, for every gamma.

In the cone: the support function of E against the cone's normals, in closed form.  In the ball: the farthest point of
an ellipsoid, by its dual with one variable (strong by the S-lemma: S. Boyd, L. Vandenberghe, Convex Optimization,
2004, appendix B.1).  A doubt that may point anywhere in a box moves the ellipsoid's centre to each corner.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import brentq

from flightstack.region import Region
from flightstack.types import F64, InputError, Tuple3


@dataclass(frozen=True, slots=True)
class PhysicalPlant:
    """What flies, seen from what is believed of it."""

    mass_ratio: float = 1.0
    """True over believed mass."""
    wind_g: Tuple3 = (0.0, 0.0, 0.0)
    """Constant acceleration north, east, down besides gravity and thrust, in g."""
    thrust_max_weights: float = 1.8
    """In believed weights."""
    tilt_max_rad: float = 0.5 * math.pi
    gravity_mps2: float = 9.81

    def __post_init__(self) -> None:
        numbers = (*self.wind_g, self.mass_ratio, self.thrust_max_weights, self.gravity_mps2)
        if not (all(map(math.isfinite, numbers)) and min(numbers[3:]) > 0.0 < self.tilt_max_rad <= 0.5 * math.pi):
            raise InputError("plant: mass ratio, thrust, gravity and tilt must be above 0, tilt at most 90 degrees")

    @property
    def thrust_max_mps2(self) -> float:
        """R: greatest true acceleration by thrust."""
        return self.thrust_max_weights * self.gravity_mps2 / self.mass_ratio


def mu_physics(
    plant: PhysicalPlant, region: Region, doubt_mps2: Tuple3 = (0.0, 0.0, 0.0), *, lateral: bool = True
) -> float:
    """The least mu (s^2/m^2) that `plant` allows on the region's ellipsoid; inf where there is none.

    `doubt_mps2` is taken from the acceleration along each axis: k sigma, or any margin.  Not `lateral`: flight along
    the vertical line only, where wind must still be balanced by tilt.  The region's own vertical speed does not matter.
    """
    side = _side(region) if lateral else 0.0
    gravity = plant.gravity_mps2
    room = math.inf
    for signs in product((-1.0, 1.0), repeat=3):
        wind = [w * gravity + s * d for w, s, d in zip(plant.wind_g, signs, doubt_mps2, strict=True)]
        centre = np.array([wind[0], wind[1], gravity + wind[2]])
        room = min(room, _ball_room(centre, side, plant.thrust_max_mps2), _cone_room(centre, side, plant.tilt_max_rad))
    return 1.0 / (region.semi_axes_m[2] * room) if room > 0.0 else math.inf


def state_only(plant: PhysicalPlant) -> PhysicalPlant:
    """What learning the residual as a function of the state alone, from hover, makes of a plant.

    In hover thrust balances gravity and wind, so the residual is (ratio - 1) g + ratio wind there; taken to hold at
    every thrust, it claims the believed mass and that much wind.
    """
    north, east, down = (plant.mass_ratio * each for each in plant.wind_g)
    return replace(plant, mass_ratio=1.0, wind_g=(north, east, down + plant.mass_ratio - 1.0))


def overshoot_m(mu: float, limit_m: float, braking_mps2: float) -> float:
    """How far beyond |e| = limit the worst state of h_mu >= 0 goes while braking at `braking_mps2`; 0: stays inside.

    The way of a state on the boundary is e + v^2 / (2 a), v^2 = (1 - e^2 / limit^2) / mu.
    """
    way = 1.0 / (2.0 * mu * braking_mps2)
    e = min(limit_m * limit_m / (2.0 * way), limit_m)
    return e + (1.0 - (e / limit_m) ** 2) * way - limit_m


def farthest(shape: F64, centre: F64) -> float:
    """max |shape u + centre| over |u| <= 1: shape (n, n), centre (n,).  Rounding aside, never too small.

    Dual: min over l >= s_1^2 of l + sum_i c_i^2 l / (l - s_i^2), s the singular values, c the centre in their axes.
    """
    axes, size, _ = np.linalg.svd(shape)
    along = axes.T @ centre
    square = size * size
    top, length = float(square[0]), float(np.linalg.norm(centre))
    if size[0] <= max(1e-14 * length, 1e-60):
        return length + float(size[0])

    def slope(level: float) -> float:
        return float(1.0 - np.sum(along**2 * square / (level - square) ** 2))

    least, most = top * (1.0 + 1e-12), (top + float(size[0]) * length) * (1.0 + 1e-9)
    level = least if slope(least) >= 0.0 else float(brentq(slope, least, most, xtol=1e-15, rtol=1e-14))
    return math.sqrt(level + float(np.sum(along**2 * level / (level - square))))


def _side(region: Region) -> float:
    """Sideways semi-axis b^2 / a of the required accelerations, m/s^2."""
    north, east = (region.semi_axes_mps[i] ** 2 / region.semi_axes_m[i] for i in (0, 1))
    if not math.isclose(north, east):
        raise InputError("region: north and east must have equal semi-axes for the published barrier")
    return north


def _ball_room(centre: F64, side: float, radius: float) -> float:
    """Greatest vertical semi-axis with which the ellipsoid stays in the ball of thrust; 0 or less: none."""

    def beyond(vertical: float) -> float:
        return farthest(np.diag([side, side, vertical]), centre) - radius

    if beyond(0.0) >= 0.0:
        return 0.0
    return float(brentq(beyond, 0.0, radius, xtol=1e-13))


def _cone_room(centre: F64, side: float, tilt_rad: float) -> float:
    """The same for the cone of tilt."""
    cot = math.cos(tilt_rad) / math.sin(tilt_rad)
    height = float(centre[2]) - math.hypot(centre[0], centre[1]) * cot
    if height <= side * cot:
        return 0.0
    return math.sqrt(height * height - (side * cot) ** 2)
