"""Accelerometer bias: measured specific force = true + bias, body FRD."""

from __future__ import annotations

from flightstack.types import F64
from flightstack_sim.layout import p_effect

X = p_effect("accelerometer_bias", "x_mps2")


def bias(p: F64) -> F64:
    """The bias (3,) m/s^2 of one parameter row; the plant's motion knows nothing of it."""
    return p[X : X + 3].copy()
