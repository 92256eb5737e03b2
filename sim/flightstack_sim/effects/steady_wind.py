"""Steady wind: the air moves over the ground at a constant velocity."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import Vec, p_effect

NORTH = p_effect("steady_wind", "north_mps")
EAST = p_effect("steady_wind", "east_mps")
DOWN = p_effect("steady_wind", "down_mps")


@njit
def velocity(p: F64) -> Vec:
    """Velocity of the air (m/s, NED)."""
    return (p[NORTH], p[EAST], p[DOWN])
