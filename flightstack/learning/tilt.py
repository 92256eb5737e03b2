"""Tilt axes, in which samples are learned (`sampler`)."""

from __future__ import annotations

import math

from flightstack.jit import njit
from flightstack.types import F64


@njit
def tilt_axes(axis_n: float, axis_e: float, out: F64) -> None:
    """(3, 3) into `out`: tilt axes to NED for a thrust axis (down part positive); exact, no trigonometry."""
    squared = axis_n * axis_n + axis_e * axis_e
    down = math.sqrt(max(1.0 - squared, 0.0))
    share = 1.0 / (1.0 + down)
    out[0, 0] = 1.0 - share * axis_n * axis_n
    out[0, 1] = -share * axis_n * axis_e
    out[0, 2] = axis_n
    out[1, 0] = out[0, 1]
    out[1, 1] = 1.0 - share * axis_e * axis_e
    out[1, 2] = axis_e
    out[2, 0] = -axis_n
    out[2, 1] = -axis_e
    out[2, 2] = down
