"""Inertia: the moments of inertia are other than the file says."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import D_INERTIA, p_effect

SCALE_X = p_effect("inertia", "scale_x")


@njit
def change(p: F64) -> None:
    """Multiply the three moments of inertia."""
    for axis in range(3):
        p[D_INERTIA + axis] *= p[SCALE_X + axis]
