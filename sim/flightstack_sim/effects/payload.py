"""Payload: a mass fixed at the CoM."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import D_MASS, p_effect

MASS = p_effect("payload", "mass_kg")


@njit
def change(p: F64) -> None:
    """Add the payload to the vehicle's mass; the inertia about the CoM stays."""
    p[D_MASS] += p[MASS]
