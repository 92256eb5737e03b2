"""Induced inflow: -k_z W_i v_az,i along body z at each hub: thrust falls when the rotor climbs through the air."""

from __future__ import annotations

from flightstack.effects import expressions as x
from flightstack.effects.record import Axes, Effect, ParamSpec, Terms, Values
from flightstack.effects.row import Vec, hub_decay, place
from flightstack.jit import njit
from flightstack.types import F64

K_Z = place("induced_inflow", "k_z_kg_per_rad")


@njit
def hub_force(p: F64, speed_radps: float, hub_air: Vec) -> Vec:
    """Force (N, FRD) at one hub that moves through the air at `hub_air` (m/s, FRD)."""
    return (0.0, 0.0, -p[K_Z] * speed_radps * hub_air[2])


def decay_rate(p: F64) -> float:
    """Of speed or body rate (1/s), whichever is faster, with the rotors at full speed."""
    return float(p[K_Z] * hub_decay(p))


def jsbsim(k: Values, air: Axes, speed: str) -> Terms:
    """The force's three terms."""
    return None, None, x.times(-k[0], speed, air[2])


EFFECT = Effect(
    name="induced_inflow",
    params=(ParamSpec("k_z_kg_per_rad", "kg/rad", 0.0, 0.0, 0.1),),
    kind="force",
    place="hub force",
    physics=hub_force,
    equation="-k_z W_i v_az,i along body z at each hub",
    source="Svacha et al., ICUAS 2017: thrust falls with axial inflow, ~ W v_z",
    words="induced inflow",
    scale=lambda size: 0.05 * size.mass_kg / size.turning_radps,
    needs=("vel_ned_mps", "q_ned_frd", "motor"),
    manoeuvre="climbs and descents at 2 to 4 m/s",
    jsbsim=jsbsim,
    example={"k_z_kg_per_rad": 2e-4},
    decay_rate=decay_rate,
    told_by_force=True,
)
