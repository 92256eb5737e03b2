"""Vehicles, values and states that the physics tests share."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from flightstack.effects import EFFECTS
from flightstack.types import F64
from flightstack.vehicle import Vehicle, parse_vehicle, with_effects
from flightstack_sim.plant import NativePlant

FOLDER = Path(__file__).resolve().parents[2] / "flightstack/data/vehicles"
QUAD = parse_vehicle((FOLDER / "quad-x.toml").read_text(), "quad-x.toml")
HIGH = np.array([0.0, 0.0, -1000.0])
"""Far from the ground."""

TYPICAL = {name: dict(effect.example) for name, effect in EFFECTS.items()}
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
