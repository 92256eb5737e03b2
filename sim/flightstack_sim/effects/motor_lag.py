"""Motor lag: u' = (u_cmd - u) / tau, solved exactly for the command held within a step."""

from __future__ import annotations

import math

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import D_LAG_FULL, D_LAG_HALF, D_TAU, P_DT, p_effect

TIME_CONSTANT = p_effect("motor_lag", "time_constant_s")


@njit
def change(p: F64) -> None:
    """Replace the vehicle's own time constant; note what is left of an error after half a step and after a whole."""
    if not math.isnan(p[TIME_CONSTANT]):
        p[D_TAU] = p[TIME_CONSTANT]
    tau = p[D_TAU]
    p[D_LAG_HALF] = math.exp(-0.5 * p[P_DT] / tau) if tau > 0.0 else 0.0
    p[D_LAG_FULL] = math.exp(-p[P_DT] / tau) if tau > 0.0 else 0.0
