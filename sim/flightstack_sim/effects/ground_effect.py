"""Ground effect: thrust / (1 - s (R / 4 z)^2), z the hub's height, at least R/2, s (R / 4 z)^2 at most 0.75.

The limit keeps the formula below four times the thrust where strong effects are extrapolated to the ground.
"""

from __future__ import annotations

from flightstack.jit import njit
from flightstack.types import F64
from flightstack_sim.layout import P_RADIUS, p_effect

STRENGTH = p_effect("ground_effect", "strength")
MOST_LOST = 0.75
"""Greatest s (R / 4 z)^2."""


@njit
def factor(p: F64, height_m: float) -> float:
    """Thrust factor of one rotor whose hub is at this height; 1 without effect."""
    if p[STRENGTH] == 0.0:
        return 1.0
    radius = p[P_RADIUS]
    ratio = radius / (4.0 * max(height_m, 0.5 * radius))
    return float(1.0 / (1.0 - min(p[STRENGTH] * ratio * ratio, MOST_LOST)))
