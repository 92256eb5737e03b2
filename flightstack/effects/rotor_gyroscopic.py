"""Rotor gyroscopics: the spinning rotors' angular momentum h e_z turns with the body, torque -omega x h e_z.

The air's reaction torque on the body is opposite to the rotor's own rotation: s_i = -sign(torque_ratio_i).
"""

from __future__ import annotations

from flightstack.effects.record import RATE_RADPS, WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import P_TORQUE_RATIO, place
from flightstack.jit import njit
from flightstack.types import F64

INERTIA = place("rotor_gyroscopic", "rotor_inertia_kgm2")


@njit
def momentum(p: F64, rotor: int, speed_radps: float) -> float:
    """Angular momentum (N m s) of one rotor about body z."""
    ratio = p[P_TORQUE_RATIO + rotor]
    if ratio > 0.0:
        return float(-p[INERTIA] * speed_radps)
    if ratio < 0.0:
        return float(p[INERTIA] * speed_radps)
    return 0.0


@njit
def torque(spin_nms: float, rate_x: float, rate_y: float) -> tuple[float, float]:
    """-omega x (0, 0, spin): torque (N m) about body x and y; it does no work."""
    return (-rate_y * spin_nms, rate_x * spin_nms)


EFFECT = Effect(
    name="rotor_gyroscopic",
    params=(ParamSpec("rotor_inertia_kgm2", "kg m^2", 0.0, 0.0, 0.1),),
    kind="torque",
    place="own",
    physics=momentum,
    equation="-omega x sum_i J W_i s_i e_z, s_i the sense of rotation about body z",
    source="Bouabdallah, EPFL thesis 3727, 2007: propeller gyro effect",
    words="gyroscopic torque of the rotors",
    scale=lambda size: 2.0 * size.inertia_kgm2 / size.turning_radps / RATE_RADPS,
    needs=("motor",),
    manoeuvre="roll and pitch doublets while yawing",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"rotor_inertia_kgm2": 5e-5},
    turns_only=True,
)
