"""Parasitic drag: -|v_a| C v_a at the CoM, C diagonal in the body: the frame's bluff-body drag."""

from __future__ import annotations

import math

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import Vec, p_effect

C_X = p_effect("parasitic_drag", "c_x_kg_per_m")
C_Y = p_effect("parasitic_drag", "c_y_kg_per_m")
C_Z = p_effect("parasitic_drag", "c_z_kg_per_m")


@njit
def force(p: F64, air: Vec) -> Vec:
    """Force (N, FRD) at the CoM's velocity relative to the air (m/s, FRD)."""
    airspeed = math.sqrt(air[0] * air[0] + air[1] * air[1] + air[2] * air[2])
    return (-airspeed * p[C_X] * air[0], -airspeed * p[C_Y] * air[1], -airspeed * p[C_Z] * air[2])
