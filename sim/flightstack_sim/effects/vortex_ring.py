"""Vortex ring state: sinking into its own wake near w = v_h a rotor loses thrust, 1 - s exp(-((w/v_h - 1)/0.5)^2)."""

from __future__ import annotations

import math

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import D_DISK, p_effect

STRENGTH = p_effect("vortex_ring", "strength")
_LEAST_INDUCED_MPS = 1e-6  # a standing rotor has no wake


@njit
def factor(p: F64, thrust_n: float, descent_mps: float) -> float:
    """Thrust factor of one rotor: `thrust_n` before this effect, `descent_mps` its velocity through the air along z."""
    if p[STRENGTH] == 0.0:
        return 1.0
    induced = math.sqrt(max(thrust_n, 0.0) / p[D_DISK])
    if induced < _LEAST_INDUCED_MPS:
        return 1.0
    x = (descent_mps / induced - 1.0) / 0.5
    return float(1.0 - p[STRENGTH] * math.exp(-x * x))
