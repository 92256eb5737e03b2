"""JSBSim's own F450: what the vehicle file says of it is what JSBSim ships and does."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fleet import FOLDER

from flightstack.types import F64
from flightstack.vehicle import parse_vehicle, scaled, with_effects
from flightstack_sim.jsbsim.plant import JsbsimPlant

jsbsim = pytest.importorskip("jsbsim", reason="no JSBSim here (wheels exist for x86-64 only)")

pytestmark = pytest.mark.jsbsim
F450 = parse_vehicle((FOLDER / "f450.toml").read_text(), "f450.toml")
G = 9.8069


def shipped(section: str) -> ElementTree.Element:
    folder = Path(jsbsim.get_default_root_dir()) / "aircraft" / "F450"
    return ElementTree.parse(folder / f"{section}.xml").getroot()


def number(element: ElementTree.Element, path: str) -> float:
    found = element.find(path)
    assert found is not None
    return float(found.text or "")


def run_up(command: float, seconds: float = 1.0) -> JsbsimPlant:
    """A plant in the air whose rotors have taken on a command; it has hardly begun to move."""
    plant = JsbsimPlant(F450, seed=0)
    plant.place(pos_ned_m=(0.0, 0.0, -50.0), motor_u=(command,) * 4)
    return plant


def test_mass_inertia_and_rotor_places_are_the_shipped_ones() -> None:
    mass = shipped("Mass")
    assert number(mass, "emptywt") == F450.mass_kg
    assert [number(mass, f"i{axis}{axis}") for axis in "xyz"] == F450.inertia_kgm2.tolist()
    places = [
        (-number(engine, "thruster/location/x"), number(engine, "thruster/location/y"))
        for engine in shipped("Propulsion").findall("engine")
    ]
    assert places == [tuple(row[:2]) for row in F450.rotors.position_m.tolist()]


@pytest.mark.parametrize("command", [0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
def test_the_file_s_thrust_curve_is_jsbsim_s_within_what_it_says(command: float) -> None:
    rotors, truth = F450.rotors, run_up(command).truth()
    f = rotors.thrust_model_factor
    share = f * command**2 + (1 - f) * command
    assert truth.rotor_thrust_n == pytest.approx((rotors.max_thrust_n * share,) * 4, abs=0.14)


def test_a_small_step_of_command_takes_the_file_s_time() -> None:
    plant, first = run_up(0.45), run_up(0.45).truth().rotor_thrust_n[0]
    last = run_up(0.5).truth().rotor_thrust_n[0]
    thrust = np.empty(200)
    for k in range(len(thrust)):
        plant.step(np.full(4, 0.5))
        thrust[k] = (plant.truth().rotor_thrust_n[0] - first) / (last - first)
    assert 1e-3 * (np.argmax(thrust > 1 - math.exp(-1)) + 1) == pytest.approx(F450.rotors.time_constant_s, rel=0.1)


@pytest.mark.parametrize(
    ("signs", "axis"), [((-1, 1, 1, -1), 0), ((1, -1, 1, -1), 1), ((1, 1, -1, -1), 2)], ids=["roll", "pitch", "yaw"]
)
def test_each_pair_of_rotors_turns_it_the_way_the_file_says(signs: tuple[int, ...], axis: int) -> None:
    """Rates after 0.1 s on the file's numbers, which leave out what moving air does to a propeller: within 15 %."""
    plant = run_up(0.45)
    before = np.array(plant.truth().rotor_thrust_n)
    plant.run(0.45 + 0.02 * np.array(signs), 100)
    rotors = F450.rotors
    x, y = rotors.position_m[:, 0], rotors.position_m[:, 1]
    gain = np.stack([-y, x, rotors.torque_ratio_m])  # N m of each newton
    assert np.sign(plant.rate_frd_radps[axis]) == 1
    others = [i for i in range(3) if i != axis]
    assert np.abs(plant.rate_frd_radps[others]).max() < 0.2 * plant.rate_frd_radps[axis]
    if axis < 2:
        gained = np.array(plant.truth().rotor_thrust_n) - before
        lag = F450.rotors.time_constant_s
        share = 0.1 - lag * -math.expm1(-0.1 / lag)
        expected = (gain @ gained)[axis] / -math.expm1(-0.1 / lag) * share / F450.inertia_kgm2[axis]
        assert plant.rate_frd_radps[axis] == pytest.approx(expected, rel=0.15)


def test_it_stands_on_its_feet_at_zero_height_and_stays_in_a_side_force() -> None:
    plant = JsbsimPlant(with_effects(F450, {"constant_force": {"north_n": 1.0}}), seed=0)
    plant.run(np.zeros(4), 3000)
    assert plant.on_ground
    assert plant.pos_ned_m == pytest.approx([0, 0, 0], abs=2e-3)
    assert np.linalg.norm(plant.specific_force_frd_mps2) == pytest.approx(G, rel=0.01)


def hover_force(plant: JsbsimPlant) -> F64:
    plant.run(np.full(4, 0.45), 20)
    return plant.specific_force_frd_mps2.copy()


def test_mass_and_payload_weigh_on_it_and_a_change_in_flight_keeps_its_state() -> None:
    own, heavy = run_up(0.45), JsbsimPlant(scaled(F450, mass_ratio=1.4), seed=0)
    heavy.place(pos_ned_m=(0.0, 0.0, -50.0), motor_u=(0.45,) * 4)
    assert hover_force(own)[2] / hover_force(heavy)[2] == pytest.approx(1.4, rel=5e-3)
    before = own.truth()
    own.set_effect("payload", {"mass_kg": 0.56})
    after = own.truth()
    assert after.pos_ned_m == pytest.approx(before.pos_ned_m, abs=1e-6)
    assert after.rotor_thrust_n == pytest.approx(before.rotor_thrust_n, rel=0.01)
    assert hover_force(own)[2] == pytest.approx(hover_force(heavy)[2], rel=0.01)
