"""Vehicle files: read, refused in one line, written back."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.effects import EFFECTS
from flightstack.types import InputError
from flightstack.vehicle import parse_vehicle, scaled, vehicle_to_toml, with_effects

VEHICLES = Path(__file__).resolve().parents[2] / "flightstack/data/vehicles"
EXAMPLE = """
schema = "flightstack.vehicle/1"
name = "quad-x"
[body]
mass_kg = 1.2
inertia_kgm2 = [0.012, 0.013, 0.022]
[rotors]
position_m = [[0.13, 0.16, 0.0], [-0.13, -0.16, 0.0], [0.13, -0.16, 0.0], [-0.13, 0.16, 0.0]]
torque_ratio_m = [0.015, 0.015, -0.015, -0.015]
max_thrust_n = 6.6
max_speed_radps = 1000.0
thrust_model_factor = 1.0
time_constant_s = 0.02
radius_m = 0.12
[battery]
reference_v = 16.6
full_v = 16.8
empty_v = 13.2
capacity_as = 18000
resistance_ohm = 0.02
[effects.rotor_drag]
k_d_kg_per_rad = 1.6e-4
"""
CRAZYFLIE = """
schema = "flightstack.vehicle/1"
name = "crazyflie"
[body]
mass_kg = 0.027
inertia_kgm2 = [1.4e-5, 1.4e-5, 2.17e-5]
[rotors]
position_m = [[0.0325, 0.0325, 0], [-0.0325, -0.0325, 0], [0.0325, -0.0325, 0], [-0.0325, 0.0325, 0]]
torque_ratio_m = [0.006, 0.006, -0.006, -0.006]
max_thrust_n = 0.15
max_speed_radps = 2600
thrust_model_factor = 1
time_constant_s = 0.03
radius_m = 0.0225
"""
CARRIER = (
    CRAZYFLIE.replace("0.027", "50").replace("[1.4e-5, 1.4e-5, 2.17e-5]", "[8, 8, 15]").replace("0.0325", "0.9")
).replace("0.15", "300.0")


def test_the_documented_example_reads_as_written() -> None:
    vehicle = parse_vehicle(EXAMPLE, "example")
    assert vehicle.name == "quad-x"
    assert vehicle.mass_kg == 1.2
    assert vehicle.inertia_kgm2.tolist() == [0.012, 0.013, 0.022]
    assert vehicle.rotors.position_m.tolist()[1] == [-0.13, -0.16, 0.0]
    assert vehicle.rotors.torque_ratio_m.tolist() == [0.015, 0.015, -0.015, -0.015]
    assert vehicle.max_total_thrust_n == pytest.approx(26.4)
    assert vehicle.battery is not None
    assert vehicle.battery.capacity_as == 18000.0
    assert dict(vehicle.effects["rotor_drag"]) == {"k_d_kg_per_rad": 1.6e-4}
    assert vehicle.weight_n == pytest.approx(1.2 * 9.80665)


@pytest.mark.parametrize("text", [EXAMPLE, CRAZYFLIE, CARRIER])
def test_a_vehicle_written_out_reads_back_equal(text: str) -> None:
    vehicle = parse_vehicle(text, "first")
    again = parse_vehicle(vehicle_to_toml(vehicle), "second")
    assert again == vehicle
    assert hash(again) == hash(vehicle)
    assert again != scaled(vehicle, mass_ratio=1.1)
    assert again != with_effects(vehicle, {"thrust_scale": {"scale": 0.9}})


@pytest.mark.parametrize("path", sorted(VEHICLES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_vehicle_file_that_ships_reads_and_bears_its_file_name(path: Path) -> None:
    assert parse_vehicle(path.read_text(), path.name).name == path.stem


def test_the_default_vehicle_is_the_documented_example_without_effects() -> None:
    default = parse_vehicle((VEHICLES / "quad-x.toml").read_text(), "quad-x.toml")
    assert default == dataclasses.replace(parse_vehicle(EXAMPLE, "example"), effects={})


@given(st.text(min_size=1, max_size=30).filter(str.isprintable), st.floats(0.1, 90.0), st.floats(0.0, 1.0))
def test_names_and_numbers_survive_the_round_trip_bit_for_bit(name: str, mass: float, factor: float) -> None:
    vehicle = parse_vehicle(EXAMPLE, "example")
    rotors = dataclasses.replace(vehicle.rotors, thrust_model_factor=factor)
    changed = dataclasses.replace(vehicle, name=name, mass_kg=mass, rotors=rotors)
    again = parse_vehicle(vehicle_to_toml(changed), "again")
    assert (again.name, again.mass_kg, again.rotors.thrust_model_factor) == (name, mass, factor)


def test_arrays_of_a_vehicle_cannot_be_written_to() -> None:
    vehicle = parse_vehicle(EXAMPLE, "example")
    for array in (vehicle.inertia_kgm2, vehicle.rotors.position_m, vehicle.rotors.torque_ratio_m):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(TypeError):
        vehicle.effects["rotor_drag"]["k_d_kg_per_rad"] = 2.0  # type: ignore[index]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("mass_kg = 1.2", "mass_g = 1200", r"unknown key body\.mass_g"),
        ("mass_kg = 1.2", "", r"body\.mass_kg is missing; give it in 0\.005 to 100 kg"),
        ("mass_kg = 1.2", "mass_kg = 0", r"body\.mass_kg = 0 is not allowed; it must be 0\.005 to 100 kg"),
        ("mass_kg = 1.2", "mass_kg = -1.2", r"body\.mass_kg"),
        ("mass_kg = 1.2", "mass_kg = nan", r"body\.mass_kg = nan"),
        ("mass_kg = 1.2", "mass_kg = inf", r"body\.mass_kg = inf"),
        ("mass_kg = 1.2", 'mass_kg = "1.2 kg"', r"body\.mass_kg = '1.2 kg'"),
        ("mass_kg = 1.2", "mass_kg = true", r"body\.mass_kg = True"),
        ("mass_kg = 1.2", "mass_kg = [1.2]", r"body\.mass_kg"),
        ("[0.012, 0.013, 0.022]", "[0.012, 0.013]", r"body\.inertia_kgm2 .*a list of 3 numbers"),
        ("[0.012, 0.013, 0.022]", "[0.012, 0.013, nan]", r"body\.inertia_kgm2"),
        ("[0.012, 0.013, 0.022]", "[0.012, 0.013, 0.030]", r"body\.inertia_kgm2 .*triangle inequality.*Izz"),
        ("[0.012, 0.013, 0.022]", "0.012", r"body\.inertia_kgm2"),
        (", [-0.13, 0.16, 0.0]]", "]", r"rotors\.position_m .*4 lists of 3 numbers"),
        ("[-0.13, 0.16, 0.0]]", "[-0.13, 0.16]]", r"rotors\.position_m"),
        ("[-0.13, 0.16, 0.0]]", "[-130, 160, 0]]", r"rotors\.position_m .*each -3 to 3 m"),
        ("[0.015, 0.015, -0.015, -0.015]", "[0.015, 0.015, -0.015]", r"rotors\.torque_ratio_m"),
        ("max_thrust_n = 6.6", "max_thrust_n = 0", r"rotors\.max_thrust_n"),
        ("thrust_model_factor = 1.0", "thrust_model_factor = 1.01", r"rotors\.thrust_model_factor .*0 to 1"),
        ("time_constant_s = 0.02", "time_constant_s = 20", r"rotors\.time_constant_s .*0 to 1 s"),
        ("radius_m = 0.12", "radius_m = 0.12\nblades = 2", r"unknown key rotors\.blades"),
        ("empty_v = 13.2", "empty_v = 16.8", r"battery\.empty_v = 16\.8 must lie below"),
        ("capacity_as = 18000", "capacity_ah = 5", r"unknown key battery\.capacity_ah"),
        ("resistance_ohm = 0.02", "", r"battery\.resistance_ohm is missing"),
        ("[effects.rotor_drag]", "[effects.rotor_dragg]", r"unknown effect effects\.rotor_dragg"),
        ("[body]", "[body]\n[wings]", r"unknown key wings"),
        ('name = "quad-x"', "", r"name = None"),
        ('name = "quad-x"', 'name = "a\\nb"', r"name = 'a\\nb'"),
        ("vehicle/1", "vehicle/2", r'schema = .*this version reads "flightstack\.vehicle/1"'),
        ("[body]", "[body", r"not valid TOML"),
        ("[rotors]", "[rotor]", r"unknown key rotor"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line_that_names_file_and_key(old: str, new: str, says: str) -> None:
    assert old in EXAMPLE
    with pytest.raises(InputError, match=rf"^my\.toml: .*{says}|^my\.toml: {says}") as error:
        parse_vehicle(EXAMPLE.replace(old, new, 1), "my.toml")
    assert "\n" not in str(error.value)


def test_a_table_in_place_of_tables_is_refused() -> None:
    head = 'schema = "flightstack.vehicle/1"\nname = "x"\n'
    for text, says in (("body = 3", r"\[body\] is missing"), ("effects = 3", "body"), ("", r"\[body\] is missing")):
        with pytest.raises(InputError, match=says):
            parse_vehicle(head + text, "my.toml")


def test_effects_are_replaced_by_name_and_kept_in_table_order() -> None:
    vehicle = parse_vehicle(EXAMPLE, "example")
    changed = with_effects(vehicle, {"thrust_scale": {"scale": 0.9}, "rotor_drag": {"k_d_kg_per_rad": 2e-4}})
    assert list(changed.effects) == ["thrust_scale", "rotor_drag"]
    assert changed.effects["rotor_drag"]["k_d_kg_per_rad"] == 2e-4
    assert vehicle.effects["rotor_drag"]["k_d_kg_per_rad"] == 1.6e-4
    assert all(
        list(with_effects(vehicle, {name: {}}).effects) == sorted({name, "rotor_drag"}, key=list(EFFECTS).index)
        for name in EFFECTS
    )


def test_payload_counts_in_the_weight_and_may_not_eat_the_vehicle() -> None:
    vehicle = parse_vehicle(EXAMPLE, "example")
    assert with_effects(vehicle, {"payload": {"mass_kg": 0.3}}).weight_n == pytest.approx(1.5 * 9.80665)
    assert with_effects(vehicle, {"payload": {"mass_kg": -0.2}}).total_mass_kg == pytest.approx(1.0)
    with pytest.raises(InputError, match=r"payload\.mass_kg = -1\.2 leaves 0 kg; it must be at least -1\.14 kg"):
        with_effects(vehicle, {"payload": {"mass_kg": -1.2}})


def test_battery_sag_needs_a_battery_unless_it_is_null() -> None:
    bare = dataclasses.replace(parse_vehicle(EXAMPLE, "example"), battery=None)
    assert with_effects(bare, {"battery_sag": {"thrust_loss_per_v": 0.0}}).battery is None
    with pytest.raises(InputError, match=r"battery_sag needs a \[battery\]"):
        with_effects(bare, {"battery_sag": {"thrust_loss_per_v": 0.05}})


def test_scaling_the_mass_changes_the_mass_alone() -> None:
    vehicle = parse_vehicle(EXAMPLE, "example")
    heavy = scaled(vehicle, mass_ratio=1.4)
    assert heavy.mass_kg == pytest.approx(1.68)
    assert np.array_equal(heavy.inertia_kgm2, vehicle.inertia_kgm2)
    for bad in (0.0, -1.0, float("nan"), 1e6):
        with pytest.raises(InputError, match="mass_kg"):
            scaled(vehicle, mass_ratio=bad)
