"""Translational lift: a rotor in edgewise flow meets more air, T_i grows by k_h (v_ax,i^2 + v_ay,i^2)."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import Vec, p_effect

K_H = p_effect("translational_lift", "k_h_kg_per_m")


@njit
def added_thrust(p: F64, thrust_n: float, hub_air: Vec) -> float:
    """What one rotor gains (N); a standing rotor gains nothing."""
    if thrust_n <= 0.0:
        return 0.0
    return float(p[K_H] * (hub_air[0] * hub_air[0] + hub_air[1] * hub_air[1]))
