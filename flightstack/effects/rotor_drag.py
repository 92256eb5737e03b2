"""Rotor drag (H-force): -k_d W_i (v_ax,i, v_ay,i, 0) at each hub."""

from __future__ import annotations

from flightstack.effects import expressions as x
from flightstack.effects.record import Axes, Effect, ParamSpec, Terms, Values
from flightstack.effects.row import Vec, hub_decay, place
from flightstack.jit import njit
from flightstack.types import F64

K_D = place("rotor_drag", "k_d_kg_per_rad")


@njit
def hub_force(p: F64, speed_radps: float, hub_air: Vec) -> Vec:
    """Force (N, FRD) at one hub that moves through the air at `hub_air` (m/s, FRD)."""
    k = p[K_D] * speed_radps
    return (-k * hub_air[0], -k * hub_air[1], 0.0)


def decay_rate(p: F64) -> float:
    """Of speed or body rate (1/s), whichever is faster, with the rotors at full speed."""
    return float(p[K_D] * hub_decay(p))


def jsbsim(k: Values, air: Axes, speed: str) -> Terms:
    """The force's three terms."""
    return x.times(-k[0], speed, air[0]), x.times(-k[0], speed, air[1]), None


EFFECT = Effect(
    name="rotor_drag",
    params=(ParamSpec("k_d_kg_per_rad", "kg/rad", 0.0, 0.0, 0.1),),
    kind="force",
    place="hub force",
    physics=hub_force,
    equation="-k_d W_i (v_ax,i, v_ay,i, 0) at each hub",
    source="Martin and Salaun, ICRA 2010; Svacha et al., ICUAS 2017: H-force ~ W v",
    words="rotor drag",
    scale=lambda size: 0.05 * size.mass_kg / size.turning_radps,
    needs=("vel_ned_mps", "q_ned_frd"),
    manoeuvre="straight runs at 2 to 6 m/s and the same in hard turns",
    jsbsim=jsbsim,
    example={"k_d_kg_per_rad": 1.6e-4},
    decay_rate=decay_rate,
    told_by_force=True,
)
