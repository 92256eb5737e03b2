"""Rotor drag (H-force): -k_d W_i (v_ax,i, v_ay,i, 0) at each hub."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import Vec, p_effect

K_D = p_effect("rotor_drag", "k_d_kg_per_rad")


@njit
def hub_force(p: F64, speed_radps: float, hub_air: Vec) -> Vec:
    """Force (N, FRD) at one hub that moves through the air at `hub_air` (m/s, FRD)."""
    k = p[K_D] * speed_radps
    return (-k * hub_air[0], -k * hub_air[1], 0.0)
