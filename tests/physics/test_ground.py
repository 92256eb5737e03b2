"""Standing, sliding, taking off and landing: the vehicle meets the ground and never blows up."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from fleet import QUAD, TYPICAL, matrix, quad, random_vehicle, set_random_state
from oracle import G
from scipy.spatial.transform import Rotation

from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_sim.plant import NativePlant

OFF = np.zeros(4)


def tilted(rpy_deg: tuple[float, float, float]) -> F64:
    return np.roll(Rotation.from_euler("ZYX", rpy_deg[::-1], degrees=True).as_quat(), 1)


def energy(plant: NativePlant, vehicle: Vehicle = QUAD) -> float:
    turning = 0.5 * np.sum(vehicle.inertia_kgm2 * plant.rate_frd_radps**2)
    moving = 0.5 * vehicle.mass_kg * plant.vel_ned_mps @ plant.vel_ned_mps
    return float(turning + moving - vehicle.mass_kg * G * plant.pos_ned_m[2])


def test_at_rest_it_stays_where_it_is_to_the_last_bit_of_a_micrometre() -> None:
    plant = NativePlant(QUAD, seed=0)
    plant.run(OFF, 60_000)
    assert plant.pos_ned_m == pytest.approx([0, 0, 0], abs=1e-9)
    assert plant.q_ned_frd == pytest.approx([1, 0, 0, 0], abs=1e-12)
    assert plant.specific_force_frd_mps2 == pytest.approx([0, 0, -G], abs=1e-9)
    assert plant.on_ground


@pytest.mark.parametrize("spin_up", [0.0, 0.5])
def test_a_tenth_of_its_weight_sideways_does_not_make_it_creep(spin_up: float) -> None:
    """Coulomb friction sticks, also with rotors that carry half the weight: less than a micrometre in a minute."""
    plant = NativePlant(quad(constant_force={"north_n": 0.1 * 1.2 * G, "east_n": 0.02}), seed=0)
    plant.run(np.full(4, spin_up * math.sqrt(1.2 * G / 26.4)), 60_000)
    assert plant.pos_ned_m[:2] == pytest.approx([0, 0], abs=1e-6)
    assert plant.q_ned_frd == pytest.approx([1, 0, 0, 0], abs=1e-5)
    if spin_up == 0.0:
        assert plant.specific_force_frd_mps2 == pytest.approx([0, 0, -G], abs=1e-6)


def test_sideways_beyond_friction_it_slides_with_the_difference() -> None:
    """F = 1.0 g against friction 0.7 g: 0.3 g remain."""
    plant = NativePlant(quad(constant_force={"north_n": 1.2 * G}), seed=0)
    plant.run(OFF, 1000)
    assert plant.vel_ned_mps[0] == pytest.approx(0.3 * G, rel=1e-3)


def test_a_sliding_vehicle_stops_after_the_distance_that_friction_says() -> None:
    plant = NativePlant(QUAD, seed=0)
    plant.vel_ned_mps[0] = 2.0
    plant.run(OFF, 2000)
    assert plant.pos_ned_m[0] == pytest.approx(2.0**2 / (2 * 0.7 * G), rel=1e-3)
    assert plant.vel_ned_mps == pytest.approx([0, 0, 0], abs=1e-9)


def test_an_unbalanced_reaction_torque_does_not_turn_a_standing_vehicle() -> None:
    plant = NativePlant(QUAD, seed=0)
    plant.run(np.array([0.3, 0.3, 0.2, 0.2]), 20_000)
    assert plant.q_ned_frd == pytest.approx([1, 0, 0, 0], abs=1e-6)
    assert plant.pos_ned_m[:2] == pytest.approx([0, 0], abs=1e-6)


def test_it_takes_off_when_thrust_exceeds_weight_and_not_before() -> None:
    plant = NativePlant(QUAD, seed=0)
    hover = math.sqrt(1.2 * G / 26.4)
    plant.run(np.full(4, 0.99 * hover), 2000)
    assert plant.on_ground
    assert plant.pos_ned_m[2] > -0.01
    plant.run(np.full(4, 1.1 * hover), 2000)
    assert not plant.on_ground
    assert plant.pos_ned_m[2] < -1.0


@pytest.mark.parametrize("ground", [True, False])
def test_the_ground_has_no_part_in_free_flight(ground: bool) -> None:
    """Half a metre up with all effects on: bit for bit the flight over no ground (ground effect knows the height)."""
    plants = [NativePlant(quad(**{**TYPICAL, "slung_load": {}}), seed=1, ground=each) for each in (ground, False)]
    for plant in plants:
        plant.pos_ned_m[2] = -0.5
        plant.vel_ned_mps[2] = -1.0
        plant.run(np.full(4, 0.9), 500)
    assert np.array_equal(plants[0]._state, plants[1]._state)


@pytest.mark.parametrize("sink_mps", [0.3, 1.0, 3.0, 10.0, 30.0])
@pytest.mark.parametrize("rpy_deg", [(0, 0, 0), (20, 0, 0), (10, -25, 100), (180, 0, 0), (95, 0, 0)])
def test_landings_lose_energy_and_end_at_rest(sink_mps: float, rpy_deg: tuple[float, float, float]) -> None:
    plant = NativePlant(QUAD, seed=0)
    plant.pos_ned_m[2] = -0.3
    plant.vel_ned_mps[:] = [0.5, -0.2, sink_mps]
    plant.q_ned_frd[:] = tilted(rpy_deg)
    plant.rate_frd_radps[:] = [0.2, -0.3, 0.5]
    highest = energy(plant) + 1e-6
    for _ in range(12_000):
        plant.step(OFF)
        assert energy(plant) <= highest  # the contacts' springs hold what is missing, never more
    assert np.isfinite(plant._state).all()
    assert plant.vel_ned_mps == pytest.approx([0, 0, 0], abs=1e-3)
    assert plant.rate_frd_radps == pytest.approx([0, 0, 0], abs=1e-2)
    assert plant.pos_ned_m[2] == pytest.approx(0.0, abs=0.01)
    assert abs(matrix(plant.q_ned_frd)[2, 2]) == pytest.approx(1.0, abs=1e-4)


def test_a_gentle_landing_hardly_sinks_in_and_its_push_is_bounded() -> None:
    plant = NativePlant(QUAD, seed=0)
    plant.pos_ned_m[2] = -0.1
    plant.vel_ned_mps[2] = 0.5
    deepest, hardest = 0.0, 0.0
    for _ in range(2000):
        plant.step(OFF)
        deepest = max(deepest, plant.pos_ned_m[2])
        hardest = max(hardest, -plant.specific_force_frd_mps2[2])
    assert deepest < 0.02
    assert 2 * G < hardest < 16 * G


def test_random_vehicles_dropped_in_random_attitudes_stay_finite_and_settle() -> None:
    """From a nano quadrotor to a carrier, with effects, at several steps; a light body on long arms too."""
    rng = np.random.default_rng(8)
    for k in range(40):
        vehicle = random_vehicle(rng, effects=k % 2 == 0)
        scale = 10.0 ** rng.uniform(-1.5, 1.0)
        inertia = vehicle.inertia_kgm2 * scale**2 * 10.0 ** rng.uniform(-1.0, 0.3)
        effects = {} if scale < 1.0 else vehicle.effects
        rotors = dataclasses.replace(vehicle.rotors, position_m=vehicle.rotors.position_m * min(scale, 8.0))
        vehicle = dataclasses.replace(
            vehicle, mass_kg=vehicle.mass_kg * scale, inertia_kgm2=inertia, rotors=rotors, effects=effects
        )
        plant = NativePlant(vehicle, seed=k, dt_us=int(rng.choice([500, 1000, 4000])))
        set_random_state(plant, rng, height_m=rng.uniform(0.5, 2.0))
        plant.run(OFF, 20_000_000 // plant.dt_us)
        assert np.isfinite(plant._state).all()
        assert abs(plant.pos_ned_m[2]) < 0.1
        assert np.linalg.norm(plant.rate_frd_radps) < 0.5
