"""Translational lift: a rotor in edgewise flow meets more air, T_i grows by k_h (v_ax,i^2 + v_ay,i^2)."""

from __future__ import annotations

from flightstack.effects.record import SPEED_MPS, WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import Vec, place
from flightstack.jit import njit
from flightstack.types import F64

K_H = place("translational_lift", "k_h_kg_per_m")


@njit
def added_thrust(p: F64, thrust_n: float, hub_air: Vec) -> float:
    """What one rotor gains (N); a standing rotor gains nothing."""
    if thrust_n <= 0.0:
        return 0.0
    return float(p[K_H] * (hub_air[0] * hub_air[0] + hub_air[1] * hub_air[1]))


EFFECT = Effect(
    name="translational_lift",
    params=(ParamSpec("k_h_kg_per_m", "kg/m", 0.0, 0.0, 1.0),),
    kind="thrust",
    place="added thrust",
    physics=added_thrust,
    equation="T_i grows by k_h (v_ax,i^2 + v_ay,i^2); a standing rotor has none",
    source="Svacha et al., ICUAS 2017; Foerster, ETH 2015: k_h v_h^2",
    words="translational lift",
    scale=lambda size: 0.05 * size.weight_n / 4.0 / SPEED_MPS**2,
    needs=("vel_ned_mps", "q_ned_frd", "motor"),
    manoeuvre="level runs at 4 to 8 m/s",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"k_h_kg_per_m": 0.008},
    told_by_force=True,
)
