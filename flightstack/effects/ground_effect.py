"""Ground effect: thrust / (1 - s (R / 4 z)^2), z the hub's height, at least R/2, s (R / 4 z)^2 at most 0.75.

The limit keeps the formula below four times the thrust where strong effects are extrapolated to the ground.
"""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import P_RADIUS, Vec, place
from flightstack.jit import njit
from flightstack.types import F64

STRENGTH = place("ground_effect", "strength")
MOST_LOST = 0.75
"""Greatest s (R / 4 z)^2."""


@njit
def factor(p: F64, thrust_n: float, hub_air: Vec, height_m: float) -> float:
    """Thrust factor of one rotor whose hub is at this height; 1 without effect."""
    if p[STRENGTH] == 0.0:
        return 1.0
    radius = p[P_RADIUS]
    ratio = radius / (4.0 * max(height_m, 0.5 * radius))
    return float(1.0 / (1.0 - min(p[STRENGTH] * ratio * ratio, MOST_LOST)))


EFFECT = Effect(
    name="ground_effect",
    params=(ParamSpec("strength", "", 0.0, 0.0, 20.0),),
    kind="thrust",
    place="thrust factor",
    physics=factor,
    equation="thrust / (1 - s (R / 4 z)^2), s (R / 4 z)^2 at most 0.75, z the hub's height, at least R/2",
    source="Cheeseman and Bennett, ARC R&M 3021, 1955",
    words="ground effect",
    scale=lambda size: 0.3,
    needs=("height_m", "motor"),
    manoeuvre="passes at half, one and two rotor diameters over the ground",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"strength": 1.0},
    told_by_force=True,
)
