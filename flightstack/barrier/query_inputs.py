"""The sampler's columns (`learning.sampler`) of what is asked for: speeds, thrust vectors, nearness to the ground.

With F the length of a thrust vector f (believed newton per believed kilogram, NED, thrust is -f) and b = f / F,

    x = (R(b)' velocity, b_n, b_e, F / g, (F / g) near),   near = (R / 4 height)^2, height at least R / 2

R(b): the shortest turn of down onto b, tilt axes to NED.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit_called
from flightstack.learning.sampler import AXIS_E, AXIS_N, GROUND, THRUST, D
from flightstack.types import F64, STANDARD_GRAVITY_MPS2


@njit_called
def along(axis: int, speed: F64, thrust: F64, near: F64, drag_per_s: F64) -> tuple[F64, F64, F64]:
    """(M, D) the sampler's columns; (M, 3) the shares of tilt axes in an axis; (M,) thrust and drag along it, m/s^2."""
    x, rows, mean = np.empty((len(thrust), D)), np.empty((len(thrust), 3)), np.empty(len(thrust))
    for m in range(len(thrust)):
        size = math.sqrt(thrust[m, 0] ** 2 + thrust[m, 1] ** 2 + thrust[m, 2] ** 2)
        b_n, b_e = thrust[m, 0] / size, thrust[m, 1] / size
        down = math.sqrt(max(1.0 - b_n * b_n - b_e * b_e, 0.0))
        share = 1.0 / (1.0 + down)
        cross = -share * b_n * b_e
        turn = (
            (1.0 - share * b_n * b_n, cross, b_n), (cross, 1.0 - share * b_e * b_e, b_e), (-b_n, -b_e, down)
        )  # fmt: skip
        mean[m] = -thrust[m, axis]
        for k in range(3):
            x[m, k] = turn[0][k] * speed[m, 0] + turn[1][k] * speed[m, 1] + turn[2][k] * speed[m, 2]
            rows[m, k] = turn[axis][k]
            mean[m] -= turn[axis][k] * drag_per_s[k] * x[m, k]
        x[m, AXIS_N], x[m, AXIS_E] = b_n, b_e
        x[m, THRUST] = size / STANDARD_GRAVITY_MPS2
        x[m, GROUND] = x[m, THRUST] * near[m]
    return x, rows, mean


def proximity(radius_m: float, height_m: float) -> float:
    """(R / 4h)^2 with h at least R / 2: the ground term's share of thrust."""
    share = 0.25 * radius_m / max(height_m, 0.5 * radius_m)
    return share * share
