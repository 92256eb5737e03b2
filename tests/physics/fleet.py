"""Vehicles, values and states that the physics tests share."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from flightstack.types import F64
from flightstack.vehicle import Vehicle, parse_vehicle, with_effects
from flightstack_sim.plant import NativePlant

FOLDER = Path(__file__).resolve().parents[2] / "flightstack/data/vehicles"
QUAD = parse_vehicle((FOLDER / "quad-x.toml").read_text(), "quad-x.toml")
HIGH = np.array([0.0, 0.0, -1000.0])
"""Far from the ground."""

TYPICAL: dict[str, dict[str, float]] = {
    "payload": {"mass_kg": 0.3},
    "thrust_scale": {"scale": 0.9},
    "thrust_curve": {"thrust_model_factor": 0.4},
    "rotor_fault": {"rotor": 3, "effectiveness": 0.8},
    "com_offset": {"x_m": 0.02, "y_m": -0.015, "z_m": 0.03},
    "inertia": {"scale_x": 1.2, "scale_y": 0.9, "scale_z": 1.1},
    "motor_lag": {"time_constant_s": 0.05},
    "transport_delay": {"delay_s": 0.0125},
    "battery_sag": {"thrust_loss_per_v": 0.06},
    "linear_drag": {"d_x_kgps": 0.3, "d_y_kgps": 0.4, "d_z_kgps": 0.2},
    "angular_damping": {"k_x_nms": 0.01, "k_y_nms": 0.02, "k_z_nms": 0.03},
    "rotor_drag": {"k_d_kg_per_rad": 1.6e-4},
    "induced_inflow": {"k_z_kg_per_rad": 2e-4},
    "parasitic_drag": {"c_x_kg_per_m": 0.02, "c_y_kg_per_m": 0.03, "c_z_kg_per_m": 0.05},
    "translational_lift": {"k_h_kg_per_m": 0.008},
    "blade_flapping": {"k_flap_nms2_per_rad_m": 5e-6},
    "rotor_gyroscopic": {"rotor_inertia_kgm2": 5e-5},
    "ground_effect": {"strength": 1.0},
    "vortex_ring": {"strength": 0.4},
    "steady_wind": {"north_mps": 4.0, "east_mps": -3.0, "down_mps": 0.5},
    "constant_force": {"north_n": 1.2, "east_n": -0.4, "down_n": 0.2},
    "turbulence": {"sigma_mps": 1.5, "length_m": 20.0},
    "slung_load": {"mass_kg": 0.25, "length_m": 0.8},
    "accelerometer_bias": {"x_mps2": 0.1, "y_mps2": -0.2, "z_mps2": 0.3},
    "gyro_bias": {"x_radps": 0.01, "y_radps": 0.02, "z_radps": -0.03},
    "attitude_misalignment": {"roll_rad": 0.02, "pitch_rad": -0.03, "yaw_rad": 0.05},
}
"""One typical value for each effect."""


def quad(**effects: dict[str, float]) -> Vehicle:
    return with_effects(QUAD, effects)


def without_thrust_or_ground(vehicle: Vehicle = QUAD, *, dt_us: int = 1000, seed: int = 0) -> NativePlant:
    plant = NativePlant(vehicle, seed=seed, dt_us=dt_us, ground=False)
    plant.pos_ned_m[:] = HIGH
    return plant


def set_random_state(plant: NativePlant, rng: np.random.Generator, *, height_m: float = 1000.0) -> None:
    plant.pos_ned_m[:] = [*rng.normal(size=2), -height_m]
    plant.vel_ned_mps[:] = rng.normal(size=3) * 4.0
    plant.q_ned_frd[:] = random_quaternion(rng)
    plant.rate_frd_radps[:] = rng.normal(size=3) * 2.0
    plant.motor_u[:] = rng.uniform(0.2, 0.9, 4)


def random_quaternion(rng: np.random.Generator) -> F64:
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def matrix(q: F64) -> F64:
    """Rotation matrix of a (w, x, y, z) quaternion, by SciPy."""
    return np.asarray(Rotation.from_quat(np.roll(q, -1)).as_matrix())


def random_vehicle(rng: np.random.Generator, *, effects: bool = True) -> Vehicle:
    """A vehicle of random size with a random choice of effects round their typical values."""
    size = rng.uniform(0.6, 1.6)
    inertia = QUAD.inertia_kgm2 * size**2 * rng.uniform(0.9, 1.1)
    rotors = dataclasses.replace(
        QUAD.rotors,
        position_m=QUAD.rotors.position_m * size,
        time_constant_s=rng.uniform(0.0, 0.08),
        thrust_model_factor=rng.uniform(),
    )
    vehicle = dataclasses.replace(QUAD, mass_kg=rng.uniform(0.9, 2.0), inertia_kgm2=inertia, rotors=rotors)
    chosen = {name: table for name, table in TYPICAL.items() if effects and rng.uniform() < 0.5}
    return with_effects(vehicle, chosen)
