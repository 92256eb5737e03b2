"""Steady wind: the air moves over the ground at a constant velocity."""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import Vec, place
from flightstack.jit import njit
from flightstack.types import F64

NORTH = place("steady_wind", "north_mps")
EAST = place("steady_wind", "east_mps")
DOWN = place("steady_wind", "down_mps")


@njit
def velocity(p: F64) -> Vec:
    """Velocity of the air (m/s, NED)."""
    return (p[NORTH], p[EAST], p[DOWN])


EFFECT = Effect(
    name="steady_wind",
    params=(
        ParamSpec("north_mps", "m/s", 0.0, -60.0, 60.0),
        ParamSpec("east_mps", "m/s", 0.0, -60.0, 60.0),
        ParamSpec("down_mps", "m/s", 0.0, -60.0, 60.0),
    ),
    kind="air",
    place="wind",
    physics=velocity,
    equation="velocity of the air over ground (3 north: a wind from the south); acts through the drag effects",
    source="Galilean: forces of the air depend on the velocity relative to it",
    words="a steady wind",
    scale=lambda size: 1.0,
    needs=("vel_ned_mps", "q_ned_frd"),
    manoeuvre="the same speed on two opposite headings for 10 s, by a vehicle whose drag is known",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"north_mps": 4.0, "east_mps": -3.0, "down_mps": 0.5},
)
