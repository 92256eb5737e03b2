"""The slung load against the pendulum's closed form and the conservation laws of the pair."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fleet import QUAD, quad, without_thrust_or_ground
from oracle import G

from flightstack.effects.row import S_LOAD_DIR, S_LOAD_RATE
from flightstack.types import F64
from flightstack_sim.plant import NativePlant

OFF = np.zeros(4)
LENGTH = 0.8


def swing_aside(plant: NativePlant, angle_rad: float) -> None:
    plant._state[0, S_LOAD_DIR : S_LOAD_DIR + 3] = [math.sin(angle_rad), 0.0, math.cos(angle_rad)]


def test_under_a_fixed_point_it_swings_with_the_pendulums_period_and_damping() -> None:
    """A light load on a vehicle that stands on the ground: sqrt(g/L), amplitude exp(-0.02 w t)."""
    plant = NativePlant(quad(slung_load={"mass_kg": 0.02, "length_m": LENGTH}), seed=0)
    swing_aside(plant, 0.03)
    omega = math.sqrt(G / LENGTH)
    damped = omega * math.sqrt(1 - 0.02**2)
    direction = plant._state[0, S_LOAD_DIR : S_LOAD_DIR + 3]
    phase = math.atan2(0.02, math.sqrt(1 - 0.02**2))
    for k in range(1, 6001):
        plant.step(OFF)
        t = 1e-3 * k
        expected = 0.03 * math.exp(-0.02 * omega * t) * math.cos(damped * t - phase) / math.cos(phase)
        assert direction[0] == pytest.approx(expected, abs=3e-5)
    assert plant.vel_ned_mps == pytest.approx([0, 0, 0], abs=1e-3)


def free_pair(load_kg: float) -> NativePlant:
    """Vehicle and load in free air, held up against gravity by a constant force."""
    lift = {"down_n": -(1.2 + load_kg) * G}
    effects = {"slung_load": {"mass_kg": load_kg, "length_m": LENGTH}, "constant_force": lift}
    return without_thrust_or_ground(quad(**effects))


def pair_momentum(plant: NativePlant, load_kg: float) -> F64:
    rate = plant._state[0, S_LOAD_RATE : S_LOAD_RATE + 3]
    return 1.2 * plant.vel_ned_mps + load_kg * (plant.vel_ned_mps + LENGTH * rate)


def pair_energy(plant: NativePlant, load_kg: float) -> float:
    rate, direction = plant._state[0, S_LOAD_RATE : S_LOAD_RATE + 3], plant._state[0, S_LOAD_DIR : S_LOAD_DIR + 3]
    velocity = plant.vel_ned_mps + LENGTH * rate
    kinetic = 0.5 * 1.2 * plant.vel_ned_mps @ plant.vel_ned_mps + 0.5 * load_kg * velocity @ velocity
    height, load_height = -plant.pos_ned_m[2], -(plant.pos_ned_m[2] + LENGTH * direction[2])
    return float(kinetic + 1.2 * G * height + load_kg * G * load_height - (1.2 + load_kg) * G * height)


@pytest.mark.parametrize("load_kg", [0.05, 0.5, 2.0])
def test_a_free_pair_swings_faster_and_keeps_its_horizontal_momentum(load_kg: float) -> None:
    """Small swings of the free pair: w^2 = (g/L) (1 + m_l/m); the damping ratio grows by the root of that factor."""
    plant = free_pair(load_kg)
    swing_aside(plant, 0.02)
    heavier = 1 + load_kg / 1.2
    omega = math.sqrt(G / LENGTH * heavier)
    zeta = 0.02 * math.sqrt(heavier)
    damped = omega * math.sqrt(1 - zeta**2)
    crossings = []
    before = 0.02
    for k in range(1, 8001):
        plant.step(OFF)
        now = plant._state[0, S_LOAD_DIR]
        if before > 0 >= now or before < 0 <= now:
            crossings.append(1e-3 * (k - 1 + before / (before - now)))
        before = now
    assert np.mean(np.diff(crossings)) == pytest.approx(math.pi / damped, rel=1e-3)
    assert pair_momentum(plant, load_kg)[:2] == pytest.approx([0, 0], abs=1e-12)


def test_a_wild_swing_loses_energy_at_every_step_and_keeps_its_rod() -> None:
    plant = free_pair(0.5)
    plant._state[0, S_LOAD_DIR : S_LOAD_DIR + 3] = [1.0, 0.0, 0.0]
    plant._state[0, S_LOAD_RATE : S_LOAD_RATE + 3] = [0.0, 3.0, -2.0]
    momentum = pair_momentum(plant, 0.5)
    energy = start = pair_energy(plant, 0.5)
    for _ in range(10_000):
        plant.step(OFF)
        now = pair_energy(plant, 0.5)
        assert now <= energy + 1e-9 * start
        energy = now
        direction, rate = plant._state[0, S_LOAD_DIR : S_LOAD_DIR + 3], plant._state[0, S_LOAD_RATE : S_LOAD_RATE + 3]
        assert direction @ direction == pytest.approx(1.0, abs=1e-12)
        assert direction @ rate == pytest.approx(0.0, abs=1e-12)
    assert energy < start - 0.5
    assert pair_momentum(plant, 0.5) == pytest.approx(momentum, abs=1e-7)


def test_a_hanging_load_adds_its_weight_and_falls_with_the_vehicle() -> None:
    hovering = free_pair(0.3)
    hovering.run(OFF, 1000)
    assert hovering.vel_ned_mps == pytest.approx([0, 0, 0], abs=1e-12)
    assert hovering.specific_force_frd_mps2 == pytest.approx([0, 0, -G])
    falling = without_thrust_or_ground(quad(slung_load={"mass_kg": 0.3, "length_m": LENGTH}))
    falling.run(OFF, 1000)
    assert falling.vel_ned_mps == pytest.approx([0, 0, G], abs=1e-9)


def test_a_load_that_is_hung_in_flight_starts_straight_down_at_rest() -> None:
    plant = without_thrust_or_ground(QUAD)
    plant.vel_ned_mps[:] = [3.0, 0.0, 0.0]
    plant.set_effect("slung_load", {"mass_kg": 0.3, "length_m": LENGTH})
    assert plant._state[0, S_LOAD_DIR : S_LOAD_DIR + 3].tolist() == [0, 0, 1]
    plant.run(OFF, 10)
    assert plant.vel_ned_mps[0] == pytest.approx(3.0, abs=1e-9)
    plant.set_effect("slung_load", {})
    before = plant._state[0, S_LOAD_RATE : S_LOAD_RATE + 3].copy()
    plant.run(OFF, 10)
    assert np.array_equal(plant._state[0, S_LOAD_RATE : S_LOAD_RATE + 3], before)
