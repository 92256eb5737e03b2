"""CoM offset: the centre of mass lies at (x, y, z) FRD of where the file says, so the rotors' lever arms change."""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, xyz
from flightstack.effects.row import D_ARM, place
from flightstack.jit import njit
from flightstack.types import F64

X = place("com_offset", "x_m")


@njit
def change(p: F64) -> None:
    """Lever arms become position - offset; position, velocity and IMU of the vehicle are those of the true CoM."""
    for i in range(4):
        for axis in range(3):
            p[D_ARM + 3 * i + axis] -= p[X + axis]


EFFECT = Effect(
    name="com_offset",
    params=xyz("*_m", "m", 0.0, -1.0, 1.0),
    kind="parameter",
    place="parameters",
    physics=change,
    equation="the CoM lies at (x, y, z) FRD of where the file says: lever arms become position - offset",
    source="lever arms of the parallel forces about the true CoM (statics)",
    words="a shifted centre of mass",
    scale=lambda size: 0.05 * size.arm_m,
    needs=("motor",),
    manoeuvre="climb hard and hover by turns",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"x_m": 0.02, "y_m": -0.015, "z_m": 0.03},
)
