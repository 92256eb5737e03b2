"""Blade flapping: the disk tilts back in edgewise flow; torque k W_i (e_z x v_a,i) of each rotor."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import Vec, p_effect

K_FLAP = p_effect("blade_flapping", "k_flap_nms2_per_rad_m")


@njit
def torque(p: F64, speed_radps: float, hub_air: Vec) -> tuple[float, float]:
    """Torque (N m) of one rotor about body x and y; forward flight with k > 0 pitches up."""
    k = p[K_FLAP] * speed_radps
    return (-k * hub_air[1], k * hub_air[0])
