"""Others' simulators: a PX4 flight whose physics the vehicle file holds, and Gazebo's Iris with its rotor drag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flightstack.vehicle import Vehicle, parse_vehicle, with_effects
from gap.check import check
from gap.compare import figures, noise_floor, residual
from gap.read import flight
from gap.records import Samples
from gap.refine import refine
from gap.track import track

IRIS = """
schema = "flightstack.vehicle/1"
name = "gazebo-iris"
[body]
mass_kg = 1.5
inertia_kgm2 = [0.029125, 0.029125, 0.055225]
[rotors]
position_m = [[0.13, 0.22, 0.0], [-0.13, -0.20, 0.0], [0.13, -0.22, 0.0], [-0.13, 0.20, 0.0]]
torque_ratio_m = [0.06, 0.06, -0.06, -0.06]
max_thrust_n = 7.0664          # 5.84e-6 N s^2 (1100 rad/s)^2
max_speed_radps = 1100.0
thrust_model_factor = 1.0
time_constant_s = 0.02
radius_m = 0.12
"""
DRAG = 1.75e-4
"""Of its model file: rotorDragCoefficient."""
pytestmark = pytest.mark.recorded


def usable(path: Path, vehicle: Vehicle, columns: str | None = None) -> Samples:
    samples = check(flight(path, vehicle, columns), vehicle).samples
    assert samples is not None
    return samples


def test_px4_s_own_simulator_and_its_vehicle_file_agree(recorded: Path) -> None:
    vehicle = parse_vehicle((recorded / "px4_sih.toml").read_text("utf-8"), "px4_sih.toml")
    samples = usable(recorded / "px4_sih_flight.ulg.gz", vehicle)
    mask = track(samples).usable
    before, floor = figures(vehicle, samples, mask), noise_floor(vehicle, samples, mask)
    assert before.one_step_mps2 is not None
    assert floor.one_step_mps2 is not None
    assert before.one_step_mps2 < 1.2 * floor.one_step_mps2
    assert before.one_step_radps2 is not None
    assert floor.one_step_radps2 is not None
    assert before.one_step_radps2 < 1.2 * floor.one_step_radps2
    heavier = with_effects(vehicle, {"payload": {"mass_kg": 0.15}})
    wrong = figures(heavier, samples, mask).one_step_mps2
    assert wrong is not None
    assert wrong > 1.2 * floor.one_step_mps2


def test_gazebo_s_rotor_drag_is_the_simulator_s(recorded: Path) -> None:
    believed = parse_vehicle(IRIS, "iris")
    samples = usable(recorded / "gazebo_iris_sitl_56s.csv.gz", believed, "gazebo_iris")
    mask = track(samples).usable
    dragged = with_effects(believed, {"rotor_drag": {"k_d_kg_per_rad": DRAG}})
    before, after = (np.std(residual(v, samples).y[mask, :2], axis=0) for v in (believed, dragged))
    assert np.all(after < 0.06 * before)
    start = with_effects(believed, {"rotor_drag": {"k_d_kg_per_rad": 1e-4}})
    got = refine(believed, start, [samples], [mask], ["rotor_drag"])
    assert got is not None
    assert got.parameters["rotor_drag"]["k_d_kg_per_rad"].estimate == pytest.approx(DRAG, rel=0.05)
