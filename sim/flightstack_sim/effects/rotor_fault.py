"""Rotor fault: one rotor keeps only part of its thrust, and of its reaction torque."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import D_GAIN, p_effect

ROTOR = p_effect("rotor_fault", "rotor")
EFFECTIVENESS = p_effect("rotor_fault", "effectiveness")


@njit
def change(p: F64) -> None:
    """Multiply the gain of the rotor concerned (1-4, in file order)."""
    if p[EFFECTIVENESS] != 1.0:
        p[D_GAIN + int(p[ROTOR]) - 1] *= p[EFFECTIVENESS]
