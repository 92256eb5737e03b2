"""Angular damping: -K omega, K diagonal in the body."""

from __future__ import annotations

from flightstack.effects import expressions as x
from flightstack.effects.record import Axes, Effect, Terms, Values, xyz
from flightstack.effects.row import D_INERTIA, Vec, place
from flightstack.jit import njit
from flightstack.types import F64

K_X = place("angular_damping", "k_x_nms")
K_Y = place("angular_damping", "k_y_nms")
K_Z = place("angular_damping", "k_z_nms")


@njit
def torque(p: F64, rate: Vec) -> Vec:
    """Torque (N m, FRD) at the body rates (rad/s, FRD)."""
    return (-p[K_X] * rate[0], -p[K_Y] * rate[1], -p[K_Z] * rate[2])


def decay_rate(p: F64) -> float:
    """Of the body rates (1/s)."""
    return float((p[K_X : K_X + 3] / p[D_INERTIA : D_INERTIA + 3]).max())


def jsbsim(k: Values, rate: Axes) -> Terms:
    """The torque's three terms."""
    return tuple(x.times(-d, w) if d else None for d, w in zip(k, rate, strict=True))


EFFECT = Effect(
    name="angular_damping",
    params=xyz("k_*_nms", "N m s", 0.0, 0.0, 10.0),
    kind="torque",
    place="body torque",
    physics=torque,
    equation="-K omega",
    source="Faessler, Franchi, Scaramuzza, RA-L 2018, eq. 5, diagonal",
    words="angular damping",
    scale=lambda size: 0.5 * size.inertia_kgm2,
    needs=("vel_ned_mps", "q_ned_frd", "motor"),  # drag at the hubs damps as well: it must be told from that
    manoeuvre="rate doublets on all three axes, and a long turn",
    jsbsim=jsbsim,
    example={"k_x_nms": 0.01, "k_y_nms": 0.02, "k_z_nms": 0.03},
    decay_rate=decay_rate,
    turns_only=True,
)
