"""Blade flapping: the disk tilts back in edgewise flow; torque k W_i (e_z x v_a,i) of each rotor."""

from __future__ import annotations

from flightstack.effects import expressions as x
from flightstack.effects.record import SPEED_MPS, Axes, Effect, ParamSpec, Terms, Values
from flightstack.effects.row import Vec, place
from flightstack.jit import njit
from flightstack.types import F64

K_FLAP = place("blade_flapping", "k_flap_nms2_per_rad_m")


@njit
def torque(p: F64, speed_radps: float, hub_air: Vec) -> Vec:
    """Torque (N m, FRD) of one rotor; forward flight with k > 0 pitches up."""
    k = p[K_FLAP] * speed_radps
    return (-k * hub_air[1], k * hub_air[0], 0.0)


def jsbsim(k: Values, air: Axes, speed: str) -> Terms:
    """The torque's three terms."""
    return x.times(-k[0], speed, air[1]), x.times(k[0], speed, air[0]), None


EFFECT = Effect(
    name="blade_flapping",
    params=(ParamSpec("k_flap_nms2_per_rad_m", "N m s^2/(rad m)", 0.0, -0.01, 0.01),),
    kind="torque",
    place="hub torque",
    physics=torque,
    equation="k sum_i W_i (e_z x v_a,i): k > 0 pitches up in forward flight",
    source="Hoffmann et al., AIAA 2007-6461; Mahony et al. 2012, blade flapping",
    words="blade flapping",
    scale=lambda size: size.inertia_kgm2 / size.turning_radps / SPEED_MPS,
    needs=("vel_ned_mps", "q_ned_frd", "motor"),
    manoeuvre="straight runs at 3 to 6 m/s on two opposite headings",
    jsbsim=jsbsim,
    example={"k_flap_nms2_per_rad_m": 5e-6},
)
