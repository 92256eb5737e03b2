"""CoM offset: the centre of mass lies at (x, y, z) FRD of where the file says, so the rotors' lever arms change."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import D_ARM, p_effect

X = p_effect("com_offset", "x_m")


@njit
def change(p: F64) -> None:
    """Lever arms become position - offset; position, velocity and IMU of the vehicle are those of the true CoM."""
    for i in range(4):
        for axis in range(3):
            p[D_ARM + 3 * i + axis] -= p[X + axis]
