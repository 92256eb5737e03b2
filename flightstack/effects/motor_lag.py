"""Motor lag: u' = (u_cmd - u) / tau, solved exactly for the command held within a step."""

from __future__ import annotations

import math

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import D_LAG_FULL, D_LAG_HALF, D_TAU, P_DT, place
from flightstack.jit import njit
from flightstack.types import F64

TIME_CONSTANT = place("motor_lag", "time_constant_s")


@njit
def change(p: F64) -> None:
    """Replace the vehicle's own time constant; note what is left of an error after half a step and after a whole."""
    if not math.isnan(p[TIME_CONSTANT]):
        p[D_TAU] = p[TIME_CONSTANT]
    tau = p[D_TAU]
    p[D_LAG_HALF] = math.exp(-0.5 * p[P_DT] / tau) if tau > 0.0 else 0.0
    p[D_LAG_FULL] = math.exp(-p[P_DT] / tau) if tau > 0.0 else 0.0


EFFECT = Effect(
    name="motor_lag",
    params=(ParamSpec("time_constant_s", "s", None, 0.0, 1.0),),
    kind="parameter",
    place="parameters",
    physics=change,
    equation="first-order lag of the rotors: u' = (u_cmd - u) / tau",
    source="Mahony, Kumar, Corke, IEEE Robot. Autom. Mag. 2012: first-order rotor speed",
    words="another motor lag",
    scale=lambda size: 0.005,
    needs=("motor", "command"),
    manoeuvre="rate doublets and a thrust chirp up to 8 Hz, logged at 250 Hz",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"time_constant_s": 0.05},
    has_states=True,
    turns_only=True,
)
