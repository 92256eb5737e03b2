"""A second, independent writing of the vehicle's physics: plain numpy, rotation matrices, one formula after another.

Written from the documented formulas of the effects, not from the plant; slow and simple on purpose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flightstack.types import F64
from flightstack.vehicle import Vehicle

G = 9.80665
RHO = 1.225


@dataclass
class State:
    pos: F64
    vel: F64
    rot: F64
    """Body to world, (3, 3)."""
    omega: F64
    u: F64
    wind: F64
    voltage: float


def values(vehicle: Vehicle, effect: str, *names: str, null: float = 0.0) -> F64:
    table = vehicle.effects.get(effect, {})
    return np.array([table.get(name, null) for name in names])


def value(vehicle: Vehicle, effect: str, name: str, null: float = 0.0) -> float:
    return float(vehicle.effects.get(effect, {}).get(name, null))


def rotor_thrusts(vehicle: Vehicle, s: State, arms: F64, hubs: F64, static: F64) -> F64:
    thrusts = np.zeros(4)
    for i in range(4):
        t = static[i] + value(vehicle, "translational_lift", "k_h_kg_per_m") * (hubs[i, 0] ** 2 + hubs[i, 1] ** 2)
        t = t * value(vehicle, "thrust_scale", "scale", 1.0)
        if value(vehicle, "rotor_fault", "rotor") == i + 1:
            t = t * value(vehicle, "rotor_fault", "effectiveness", 1.0)
        if vehicle.battery is not None:
            t = t * (1 - value(vehicle, "battery_sag", "thrust_loss_per_v") * (vehicle.battery.reference_v - s.voltage))
        radius = vehicle.rotors.radius_m
        height = max(-(s.pos + s.rot @ arms[i])[2], radius / 2)
        t = t / (1 - min(value(vehicle, "ground_effect", "strength") * (radius / 4 / height) ** 2, 0.75))
        if t > 0:
            v_h = np.sqrt(t / (2 * RHO * np.pi * radius**2))
            t = t * (1 - value(vehicle, "vortex_ring", "strength") * np.exp(-(((hubs[i, 2] / v_h - 1) / 0.5) ** 2)))
        thrusts[i] = t
    return thrusts


def accelerations(vehicle: Vehicle, s: State) -> tuple[F64, F64]:
    """Specific force (body) and angular acceleration (body) in free air, no slung load."""
    rotors = vehicle.rotors
    arms = rotors.position_m - values(vehicle, "com_offset", "x_m", "y_m", "z_m")
    inertia = vehicle.inertia_kgm2 * values(vehicle, "inertia", "scale_x", "scale_y", "scale_z", null=1.0)
    mass = vehicle.mass_kg + value(vehicle, "payload", "mass_kg")
    f = value(vehicle, "thrust_curve", "thrust_model_factor", rotors.thrust_model_factor)
    static = rotors.max_thrust_n * (f * s.u**2 + (1 - f) * s.u)
    speed = rotors.max_speed_radps * np.sqrt(static / rotors.max_thrust_n)
    air = s.rot.T @ (s.vel - s.wind)
    hubs = np.array([air + np.cross(s.omega, arm) for arm in arms])
    thrusts = rotor_thrusts(vehicle, s, arms, hubs, static)
    down = np.array([0.0, 0.0, 1.0])

    force = -values(vehicle, "linear_drag", "d_x_kgps", "d_y_kgps", "d_z_kgps") * air
    c = values(vehicle, "parasitic_drag", "c_x_kg_per_m", "c_y_kg_per_m", "c_z_kg_per_m")
    force = force - np.linalg.norm(air) * c * air
    force = force + s.rot.T @ values(vehicle, "constant_force", "north_n", "east_n", "down_n")
    torque = -values(vehicle, "angular_damping", "k_x_nms", "k_y_nms", "k_z_nms") * s.omega
    for i in range(4):
        k_d = value(vehicle, "rotor_drag", "k_d_kg_per_rad")
        k_z = value(vehicle, "induced_inflow", "k_z_kg_per_rad")
        at_hub = -k_d * speed[i] * np.array([hubs[i, 0], hubs[i, 1], 0.0]) - k_z * speed[i] * hubs[i, 2] * down
        at_hub = at_hub - thrusts[i] * down
        force = force + at_hub
        torque = torque + np.cross(arms[i], at_hub) + rotors.torque_ratio_m[i] * thrusts[i] * down
        k_flap = value(vehicle, "blade_flapping", "k_flap_nms2_per_rad_m")
        torque = torque + k_flap * speed[i] * np.cross(down, hubs[i])
        spin = -np.sign(rotors.torque_ratio_m[i])  # the air turns the body against the rotor's own rotation
        momentum = value(vehicle, "rotor_gyroscopic", "rotor_inertia_kgm2") * speed[i] * spin * down
        torque = torque - np.cross(s.omega, momentum)
    return force / mass, (torque - np.cross(s.omega, inertia * s.omega)) / inertia
