"""The sampler's columns (`learning.sampler`) of what is asked for: speeds, thrust vectors, nearness to the ground.

With F the length of a thrust vector f (believed newton per believed kilogram, NED, thrust is -f) and b = f / F,

    x = (R(b)' velocity, b_n, b_e, F / g, (F / g) near),   near = (R / 4 height)^2, height at least R / 2

R(b): the shortest turn of down onto b, tilt axes to NED.
"""

from __future__ import annotations

import numpy as np

from flightstack.learning.sampler import AXIS_E, AXIS_N, GROUND, THRUST, D
from flightstack.types import F64, STANDARD_GRAVITY_MPS2


def inputs(speed: F64, thrust: F64, near: F64) -> F64:
    """(M, D) the sampler's columns."""
    size = np.sqrt(np.einsum("ij,ij->i", thrust, thrust))
    weights = size / STANDARD_GRAVITY_MPS2
    out = np.empty((len(thrust), D))
    out[:, 3:5] = thrust[:, :2] / size[:, None]
    out[:, :3] = np.einsum("mji,mj->mi", turns(out[:, AXIS_N], out[:, AXIS_E]), speed)
    out[:, THRUST], out[:, GROUND] = weights, weights * near
    return out


def turns(axis_n: F64, axis_e: F64) -> F64:
    """(M, 3, 3) tilt axes to NED of each thrust axis: `tilt.tilt_axes` for many."""
    down = np.sqrt(np.maximum(1.0 - axis_n**2 - axis_e**2, 0.0))
    share = 1.0 / (1.0 + down)
    cross = -share * axis_n * axis_e
    rows = [
        [1.0 - share * axis_n**2, cross, axis_n],
        [cross, 1.0 - share * axis_e**2, axis_e],
        [-axis_n, -axis_e, down],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def proximity(radius_m: float, height_m: float) -> float:
    """(R / 4h)^2 with h at least R / 2: the ground term's share of thrust."""
    share = 0.25 * radius_m / max(height_m, 0.5 * radius_m)
    return share * share
