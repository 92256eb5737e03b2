"""Thrust scale: every rotor gives more or less than the file says (propeller, air density, a wrong test bench)."""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import D_GAIN, p_effect

SCALE = p_effect("thrust_scale", "scale")


@njit
def change(p: F64) -> None:
    """Multiply the gain of all four rotors."""
    for i in range(4):
        p[D_GAIN + i] *= p[SCALE]
