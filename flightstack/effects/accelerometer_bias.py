"""Accelerometer bias: measured specific force = true + bias, body FRD."""

from __future__ import annotations

from flightstack.effects.record import NO_PHYSICS, Effect, xyz
from flightstack.effects.row import place
from flightstack.types import F64

X = place("accelerometer_bias", "x_mps2")


def bias(p: F64) -> F64:
    """The bias (3,) m/s^2 of one parameter row; the plant's motion knows nothing of it."""
    return p[X : X + 3].copy()


EFFECT = Effect(
    name="accelerometer_bias",
    params=xyz("*_mps2", "m/s^2", 0.0, -10.0, 10.0),
    kind="sensor",
    place="sensor",
    physics=bias,
    equation="measured = true + bias",
    source="IEEE Std 1293: bias of the measured specific force",
    words="an accelerometer bias",
    scale=lambda size: 0.1,
    needs=("accel_frd_mps2", "vel_ned_mps", "q_ned_frd"),
    manoeuvre="half a minute with velocity and attitude in the log",
    jsbsim=NO_PHYSICS,
    example={"x_mps2": 0.1, "y_mps2": -0.2, "z_mps2": 0.3},
)
