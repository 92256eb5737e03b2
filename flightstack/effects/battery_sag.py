"""Battery sag: thrust falls with the voltage at the terminals."""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import P_REFERENCE_V, place
from flightstack.jit import njit
from flightstack.types import F64

LOSS = place("battery_sag", "thrust_loss_per_v")


@njit
def factor(p: F64, voltage_v: float) -> float:
    """1 - c (reference_v - V): above 1 over the reference voltage, never below 0."""
    if p[LOSS] == 0.0:
        return 1.0
    return float(max(0.0, 1.0 - p[LOSS] * (p[P_REFERENCE_V] - voltage_v)))


EFFECT = Effect(
    name="battery_sag",
    params=(ParamSpec("thrust_loss_per_v", "1/V", 0.0, 0.0, 2.0),),
    kind="thrust",
    place="own",
    physics=factor,
    equation="thrust scales as 1 - c (reference_v - V), never below 0",
    source="Bauersfeld and Scaramuzza, RA-L 2022: rotor speed follows the voltage",
    words="battery sag",
    scale=lambda size: 0.01,
    needs=("battery_v", "motor", "command"),
    manoeuvre="the same manoeuvres on a fresh and on an empty battery, with the voltage in the log",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"thrust_loss_per_v": 0.06},
    told_by_force=True,
)
