"""Parasitic drag: -|v_a| C v_a at the CoM, C diagonal in the body: the frame's bluff-body drag."""

from __future__ import annotations

import math

from flightstack.effects import expressions as x
from flightstack.effects.record import SPEED_MPS, Axes, Effect, Terms, Values, xyz
from flightstack.effects.row import D_MASS, Vec, place
from flightstack.jit import njit
from flightstack.types import F64

C_X = place("parasitic_drag", "c_x_kg_per_m")
C_Y = place("parasitic_drag", "c_y_kg_per_m")
C_Z = place("parasitic_drag", "c_z_kg_per_m")
_TOP_SPEED_MPS = 50.0


@njit
def force(p: F64, air: Vec) -> Vec:
    """Force (N, FRD) at the CoM's velocity relative to the air (m/s, FRD)."""
    airspeed = math.sqrt(air[0] * air[0] + air[1] * air[1] + air[2] * air[2])
    return (-airspeed * p[C_X] * air[0], -airspeed * p[C_Y] * air[1], -airspeed * p[C_Z] * air[2])


def decay_rate(p: F64) -> float:
    """Of the speed (1/s), at 50 m/s."""
    return float(2.0 * _TOP_SPEED_MPS * p[C_X : C_X + 3].max() / p[D_MASS])


def jsbsim(c: Values, air: Axes, speed: str) -> Terms:
    """The force's three terms."""
    return tuple(x.times(-k, speed, v) if k else None for k, v in zip(c, air, strict=True))


EFFECT = Effect(
    name="parasitic_drag",
    params=xyz("c_*_kg_per_m", "kg/m", 0.0, 0.0, 10.0),
    kind="force",
    place="body force",
    physics=force,
    equation="-|v_a| C v_a at the CoM",
    source="Hoerner, Fluid-Dynamic Drag, 1965: F = rho/2 c A v^2 of a bluff body",
    words="parasitic drag",
    scale=lambda size: 0.05 * size.mass_kg / SPEED_MPS,
    needs=("vel_ned_mps", "q_ned_frd"),
    manoeuvre="straight runs as fast as it goes, forwards, sideways and climbing",
    jsbsim=jsbsim,
    example={"c_x_kg_per_m": 0.02, "c_y_kg_per_m": 0.03, "c_z_kg_per_m": 0.05},
    decay_rate=decay_rate,
    told_by_force=True,
)
