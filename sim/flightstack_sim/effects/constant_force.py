"""Constant force: fixed in the world, at the CoM, whatever the drag."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import Vec, p_effect

NORTH = p_effect("constant_force", "north_n")
EAST = p_effect("constant_force", "east_n")
DOWN = p_effect("constant_force", "down_n")


@njit
def force(p: F64) -> Vec:
    """Force (N, NED)."""
    return (p[NORTH], p[EAST], p[DOWN])
