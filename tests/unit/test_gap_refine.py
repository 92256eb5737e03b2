"""Refinement, re-flight, whiteness and hand-over: hidden parameters come back, and what is known stays known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flightstack.gap.add import companion, vehicle_file
from flightstack.gap.records import Samples
from flightstack.gap.refine import bounded, refine
from flightstack.gap.track import track
from flightstack.gap.verify import reflight, whiteness
from flightstack.types import InputError
from flightstack.vehicle import parse_vehicle
from tests.gap_flights import as_samples, fly, hidden, quad, wander

HIDDEN = {
    "payload": {"mass_kg": 0.2},
    "rotor_drag": {"k_d_kg_per_rad": 2e-4},
    "steady_wind": {"north_mps": 3.0, "east_mps": -1.0, "down_mps": 0.0},
}


@pytest.fixture(scope="module")
def loaded() -> Samples:
    return as_samples(fly(hidden(quad(), HIDDEN), quad(), wander(), seconds=30.0, seed=11))


@pytest.fixture(scope="module")
def agile() -> Samples:
    effects = {"motor_lag": {"time_constant_s": 0.035}, "inertia": {"scale_x": 1.2, "scale_y": 1.1, "scale_z": 0.9}}
    return as_samples(fly(hidden(quad(), effects), quad(), wander(), seconds=30.0, seed=12))


def test_three_effects_at_once_come_back_from_a_tenth_off(loaded: Samples) -> None:
    off = {name: {key: 1.1 * x for key, x in values.items()} for name, values in HIDDEN.items()}
    got = refine(quad(), hidden(quad(), off), [loaded], [track(loaded).usable], list(HIDDEN))
    assert got is not None
    for name, values in HIDDEN.items():
        for key, truth in values.items():
            found = got.parameters[name][key]
            spread = 0.5 * (found.high - found.low)
            assert abs(found.estimate - truth) < 2.0 * spread, key  # twice the 95 % half width: three of a thousand
            assert found.estimate == pytest.approx(truth, rel=0.02, abs=0.1)
            assert found.before == 0.0
            assert got.vehicle.effects[name][key] == found.estimate


def test_lag_and_inertia_come_back_beside_commands_of_unknown_time(agile: Samples) -> None:
    start = {"motor_lag": {"time_constant_s": 0.03}, "inertia": {"scale_x": 1.1, "scale_y": 1.05, "scale_z": 1.0}}
    got = refine(quad(), hidden(quad(), start), [agile], [track(agile).usable], list(start))
    assert got is not None
    assert got.parameters["motor_lag"]["time_constant_s"].estimate == pytest.approx(0.035, rel=0.05)
    for key, truth in (("scale_x", 1.2), ("scale_y", 1.1), ("scale_z", 0.9)):
        assert got.parameters["inertia"][key].estimate == pytest.approx(truth, rel=0.02)
    assert 0.0 < got.late_s[0] < 0.004  # the logged rates are means over the last 4 ms


def test_a_delay_is_known_to_half_a_sample_and_says_so() -> None:
    samples = as_samples(
        fly(hidden(quad(), {"transport_delay": {"delay_s": 0.02}}), quad(), wander(), seconds=20.0, seed=2)
    )
    start = hidden(quad(), {"transport_delay": {"delay_s": 0.016}})
    got = refine(quad(), start, [samples], [track(samples).usable], ["transport_delay"])
    assert got is not None
    found = got.parameters["transport_delay"]["delay_s"]
    assert found.low < 0.02 < found.high
    assert found.high - found.low < 2.0 * samples.dt_s


def test_a_parameter_that_nothing_shows_stays_with_an_interval_that_says_so(loaded: Samples) -> None:
    start = hidden(quad(), {**HIDDEN, "ground_effect": {"strength": 1.0}})
    got = refine(quad(), start, [loaded], [track(loaded).usable], ["ground_effect"])
    assert got is not None
    found = got.parameters["ground_effect"]["strength"]
    assert found.high - found.low > 1.0


def test_no_windows_no_refinement(loaded: Samples) -> None:
    nothing = np.zeros(len(loaded.t_s), dtype=bool)
    assert refine(quad(), hidden(quad(), HIDDEN), [loaded], [nothing], list(HIDDEN)) is None


def test_a_command_logged_late_is_timed_where_no_effect_is_refined(loaded: Samples) -> None:
    late_s = 0.3 * loaded.dt_s
    truth, usable = hidden(quad(), HIDDEN), [track(loaded).usable]
    plain = refine(truth, truth, [loaded], usable, ["gyro_bias"])
    shifted = np.vstack([loaded.motor[:1], 0.7 * loaded.motor[1:] + 0.3 * loaded.motor[:-1]])
    moved = refine(truth, truth, [replace(loaded, motor=shifted)], usable, [])
    assert plain is not None
    assert moved is not None
    assert plain.parameters == {}
    assert moved.vehicle == truth
    assert plain.late_s[0] - moved.late_s[0] == pytest.approx(late_s, rel=0.3)


def test_the_residual_is_white_with_the_right_model_only(loaded: Samples) -> None:
    mask = track(loaded).usable
    wrong = {each.signal: each for each in whiteness(quad(), loaded, mask)}
    right = {each.signal: each for each in whiteness(hidden(quad(), HIDDEN), loaded, mask)}
    for signal in ("specific_force_x", "specific_force_y", "specific_force_z"):
        assert not wrong[signal].white
        assert right[signal].distance < 2.0 * right[signal].limit < wrong[signal].distance


def test_the_corrected_vehicle_leans_and_lifts_as_logged(loaded: Samples) -> None:
    before, after = reflight(quad(), [quad(), hidden(quad(), HIDDEN)], loaded, track(loaded).usable)
    assert after.collective < 0.3 * before.collective
    assert after.lean_rad < 0.6 * before.lean_rad
    assert after.path_m < 2.0


def test_a_short_log_is_not_flown_again(loaded: Samples) -> None:
    mask = np.zeros(len(loaded.t_s), dtype=bool)
    mask[300:700] = True
    assert reflight(quad(), [quad()], loaded, mask) == []


def test_the_companion_takes_mass_and_drags_and_leaves_a_shifted_mass() -> None:
    effects = {
        "payload": {"mass_kg": 0.3},
        "rotor_drag": {"k_d_kg_per_rad": 2e-4},
        "parasitic_drag": {"c_x_kg_per_m": 0.1},
        "com_offset": {"x_m": 0.01},
    }
    corrected = hidden(quad(), effects)
    got = companion(quad(), corrected)
    taken = {each.name: each for each in got.takes}
    assert taken["mass_kg"].before == 1.2
    assert taken["mass_kg"].after == pytest.approx(1.5)
    assert taken["drag_x_kgps"].after > taken["drag_x_kgps"].before
    assert taken["drag_x_kgps"].after - taken["drag_y_kgps"].after == pytest.approx(0.2)
    assert got.left_to_learner == ("com_offset",)
    assert companion(quad(), quad()).takes == ()


def test_the_file_gives_the_same_vehicle_back() -> None:
    corrected = hidden(quad(), HIDDEN)
    assert parse_vehicle(vehicle_file(corrected, HIDDEN), "file") == corrected
    with pytest.raises(InputError, match="mass_kg"):
        vehicle_file(corrected, {"payload": {"mass_kg": 0.21}})


def test_no_interval_holds_what_can_not_be() -> None:
    """A height of the mass that no flight shows is known to the rotors' reach, not to four times that."""
    arm = float(np.max(np.linalg.norm(quad().rotors.position_m[:, :2], axis=1)))
    told = bounded(quad(), "com_offset", "z_m", 0.0, 0.8)
    assert (told.low, told.high) == pytest.approx((-arm, arm))
    narrow = bounded(quad(), "com_offset", "x_m", 0.01, 0.002)
    assert (narrow.low, narrow.estimate, narrow.high) == pytest.approx((0.008, 0.01, 0.012))
