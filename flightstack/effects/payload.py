"""Payload: a mass fixed at the CoM."""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import D_MASS, place
from flightstack.jit import njit
from flightstack.types import F64

MASS = place("payload", "mass_kg")


@njit
def change(p: F64) -> None:
    """Add the payload to the vehicle's mass; the inertia about the CoM stays."""
    p[D_MASS] += p[MASS]


EFFECT = Effect(
    name="payload",
    params=(ParamSpec("mass_kg", "kg", 0.0, -50.0, 50.0),),
    kind="parameter",
    place="parameters",
    physics=change,
    equation="mass at the CoM; may be negative as long as a twentieth of the vehicle's own mass is left",
    source="Newton's second law; point mass at the CoM, so the inertia stays",
    words="a payload",
    scale=lambda size: 0.05 * size.mass_kg,
    needs=("motor",),
    manoeuvre="a thrust chirp, and rate doublets for the torque channel",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"mass_kg": 0.3},
    told_by_force=True,
)
