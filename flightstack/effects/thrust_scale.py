"""Thrust scale: every rotor gives more or less than the file says (propeller, air density, a wrong test bench)."""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import D_GAIN, place
from flightstack.jit import njit
from flightstack.types import F64

SCALE = place("thrust_scale", "scale")


@njit
def change(p: F64) -> None:
    """Multiply the gain of all four rotors."""
    for i in range(4):
        p[D_GAIN + i] *= p[SCALE]


EFFECT = Effect(
    name="thrust_scale",
    params=(ParamSpec("scale", "", 1.0, 0.0, 3.0),),
    kind="thrust",
    place="parameters",
    physics=change,
    equation="every T_i times scale",
    source="Leishman, Principles of Helicopter Aerodynamics, 2006, 3.2: T ~ rho",
    words="a thrust scale",
    scale=lambda size: 0.05,
    needs=("motor",),
    manoeuvre="a thrust chirp, and rate doublets for the torque channel",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"scale": 0.9},
    told_by_force=True,
)
