"""Thrust curve: T = max_thrust (f u^2 + (1 - f) u), PX4's THR_MDL_FAC form."""

from __future__ import annotations

import math

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import D_FACTOR, p_effect

FACTOR = p_effect("thrust_curve", "thrust_model_factor")


@njit
def change(p: F64) -> None:
    """Replace the vehicle's own factor."""
    if not math.isnan(p[FACTOR]):
        p[D_FACTOR] = p[FACTOR]


@njit
def share(u: float, factor: float) -> float:
    """Static thrust of one rotor at the normalised command `u` (0..1), as a share of its greatest."""
    return factor * u * u + (1.0 - factor) * u
