"""Rotor gyroscopics: the spinning rotors' angular momentum h e_z turns with the body, torque -omega x h e_z.

The air's reaction torque on the body is opposite to the rotor's own rotation: s_i = -sign(torque_ratio_i).
"""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import P_TORQUE_RATIO, p_effect

INERTIA = p_effect("rotor_gyroscopic", "rotor_inertia_kgm2")


@njit
def momentum(p: F64, rotor: int, speed_radps: float) -> float:
    """Angular momentum (N m s) of one rotor about body z."""
    ratio = p[P_TORQUE_RATIO + rotor]
    if ratio > 0.0:
        return float(-p[INERTIA] * speed_radps)
    if ratio < 0.0:
        return float(p[INERTIA] * speed_radps)
    return 0.0


@njit
def torque(spin_nms: float, rate_x: float, rate_y: float) -> tuple[float, float]:
    """-omega x (0, 0, spin): torque (N m) about body x and y; it does no work."""
    return (-rate_y * spin_nms, rate_x * spin_nms)
