"""A log of another vehicle is told from one of this vehicle with effects: by all that a body and its motors are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shipped import load_vehicle

from benchmarks import gap_draw
from flightstack.gap.likeness import same_flight, vehicle_mismatch
from flightstack.gap.records import Estimate, IdentifiedEffect
from flightstack.vehicle import Vehicle, with_effects
from tests.gap_flights import as_samples, fly, hidden, quad, wander

Effects = dict[str, dict[str, float]]
BODY = ("payload", "thrust_scale", "inertia", "motor_lag")


def said(believed: Vehicle, effects: Effects, *, unexplained: bool = False) -> str:
    found = [
        IdentifiedEffect(name, {p: Estimate(0.0, x, x, x) for p, x in values.items()}, -1e3, 0.5, 0.0)
        for name, values in effects.items()
    ]
    return vehicle_mismatch(believed, with_effects(believed, effects), found, unexplained=unexplained)


def as_effects(flew: Vehicle, file: Vehicle) -> Effects:
    """What of the table makes one file's vehicle fly as the other's: the files' own numbers."""
    per_kg = (flew.max_total_thrust_n / flew.mass_kg) / (file.max_total_thrust_n / file.mass_kg)
    arms = [np.abs(v.rotors.position_m[:, :2]).mean(axis=0)[::-1] * v.max_total_thrust_n for v in (flew, file)]
    torque = [
        [*arm, abs(v.rotors.torque_ratio_m[0]) * v.max_total_thrust_n]
        for arm, v in zip(arms, (flew, file), strict=True)
    ]
    turning = [np.array(t) / v.inertia_kgm2 for t, v in zip(torque, (flew, file), strict=True)]
    scale = per_kg * turning[1] / turning[0]
    return {
        "thrust_scale": {"scale": per_kg},
        "inertia": {f"scale_{axis}": float(scale[i]) for i, axis in enumerate("xyz")},
        "motor_lag": {"time_constant_s": flew.rotors.time_constant_s},
    }


@pytest.mark.parametrize(("flew", "file"), [("f450", "quad-x"), ("quad-x", "f450")])
def test_a_carrier_and_a_light_quadrotor_are_not_each_other(flew: str, file: str) -> None:
    text = said(load_vehicle(file), as_effects(load_vehicle(flew), load_vehicle(file)))
    assert "thrust for its mass" in text


def test_a_body_twice_as_hard_to_turn_is_another_where_something_is_left_unexplained() -> None:
    effects: Effects = {
        "payload": {"mass_kg": 0.23},
        "inertia": {"scale_x": 1.7, "scale_y": 2.1, "scale_z": 2.1},
    }
    assert said(load_vehicle("quad-x"), effects, unexplained=True)
    assert not said(load_vehicle("quad-x"), effects)


@pytest.mark.parametrize("seed", range(40))
def test_what_the_blind_flights_hide_together_leaves_a_vehicle_the_file_s(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vehicle = gap_draw.vehicle(rng, drag=False)
    effects = {name: gap_draw.EFFECTS[name](rng, vehicle) for name in BODY}
    assert said(vehicle, effects, unexplained=True) == ""


def test_one_thing_far_off_is_named_and_not_refused() -> None:
    quad = load_vehicle("quad-x")
    for effects in ({"thrust_scale": {"scale": 0.5}}, {"payload": {"mass_kg": quad.mass_kg}}):
        assert said(quad, effects, unexplained=True) == ""
    assert said(quad, {"inertia": {"scale_x": 2.5, "scale_y": 2.5, "scale_z": 2.5}}, unexplained=True) == ""


@pytest.mark.parametrize("unexplained", [False, True])
@pytest.mark.parametrize(("mass", "turn", "lag"), [(1.3, 1.49, 3.0), (0.7, 1 / 1.49, 1 / 3), (1.3, 1 / 1.49, 3.0)])
def test_a_file_whose_every_number_is_as_rough_as_it_may_be_is_still_the_vehicles(
    mass: float, turn: float, lag: float, unexplained: bool
) -> None:
    """Mass and thrust by 30 %, inertia by half, lag by three, all at once: one of 106 such flights was refused."""
    quad = load_vehicle("quad-x")
    effects: Effects = {
        "payload": {"mass_kg": (mass - 1.0) * quad.mass_kg} if mass > 1.0 else {"mass_kg": 0.0},
        "thrust_scale": {"scale": 0.7 if mass > 1.0 else 1.3 / 0.7},
        "inertia": {f"scale_{axis}": turn for axis in "xyz"},
        "motor_lag": {"time_constant_s": lag * quad.rotors.time_constant_s},
    }
    assert said(quad, effects, unexplained=unexplained) == ""


def test_a_flight_recorded_twice_is_told_from_another_one_of_the_same_path() -> None:
    one, again, slower = (
        as_samples(fly(quad(), quad(), wander(), seconds=8.0, seed=seed, every_ms=every))
        for seed, every in ((1, 8), (2, 8), (1, 16))
    )
    assert same_flight(one, one)
    assert same_flight(one, slower)
    assert same_flight(slower, one)
    assert not same_flight(one, again)


def test_a_simulators_noise_that_comes_again_does_not_make_another_flight_the_same() -> None:
    """PX4's own simulator draws the same noise each time: a second flight "holds a flight that is learned from"."""
    truth = hidden(quad(), {"payload": {"mass_kg": 0.3}})
    one = as_samples(fly(quad(), quad(), wander(), seconds=8.0, seed=1))
    other = as_samples(fly(truth, quad(), wander(seed=3), seconds=8.0, seed=1))
    exact = as_samples(fly(truth, quad(), wander(seed=3), seconds=8.0, seed=1), exact=True)
    noise = 5.0 * np.random.default_rng(2).standard_normal(one.accel_frd_mps2.shape)
    shaken = [replace(each, accel_frd_mps2=each.accel_frd_mps2 + noise) for each in (one, other, exact)]
    assert not same_flight(shaken[0], shaken[1])
    assert same_flight(shaken[1], shaken[2])  # by another estimate of the velocity


def test_a_file_that_says_that_its_body_is_guessed_is_no_other_vehicles() -> None:
    """Numbers all within its ranges were refused."""
    off = {
        "thrust_scale": {"scale": 0.55},
        "inertia": {"scale_x": 1.9, "scale_y": 0.97, "scale_z": 1.1},
        "motor_lag": {"time_constant_s": 0.41 * quad().rotors.time_constant_s},
    }
    wide = {name: np.array([[0.0, 1e3]]) for name in ("body.mass_kg", "body.inertia_kgm2", "rotors.max_thrust_n")}
    assert said(quad(), off)
    assert said(replace(quad(), ranges=wide), off) == ""
