"""Rotor fault: one rotor keeps only part of its thrust, and of its reaction torque."""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import D_GAIN, place
from flightstack.jit import njit
from flightstack.types import F64

ROTOR = place("rotor_fault", "rotor")
EFFECTIVENESS = place("rotor_fault", "effectiveness")


@njit
def change(p: F64) -> None:
    """Multiply the gain of the rotor concerned (1-4, in file order)."""
    if p[EFFECTIVENESS] != 1.0:
        p[D_GAIN + int(p[ROTOR]) - 1] *= p[EFFECTIVENESS]


EFFECT = Effect(
    name="rotor_fault",
    params=(
        ParamSpec("rotor", "", None, 1.0, 4.0, required=True, integer=True),
        ParamSpec("effectiveness", "", 1.0, 0.0, 1.5),
    ),
    kind="thrust",
    place="parameters",
    physics=change,
    equation="one T_i (and with it its torque) times effectiveness",
    source="Mueller and D'Andrea, ICRA 2014: loss of effectiveness of a propeller",
    words="a weak rotor",
    scale=lambda size: 0.05,
    needs=("motor",),
    manoeuvre="hover, then rate doublets on all axes",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"rotor": 3, "effectiveness": 0.8},
)
