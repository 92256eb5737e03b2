"""The exact model against closed forms: what it says is missing is what was hidden."""

from __future__ import annotations

import numpy as np
import pytest
from measured import measured
from shipped import load_scenario, load_vehicle

from benchmarks.oracle import Oracle
from flightstack.model import Limits, Model
from flightstack.stack import Stack
from flightstack.trajectory import Sinusoid, figure8, hover
from flightstack.types import Command, FlatOutput, Learned
from flightstack.vehicle import Vehicle, scaled, with_effects
from flightstack_sim.plant import NativePlant
from tests.closed_loop import fly

BELIEVED = load_vehicle("quad-x")
PATH = figure8(length_m=3.0, width_m=1.5, period_s=5.0, height_m=2.0)
STILL = hover((0.0, 0.0, -2.0))
NOW = measured(
    0, np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3), np.full(4, np.nan), 0, 0, 0
)
SENT = Command(0, 0.0, 0.0, np.zeros(3))


def _ask(oracle: Oracle, reference: FlatOutput, times: int = 3) -> Learned:
    """What it says once its fixed points have been begun from their own answers."""
    state = oracle.init()
    for _ in range(times):
        state, learned = oracle.step(state, NOW, SENT, reference)
    return learned


def _oracle(truth: Vehicle, believed: Vehicle = BELIEVED) -> Oracle:
    return Oracle(Model.from_vehicle(believed), truth)


@pytest.mark.parametrize("time_s", [0.0, 0.3, 1.1, 2.7])
@pytest.mark.parametrize("vehicle", ["quad-x", "px4-sihsim-quadx"])
def test_where_the_truth_is_believed_nothing_is_missing(vehicle: str, time_s: float) -> None:
    believed = load_vehicle(vehicle)
    learned = _ask(_oracle(believed, believed), PATH.at(time_s))
    assert learned.thrust_gain == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(learned.acc_ned_mps2, 0.0, atol=1e-6)
    np.testing.assert_allclose(learned.jerk_ned_mps3, 0.0, atol=1e-4)


@pytest.mark.parametrize("path", [STILL, PATH])
def test_a_heavier_vehicle_in_a_constant_force_misses_a_gain_and_an_acceleration(path: Sinusoid) -> None:
    truth = with_effects(scaled(BELIEVED, mass_ratio=1.4), {"constant_force": {"north_n": 1.5, "east_n": -0.5}})
    learned = _ask(_oracle(truth), path.at(0.7))
    assert learned.thrust_gain == pytest.approx(1.0 / 1.4, rel=1e-9)
    np.testing.assert_allclose(learned.acc_ned_mps2, np.array([1.5, -0.5, 0.0]) / 1.68, atol=1e-6)
    np.testing.assert_allclose(learned.jerk_ned_mps3, 0.0, atol=1e-4)


def test_a_drag_alike_on_all_axes_misses_a_share_of_the_velocity_and_its_rate_one_of_the_acceleration() -> None:
    truth = with_effects(BELIEVED, {"linear_drag": {"d_x_kgps": 0.6, "d_y_kgps": 0.6, "d_z_kgps": 0.6}})
    point = PATH.at(0.9)
    learned = _ask(_oracle(truth), point)
    np.testing.assert_allclose(learned.acc_ned_mps2, -0.5 * point.vel_ned_mps, atol=1e-6)
    np.testing.assert_allclose(learned.jerk_ned_mps3, -0.5 * point.acc_ned_mps2, atol=1e-3)


def test_its_derivative_is_that_of_its_own_answers_along_the_path() -> None:
    truth = with_effects(
        BELIEVED, {"rotor_drag": {"k_d_kg_per_rad": 2e-4}, "translational_lift": {"k_h_kg_per_m": 6e-3}}
    )
    oracle, step_s = _oracle(truth), 0.01
    before, after = (_ask(oracle, PATH.at(1.3 + dt), 6).acc_ned_mps2 for dt in (-step_s, step_s))
    jerk = _ask(oracle, PATH.at(1.3), 6).jerk_ned_mps3
    assert np.linalg.norm(jerk) > 0.5
    np.testing.assert_allclose(jerk, (after - before) / (2.0 * step_s), atol=0.02 * float(np.linalg.norm(jerk)))


def test_ground_effect_is_asked_for_at_the_height_of_the_reference() -> None:
    """Hovering at z, thrust grows by 1 / (1 - s (R / 4z)^2): at the weight, that share of g is missing."""
    truth = with_effects(BELIEVED, {"ground_effect": {"strength": 2.0}})
    learned = _ask(_oracle(truth), hover((0.0, 0.0, -0.2)).at(0.0))
    factor = 1.0 / (1.0 - 2.0 * (0.12 / (4.0 * 0.2)) ** 2)
    lift = -learned.acc_ned_mps2[2]  # the thrust asked for is the weight less what the ground adds to that thrust
    assert lift == pytest.approx(9.80665 * (1.0 - 1.0 / factor), rel=1e-6)


def test_a_watched_plant_s_events_count_from_then_on() -> None:
    plant = NativePlant(with_effects(BELIEVED, {"payload": {"mass_kg": 0.3}}), seed=0)
    oracle = _oracle(BELIEVED)
    oracle.watch(plant)
    assert _ask(oracle, STILL.at(0.0)).thrust_gain == pytest.approx(1.2 / 1.5, rel=1e-9)
    plant.set_effect("payload", {"mass_kg": 0.0})
    assert _ask(oracle, STILL.at(0.0)).thrust_gain == pytest.approx(1.0, rel=1e-9)


def test_fed_with_it_the_wrong_model_flies_as_well_as_the_right_one() -> None:
    scenario = load_scenario("paper-tracking").with_duration(10.0)
    truth = scenario.truth_vehicle(BELIEVED)

    def exact(model: Model, limits: Limits) -> Stack:
        return Stack(model, limits, learner=Oracle(model, truth))

    fed, right = (
        fly(scenario, BELIEVED, seed=3, make_stack=make, truth=true)
        for make, true in ((exact, truth), (Stack, BELIEVED))
    )
    unfed = fly(scenario, BELIEVED, seed=3, truth=truth)
    assert fed.rmse_m == pytest.approx(right.rmse_m, rel=0.1)
    assert unfed.rmse_m > 10.0 * fed.rmse_m
