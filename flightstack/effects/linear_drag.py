"""Linear drag: -D v_a at the CoM, D diagonal in the body."""

from __future__ import annotations

from flightstack.effects import expressions as x
from flightstack.effects.record import Axes, Effect, Terms, Values, xyz
from flightstack.effects.row import D_MASS, Vec, place
from flightstack.jit import njit
from flightstack.types import F64

D_X = place("linear_drag", "d_x_kgps")
D_Y = place("linear_drag", "d_y_kgps")
D_Z = place("linear_drag", "d_z_kgps")


@njit
def force(p: F64, air: Vec) -> Vec:
    """Force (N, FRD) at the CoM's velocity relative to the air (m/s, FRD)."""
    return (-p[D_X] * air[0], -p[D_Y] * air[1], -p[D_Z] * air[2])


def decay_rate(p: F64) -> float:
    """Of the speed (1/s)."""
    return float(p[D_X : D_X + 3].max() / p[D_MASS])


def jsbsim(d: Values, air: Axes, speed: str) -> Terms:
    """The force's three terms."""
    return tuple(x.times(-k, v) if k else None for k, v in zip(d, air, strict=True))


EFFECT = Effect(
    name="linear_drag",
    params=xyz("d_*_kgps", "kg/s", 0.0, 0.0, 100.0),
    kind="force",
    place="body force",
    physics=force,
    equation="-D v_a at the CoM",
    source="Faessler, Franchi, Scaramuzza, RA-L 2018, eq. 4",
    words="linear drag",
    scale=lambda size: 0.05 * size.mass_kg,
    needs=("vel_ned_mps", "q_ned_frd"),
    manoeuvre="straight runs at 2 to 6 m/s, forwards, sideways and climbing",
    jsbsim=jsbsim,
    example={"d_x_kgps": 0.3, "d_y_kgps": 0.4, "d_z_kgps": 0.2},
    decay_rate=decay_rate,
    told_by_force=True,
)
