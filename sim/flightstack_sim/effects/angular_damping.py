"""Angular damping: -K omega, K diagonal in the body."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import Vec, p_effect

K_X = p_effect("angular_damping", "k_x_nms")
K_Y = p_effect("angular_damping", "k_y_nms")
K_Z = p_effect("angular_damping", "k_z_nms")


@njit
def torque(p: F64, rate: Vec) -> Vec:
    """Torque (N m, FRD) at the body rates (rad/s, FRD)."""
    return (-p[K_X] * rate[0], -p[K_Y] * rate[1], -p[K_Z] * rate[2])
