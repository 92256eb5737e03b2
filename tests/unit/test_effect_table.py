"""The table of effects against the names that the vehicle file's documentation promises, written out by hand."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from flightstack.effects import EFFECTS, PARAMS, check_effect
from flightstack.effects.row import P_EFFECTS, PLACES
from flightstack.types import InputError

DOCUMENTED = {
    "payload": {"mass_kg": 0},
    "thrust_scale": {"scale": 1},
    "thrust_curve": {"thrust_model_factor": None},
    "rotor_fault": {"rotor": None, "effectiveness": 1},
    "com_offset": {"x_m": 0, "y_m": 0, "z_m": 0},
    "inertia": {"scale_x": 1, "scale_y": 1, "scale_z": 1},
    "motor_lag": {"time_constant_s": None},
    "transport_delay": {"delay_s": 0},
    "battery_sag": {"thrust_loss_per_v": 0},
    "linear_drag": {"d_x_kgps": 0, "d_y_kgps": 0, "d_z_kgps": 0},
    "angular_damping": {"k_x_nms": 0, "k_y_nms": 0, "k_z_nms": 0},
    "rotor_drag": {"k_d_kg_per_rad": 0},
    "induced_inflow": {"k_z_kg_per_rad": 0},
    "parasitic_drag": {"c_x_kg_per_m": 0, "c_y_kg_per_m": 0, "c_z_kg_per_m": 0},
    "translational_lift": {"k_h_kg_per_m": 0},
    "blade_flapping": {"k_flap_nms2_per_rad_m": 0},
    "rotor_gyroscopic": {"rotor_inertia_kgm2": 0},
    "ground_effect": {"strength": 0},
    "vortex_ring": {"strength": 0},
    "steady_wind": {"north_mps": 0, "east_mps": 0, "down_mps": 0},
    "constant_force": {"north_n": 0, "east_n": 0, "down_n": 0},
    "turbulence": {"sigma_mps": 0, "length_m": None},
    "slung_load": {"mass_kg": 0, "length_m": None},
    "accelerometer_bias": {"x_mps2": 0, "y_mps2": 0, "z_mps2": 0},
    "gyro_bias": {"x_radps": 0, "y_radps": 0, "z_radps": 0},
    "attitude_misalignment": {"roll_rad": 0, "pitch_rad": 0, "yaw_rad": 0},
}


def test_the_table_has_the_documented_effects_parameters_and_null_values_in_order() -> None:
    table = {name: {p.name: p.null for p in EFFECTS[name].params} for name in EFFECTS if name in DOCUMENTED}
    assert table == DOCUMENTED
    assert list(table) == list(DOCUMENTED)
    assert [list(params) for params in table.values()] == [list(params) for params in DOCUMENTED.values()]


def test_every_parameter_has_a_slot_of_its_own_without_holes() -> None:
    slots = [PLACES[name, p.name] for name, spec in EFFECTS.items() for p in spec.params]
    assert sorted(slots) == list(range(P_EFFECTS, PARAMS))
    assert all(b - a == 1 for e in EFFECTS.values() for a, b in pairwise(PLACES[e.name, p.name] for p in e.params))


@pytest.mark.parametrize("name", EFFECTS)
def test_null_values_lie_within_the_allowed_range_and_are_null(name: str) -> None:
    spec = EFFECTS[name]
    nulls = {p.name: p.null for p in spec.params if p.null is not None}
    assert check_effect(name, nulls, "test") == nulls
    assert spec.is_null(nulls)
    assert spec.is_null({})
    assert spec.name == name


@pytest.mark.parametrize("name", EFFECTS)
def test_a_value_off_null_is_an_effect(name: str) -> None:
    spec = EFFECTS[name]
    required = {p.name: p.maximum for p in spec.params if p.required}
    for param in spec.params:
        if not param.required:
            values = {**required, param.name: param.maximum}
            assert check_effect(name, values, "test") == values
            assert not spec.is_null(values)


@pytest.mark.parametrize("name", EFFECTS)
def test_values_out_of_range_and_not_numbers_name_the_key(name: str) -> None:
    for param in EFFECTS[name].params:
        for bad in (param.minimum - 0.01, param.maximum + 0.01, math.nan, math.inf, -math.inf, "1", True, None, [1.0]):
            with pytest.raises(InputError, match=rf"^file: effects\.{name}\.{param.name} = .*must be in") as error:
                check_effect(name, {param.name: bad}, "file")
            assert "\n" not in str(error.value)


def test_a_rotor_is_a_whole_number() -> None:
    with pytest.raises(InputError, match=r"effects\.rotor_fault\.rotor = 1\.5 .*whole number"):
        check_effect("rotor_fault", {"rotor": 1.5, "effectiveness": 0.5}, "file")


@pytest.mark.parametrize(
    ("name", "values", "missing"),
    [
        ("rotor_fault", {"effectiveness": 0.5}, "rotor"),
        ("turbulence", {"sigma_mps": 1.0}, "length_m"),
        ("slung_load", {"mass_kg": 0.1}, "length_m"),
    ],
)
def test_an_effect_that_needs_a_second_value_asks_for_it(name: str, values: dict[str, float], missing: str) -> None:
    with pytest.raises(InputError, match=rf"effects\.{name}\.{missing} is missing"):
        check_effect(name, values, "file")


def test_unknown_effects_and_parameters_are_named() -> None:
    with pytest.raises(InputError, match=r"unknown effect effects\.wings; known are payload, .*"):
        check_effect("wings", {}, "file")
    with pytest.raises(InputError, match=r"unknown key effects\.payload\.mass_g; its parameters are mass_kg"):
        check_effect("payload", {"mass_g": 3.0}, "file")
    with pytest.raises(InputError, match=r"effects\.payload must be a table"):
        check_effect("payload", 3.0, "file")
