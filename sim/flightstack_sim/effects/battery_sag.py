"""Battery sag: thrust falls with the voltage at the terminals."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import P_REFERENCE_V, p_effect

LOSS = p_effect("battery_sag", "thrust_loss_per_v")


@njit
def factor(p: F64, voltage_v: float) -> float:
    """1 - c (reference_v - V): above 1 over the reference voltage, never below 0."""
    if p[LOSS] == 0.0:
        return 1.0
    return float(max(0.0, 1.0 - p[LOSS] * (p[P_REFERENCE_V] - voltage_v)))
