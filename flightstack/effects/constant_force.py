"""Constant force: fixed in the world, at the CoM, whatever the drag."""

from __future__ import annotations

from flightstack.effects.record import WRITTEN_IN_AIRCRAFT, Effect, ParamSpec
from flightstack.effects.row import Vec, place
from flightstack.jit import njit
from flightstack.types import F64

NORTH = place("constant_force", "north_n")
EAST = place("constant_force", "east_n")
DOWN = place("constant_force", "down_n")


@njit
def force(p: F64) -> Vec:
    """Force (N, NED)."""
    return (p[NORTH], p[EAST], p[DOWN])


EFFECT = Effect(
    name="constant_force",
    params=(
        ParamSpec("north_n", "N", 0.0, -500.0, 500.0),
        ParamSpec("east_n", "N", 0.0, -500.0, 500.0),
        ParamSpec("down_n", "N", 0.0, -500.0, 500.0),
    ),
    kind="force",
    place="world force",
    physics=force,
    equation="a force at the CoM, fixed in the world",
    source="Wang, Theodorou, Egerstedt, ICRA 2018: the simulated 0.1 g wind",
    words="a constant force",
    scale=lambda size: 0.02 * size.weight_n,
    needs=("q_ned_frd",),
    manoeuvre="hover while turning by half a turn, then the same line to and fro",
    jsbsim=WRITTEN_IN_AIRCRAFT,
    example={"north_n": 1.2, "east_n": -0.4, "down_n": 0.2},
    told_by_force=True,
)
