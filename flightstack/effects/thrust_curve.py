"""Thrust curve: T = max_thrust (f u^2 + (1 - f) u), PX4's THR_MDL_FAC form."""

from __future__ import annotations

import math

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import D_FACTOR, place
from flightstack.jit import njit
from flightstack.types import F64

FACTOR = place("thrust_curve", "thrust_model_factor")


@njit
def change(p: F64) -> None:
    """Replace the vehicle's own factor."""
    if not math.isnan(p[FACTOR]):
        p[D_FACTOR] = p[FACTOR]


@njit
def share(u: float, factor: float) -> float:
    """Static thrust of one rotor at the normalised command `u` (0..1), as a share of its greatest."""
    return factor * u * u + (1.0 - factor) * u


EFFECT = Effect(
    name="thrust_curve",
    params=(ParamSpec("thrust_model_factor", "", None, 0.0, 1.0),),
    kind="parameter",
    place="parameters",
    physics=change,
    equation="the command-to-thrust curve: T = max_thrust (f u^2 + (1 - f) u)",
    source="PX4 user guide, parameter THR_MDL_FAC: thrust = f u^2 + (1 - f) u",
    words="another thrust curve",
    scale=lambda size: 0.1,
    needs=("motor", "command"),
    manoeuvre="hard climbs and fast descents: thrust from a third to all of it",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"thrust_model_factor": 0.4},
    told_by_force=True,
)
