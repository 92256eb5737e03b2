"""Inertia: the moments of inertia are other than the file says."""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, xyz
from flightstack.effects.row import D_INERTIA, place
from flightstack.jit import njit
from flightstack.types import F64

SCALE_X = place("inertia", "scale_x")


@njit
def change(p: F64) -> None:
    """Multiply the three moments of inertia."""
    for axis in range(3):
        p[D_INERTIA + axis] *= p[SCALE_X + axis]


EFFECT = Effect(
    name="inertia",
    params=xyz("scale_*", "", 1.0, 0.1, 10.0),
    kind="parameter",
    place="parameters",
    physics=change,
    equation="moments of inertia times these scales",
    source="Euler's equations, principal axes along the body's",
    words="another inertia",
    scale=lambda size: 0.05,
    needs=("motor",),
    manoeuvre="rate doublets on all three axes",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"scale_x": 1.2, "scale_y": 0.9, "scale_z": 1.1},
    turns_only=True,
)
