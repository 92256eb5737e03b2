"""Vortex ring state: sinking into its own wake near w = v_h a rotor loses thrust, 1 - s exp(-((w/v_h - 1)/0.5)^2)."""

from __future__ import annotations

import math

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import D_DISK, Vec, place
from flightstack.jit import njit
from flightstack.types import F64

STRENGTH = place("vortex_ring", "strength")
_LEAST_INDUCED_MPS = 1e-6  # a standing rotor has no wake


@njit
def factor(p: F64, thrust_n: float, hub_air: Vec, height_m: float) -> float:
    """Thrust factor of one rotor: `thrust_n` before this effect."""
    if p[STRENGTH] == 0.0:
        return 1.0
    induced = math.sqrt(max(thrust_n, 0.0) / p[D_DISK])
    if induced < _LEAST_INDUCED_MPS:
        return 1.0
    x = (hub_air[2] / induced - 1.0) / 0.5
    return float(1.0 - p[STRENGTH] * math.exp(-x * x))


EFFECT = Effect(
    name="vortex_ring",
    params=(ParamSpec("strength", "", 0.0, 0.0, 1.0),),
    kind="thrust",
    place="thrust factor",
    physics=factor,
    equation="thrust times 1 - s exp(-((w/v_h - 1)/0.5)^2), w the rate of descent through air, v_h = sqrt(T / 2 rho A)",
    source="Leishman 2006, 2.13.6: loss of thrust centred at w = v_h (bell fit)",
    words="a vortex ring",
    scale=lambda size: 0.1,
    needs=("vel_ned_mps", "q_ned_frd", "motor"),
    manoeuvre="straight descents at the speed of the rotors' own wake (3 to 6 m/s)",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"strength": 0.4},
    told_by_force=True,
)
