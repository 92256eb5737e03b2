"""Linear drag: -D v_a at the CoM, D diagonal in the body."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import Vec, p_effect

D_X = p_effect("linear_drag", "d_x_kgps")
D_Y = p_effect("linear_drag", "d_y_kgps")
D_Z = p_effect("linear_drag", "d_z_kgps")


@njit
def force(p: F64, air: Vec) -> Vec:
    """Force (N, FRD) at the CoM's velocity relative to the air (m/s, FRD)."""
    return (-p[D_X] * air[0], -p[D_Y] * air[1], -p[D_Z] * air[2])
