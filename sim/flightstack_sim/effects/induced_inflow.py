"""Induced inflow: -k_z W_i v_az,i along body z at each hub: thrust falls when the rotor climbs through the air."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import Vec, p_effect

K_Z = p_effect("induced_inflow", "k_z_kg_per_rad")


@njit
def hub_force(p: F64, speed_radps: float, hub_air: Vec) -> float:
    """Force (N) along body z at one hub that moves through the air at `hub_air` (m/s, FRD)."""
    return float(-p[K_Z] * speed_radps * hub_air[2])
