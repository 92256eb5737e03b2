"""How large a change of each parameter is one that matters on a given vehicle: for steps, priors and conditioning."""

from __future__ import annotations

from flightstack.types import STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle

_SPEED_MPS = 5.0
_RATE_RADPS = 2.0


def natural_scale(vehicle: Vehicle, effect: str, parameter: str) -> float:
    """A change of this parameter that moves the motion by some percent; positive, in the parameter's unit."""
    mass, weight = vehicle.total_mass_kg, vehicle.weight_n
    inertia = float(vehicle.inertia_kgm2.mean())
    arm = float((vehicle.rotors.position_m[:, :2] ** 2).sum(axis=1).mean()) ** 0.5
    hover = min(1.0, (vehicle.mass_kg * STANDARD_GRAVITY_MPS2 / vehicle.max_total_thrust_n) ** 0.5)
    turning = 4.0 * hover * vehicle.rotors.max_speed_radps  # sum of the rotors' speeds in hover
    own: dict[str, float] = {
        "payload": 0.05 * mass,
        "thrust_scale": 0.05,
        "thrust_curve": 0.1,
        "rotor_fault": 0.05,
        "com_offset": 0.05 * arm,
        "inertia": 0.05,
        "motor_lag": 0.005,
        "transport_delay": 0.005,
        "battery_sag": 0.01,
        "linear_drag": 0.05 * mass,
        "angular_damping": 0.5 * inertia,
        "rotor_drag": 0.05 * mass / turning,
        "induced_inflow": 0.05 * mass / turning,
        "parasitic_drag": 0.05 * mass / _SPEED_MPS,
        "translational_lift": 0.05 * weight / 4.0 / _SPEED_MPS**2,
        "blade_flapping": inertia / turning / _SPEED_MPS,
        "rotor_gyroscopic": 2.0 * inertia / turning / _RATE_RADPS,
        "ground_effect": 0.3,
        "vortex_ring": 0.1,
        "steady_wind": 1.0,
        "constant_force": 0.02 * weight,
        "turbulence": 0.5 if parameter == "sigma_mps" else 5.0,
        "slung_load": 0.05 * mass if parameter == "mass_kg" else 0.1,
        "accelerometer_bias": 0.1,
        "gyro_bias": 0.01,
        "attitude_misalignment": 0.01,
    }
    return float(own[effect])
