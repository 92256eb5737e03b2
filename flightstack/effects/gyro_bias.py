"""Gyro bias: measured body rate = true + bias, body FRD."""

from __future__ import annotations

from flightstack.effects.record import NO_PHYSICS, Effect, xyz
from flightstack.effects.row import place
from flightstack.types import F64

X = place("gyro_bias", "x_radps")


def bias(p: F64) -> F64:
    """The bias (3,) rad/s of one parameter row; the plant's motion knows nothing of it."""
    return p[X : X + 3].copy()


EFFECT = Effect(
    name="gyro_bias",
    params=xyz("*_radps", "rad/s", 0.0, -2.0, 2.0),
    kind="sensor",
    place="sensor",
    physics=bias,
    equation="measured = true + bias",
    source="IEEE Std 952: bias of the measured rate",
    words="a gyro bias",
    scale=lambda size: 0.01,
    needs=("rate_frd_radps", "q_ned_frd"),
    manoeuvre="half a minute with attitude in the log",
    jsbsim=NO_PHYSICS,
    example={"x_radps": 0.01, "y_radps": 0.02, "z_radps": -0.03},
)
