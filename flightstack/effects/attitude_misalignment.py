"""Attitude misalignment: the measured attitude is the true one followed by a small body rotation."""

from __future__ import annotations

from flightstack.effects.record import NO_PHYSICS, Effect, ParamSpec
from flightstack.effects.row import place
from flightstack.frames import quat_from_euler
from flightstack.types import F64

ROLL = place("attitude_misalignment", "roll_rad")
PITCH = place("attitude_misalignment", "pitch_rad")
YAW = place("attitude_misalignment", "yaw_rad")


def rotation(p: F64) -> F64:
    """Quaternion (4,) of one parameter row: q_measured = q_ned_frd (x) this."""
    return quat_from_euler(p[ROLL], p[PITCH], p[YAW])


EFFECT = Effect(
    name="attitude_misalignment",
    params=(
        ParamSpec("roll_rad", "rad", 0.0, -1.0, 1.0),
        ParamSpec("pitch_rad", "rad", 0.0, -1.0, 1.0),
        ParamSpec("yaw_rad", "rad", 0.0, -3.1416, 3.1416),
    ),
    kind="sensor",
    place="sensor",
    physics=rotation,
    equation="the measured attitude is the true one followed by this body rotation",
    source="mounting error between body and estimator axes",
    words="an attitude misalignment",
    scale=lambda size: 0.01,
    needs=("q_ned_frd",),
    manoeuvre="hover, then rate doublets, with velocity and attitude in the log",
    jsbsim=NO_PHYSICS,
    example={"roll_rad": 0.02, "pitch_rad": -0.03, "yaw_rad": 0.05},
)
