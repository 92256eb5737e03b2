"""The exact viability kernel of a double integrator on a strip: what no certificate of it can exceed.

p' = v, v' = u with u_low <= u <= u_high, u_low < 0 < u_high, and p to stay in [limit_low, limit_high].  A state can
stay in for ever exactly where full braking stops it in time: v^2 <= 2 |u_low| (limit_high - p) moving up and
v^2 <= 2 u_high (p - limit_low) moving down (kinematics).  A doubt of at most E about v' makes the ranges narrower by E
at both ends, since the worst disturbance is the constant one.
"""

from __future__ import annotations

import math


def area(limit_low_m: float, limit_high_m: float, u_low_mps2: float, u_high_mps2: float) -> float:
    """Area of the kernel in the (p, v) plane, m^2/s: two thirds of the boxes under its parabolas."""
    room = limit_high_m - limit_low_m
    if room <= 0.0 or u_low_mps2 >= 0.0 or u_high_mps2 <= 0.0:
        return 0.0
    up, down = math.sqrt(-2.0 * u_low_mps2 * room), math.sqrt(2.0 * u_high_mps2 * room)
    return 2.0 / 3.0 * room * (up + down)
