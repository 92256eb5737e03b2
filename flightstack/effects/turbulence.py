"""Turbulence: Dryden gusts, with one sigma and one length for all three axes.

With s = sqrt(time) noise n, tau = length / V, V the airspeed (at least 1 m/s):
    along the mean wind   tau z' = -z + n                      u = sigma z
    across and vertical   (1 + sqrt(3) tau s) / (1 + tau s)^2  as two equal lags in a row:
                          tau z1' = -z1 + n,  tau z2' = -z2 + z1,  v = sigma (sqrt(3) z1 + (1 - sqrt(3)) z2) / sqrt(2)
whose autocorrelations are exp(-t/tau) and (1 - t / 2 tau) exp(-t/tau).  z is scaled to unit variance and stepped
exactly (transition matrix and noise covariance in closed form), so no step is too long and none too short.
"""

from __future__ import annotations

import math

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import P_DT, S_GUST, S_NORMALS, S_VEL, Vec, place
from flightstack.effects.steady_wind import velocity
from flightstack.jit import njit
from flightstack.types import F64

SIGMA = place("turbulence", "sigma_mps")
LENGTH = place("turbulence", "length_m")
NORMALS = 5
"""Standard normals that one step takes."""
_LEAST_AIRSPEED_MPS = 1.0
_SQRT3 = math.sqrt(3.0)
_SQRT_HALF = math.sqrt(0.5)
_SERIES_BELOW = 0.01


@njit
def _noise_factors(s: float) -> Vec:
    """Cholesky factor (l11, l21, l22) of the noise that two equal lags of unit input variance gather over s = dt/tau.

    Its covariance is 2 int_0^s exp(-2x) [[1, x], [x, x^2]] dx; for small s the closed form cancels, so its series.
    """
    c11 = -math.expm1(-2.0 * s)
    if s < _SERIES_BELOW:
        c12 = s * s * (1.0 - s * (4.0 / 3.0 - s * (1.0 - s * (8.0 / 15.0 - s * 2.0 / 9.0))))
        c22 = s * s * s * (2.0 / 3.0 - s * (1.0 - s * (4.0 / 5.0 - s * (4.0 / 9.0 - s * 4.0 / 21.0))))
    else:
        decay = math.exp(-2.0 * s)
        c12 = 0.5 - decay * (s + 0.5)
        c22 = 0.5 - decay * (s * s + s + 0.5)
    l11 = math.sqrt(c11)
    l21 = c12 / l11
    return (l11, l21, math.sqrt(max(c22 - l21 * l21, 0.0)))


@njit
def start(row: F64) -> None:
    """Draw the filters' states from their stationary distribution: the gusts blew before the flight began."""
    row[S_GUST] = row[S_NORMALS]
    for at in (1, 3):
        z1 = row[S_NORMALS + at]
        row[S_GUST + at] = z1
        row[S_GUST + at + 1] = 0.5 * z1 + 0.5 * row[S_NORMALS + at + 1]


@njit
def advance(p: F64, row: F64) -> None:
    """Step the filters by one dt with the row's fresh standard normals."""
    if p[SIGMA] == 0.0:
        return
    wind = velocity(p)
    north, east, down = row[S_VEL] - wind[0], row[S_VEL + 1] - wind[1], row[S_VEL + 2] - wind[2]
    airspeed = max(math.sqrt(north * north + east * east + down * down), _LEAST_AIRSPEED_MPS)
    s = p[P_DT] * airspeed / p[LENGTH]
    decay = math.exp(-s)
    l11, l21, l22 = _noise_factors(s)
    row[S_GUST] = decay * row[S_GUST] + l11 * row[S_NORMALS]
    for at in (1, 3):
        n1, n2 = row[S_NORMALS + at], row[S_NORMALS + at + 1]
        z1, z2 = row[S_GUST + at], row[S_GUST + at + 1]
        row[S_GUST + at] = decay * z1 + l11 * n1
        row[S_GUST + at + 1] = decay * (s * z1 + z2) + l21 * n1 + l22 * n2


@njit
def gust(p: F64, row: F64) -> Vec:
    """The gust (m/s, NED) of the filters' present states."""
    sigma = p[SIGMA]
    if sigma == 0.0:
        return (0.0, 0.0, 0.0)
    along = sigma * row[S_GUST]
    across = sigma * _SQRT_HALF * (_SQRT3 * row[S_GUST + 1] + (1.0 - _SQRT3) * row[S_GUST + 2])
    vertical = sigma * _SQRT_HALF * (_SQRT3 * row[S_GUST + 3] + (1.0 - _SQRT3) * row[S_GUST + 4])
    wind = velocity(p)
    speed = math.sqrt(wind[0] * wind[0] + wind[1] * wind[1])
    cos, sin = 1.0, 0.0
    if speed > 0.0:
        cos, sin = wind[0] / speed, wind[1] / speed
    return (cos * along - sin * across, sin * along + cos * across, vertical)


EFFECT = Effect(
    name="turbulence",
    params=(
        ParamSpec("sigma_mps", "m/s", 0.0, 0.0, 20.0),
        ParamSpec("length_m", "m", None, 0.1, 10000.0, required=True),
    ),
    kind="air",
    place="own",
    physics=gust,
    equation="Dryden gusts on top of the steady wind",
    source="MIL-F-8785C, 3.7: Dryden spectra, one sigma and length for all axes",
    words="turbulence",
    scale=lambda size: {"sigma_mps": 0.5, "length_m": 5.0},
    needs=("vel_ned_mps", "q_ned_frd"),
    manoeuvre="a minute of hover in it, by a vehicle whose drag is known",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"sigma_mps": 1.5, "length_m": 20.0},
)
