"""The effects' physics: one file per effect, one table that joins each to its spec, with where it comes from.

Which function of an effect's file acts depends on its kind (`flightstack.effect_specs.Kind`); `sim.parameters.derive`
and `sim.rigid_body` call them all, in the order docs/physics.md gives.  Compiled code can't loop over a table of
functions: the calls are written out there, and a test proves for every row of this table that it acts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from flightstack.effect_specs import EFFECT_SPECS, EffectSpec
from flightstack_sim.effects import (
    accelerometer_bias,
    angular_damping,
    attitude_misalignment,
    battery_sag,
    blade_flapping,
    com_offset,
    constant_force,
    ground_effect,
    gyro_bias,
    induced_inflow,
    inertia,
    linear_drag,
    motor_lag,
    parasitic_drag,
    payload,
    rotor_drag,
    rotor_fault,
    rotor_gyroscopic,
    slung_load,
    steady_wind,
    thrust_curve,
    thrust_scale,
    translational_lift,
    transport_delay,
    turbulence,
    vortex_ring,
)


@dataclass(frozen=True, slots=True)
class Effect:
    """One effect: its spec, the function that is its physics and the literature (or reasoning) behind it."""

    spec: EffectSpec
    physics: Callable[..., Any]
    source: str


def _row(name: str, physics: Callable[..., Any], source: str) -> tuple[str, Effect]:
    return name, Effect(EFFECT_SPECS[name], physics, source)


EFFECTS: dict[str, Effect] = dict(
    (
        _row("payload", payload.change, "Newton's second law; point mass at the CoM, so the inertia stays"),
        _row(
            "thrust_scale", thrust_scale.change, "Leishman, Principles of Helicopter Aerodynamics, 2006, 3.2: T ~ rho"
        ),
        _row("thrust_curve", thrust_curve.change, "PX4 user guide, parameter THR_MDL_FAC: thrust = f u^2 + (1 - f) u"),
        _row(
            "rotor_fault", rotor_fault.change, "Mueller and D'Andrea, ICRA 2014: loss of effectiveness of a propeller"
        ),
        _row("com_offset", com_offset.change, "lever arms of the parallel forces about the true CoM (statics)"),
        _row("inertia", inertia.change, "Euler's equations, principal axes along the body's"),
        _row(
            "motor_lag", motor_lag.change, "Mahony, Kumar, Corke, IEEE Robot. Autom. Mag. 2012: first-order rotor speed"
        ),
        _row("transport_delay", transport_delay.change, "dead time of a digital link with a hold of one step"),
        _row(
            "battery_sag", battery_sag.factor, "Bauersfeld and Scaramuzza, RA-L 2022: rotor speed follows the voltage"
        ),
        _row("linear_drag", linear_drag.force, "Faessler, Franchi, Scaramuzza, RA-L 2018, eq. 4"),
        _row("angular_damping", angular_damping.torque, "Faessler, Franchi, Scaramuzza, RA-L 2018, eq. 5, diagonal"),
        _row(
            "rotor_drag", rotor_drag.hub_force, "Martin and Salaun, ICRA 2010; Svacha et al., ICUAS 2017: H-force ~ W v"
        ),
        _row(
            "induced_inflow",
            induced_inflow.hub_force,
            "Svacha et al., ICUAS 2017: thrust falls with axial inflow, ~ W v_z",
        ),
        _row(
            "parasitic_drag",
            parasitic_drag.force,
            "Hoerner, Fluid-Dynamic Drag, 1965: F = rho/2 c A v^2 of a bluff body",
        ),
        _row(
            "translational_lift",
            translational_lift.added_thrust,
            "Svacha et al., ICUAS 2017; Foerster, ETH 2015: k_h v_h^2",
        ),
        _row(
            "blade_flapping",
            blade_flapping.torque,
            "Hoffmann et al., AIAA 2007-6461; Mahony et al. 2012, blade flapping",
        ),
        _row(
            "rotor_gyroscopic", rotor_gyroscopic.momentum, "Bouabdallah, EPFL thesis 3727, 2007: propeller gyro effect"
        ),
        _row("ground_effect", ground_effect.factor, "Cheeseman and Bennett, ARC R&M 3021, 1955"),
        _row("vortex_ring", vortex_ring.factor, "Leishman 2006, 2.13.6: loss of thrust centred at w = v_h (bell fit)"),
        _row("steady_wind", steady_wind.velocity, "Galilean: forces of the air depend on the velocity relative to it"),
        _row("constant_force", constant_force.force, "Wang, Theodorou, Egerstedt, ICRA 2018: the simulated 0.1 g wind"),
        _row("turbulence", turbulence.gust, "MIL-F-8785C, 3.7: Dryden spectra, one sigma and length for all axes"),
        _row("slung_load", slung_load.pull, "Sreenath, Lee, Kumar, CDC 2013: quadrotor with a point mass on a rod"),
        _row("accelerometer_bias", accelerometer_bias.bias, "IEEE Std 1293: bias of the measured specific force"),
        _row("gyro_bias", gyro_bias.bias, "IEEE Std 952: bias of the measured rate"),
        _row("attitude_misalignment", attitude_misalignment.rotation, "mounting error between body and estimator axes"),
    )
)
"""Name -> effect, in the order of EFFECT_SPECS."""
