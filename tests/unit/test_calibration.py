"""True residual, coverage and conformal check against closed forms, SciPy's normal distribution and sorted lists."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation
from shipped import load_vehicle

from flightstack.calibration import conformal_check, conformal_quantile, coverage, true_residual_frd_mps2
from flightstack.model import Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import with_effects
from flightstack_sim.plant import NativePlant

MODEL = Model.from_vehicle(load_vehicle("quad-x"))


def _random_flight(n: int = 50) -> tuple[F64, F64, F64, Rotation]:
    """Motor states (n, 4), velocities (n, 3), attitudes (n, 4) scalar first and as rotations."""
    rng = np.random.default_rng(4)
    turn = Rotation.random(n, random_state=5)
    return rng.uniform(0.2, 0.9, (n, 4)), rng.normal(0.0, 3.0, (n, 3)), turn.as_quat()[:, [3, 0, 1, 2]], turn


def _thrust_n(model: Model, motor_u: F64) -> F64:
    """Four rotors, each giving a quarter of the whole."""
    return np.array([sum(model.thrust_of(float(u)) / 4.0 for u in row) for row in motor_u])


@pytest.mark.parametrize("factor", [0.0, 0.4, 1.0])
def test_a_vehicle_as_believed_leaves_no_residual_whatever_its_thrust_curve(factor: float) -> None:
    model = dataclasses.replace(MODEL, thrust_model_factor=factor)
    motor_u, vel, q, _ = _random_flight()
    force = np.zeros((len(motor_u), 3))
    force[:, 2] = -_thrust_n(model, motor_u) / model.mass_kg
    assert np.abs(true_residual_frd_mps2(model, force, motor_u, vel, q)).max() < 1e-12


def test_a_mass_of_1_4_times_the_believed_one_leaves_two_sevenths_of_the_believed_thrust_acceleration() -> None:
    motor_u, vel, q, _ = _random_flight()
    thrust = _thrust_n(MODEL, motor_u)
    force = np.zeros((len(motor_u), 3))
    force[:, 2] = -thrust / (1.4 * MODEL.mass_kg)
    residual = true_residual_frd_mps2(MODEL, force, motor_u, vel, q)
    np.testing.assert_allclose(residual[:, 2], thrust / MODEL.mass_kg * (1.0 - 1.0 / 1.4), rtol=1e-12)
    assert np.abs(residual[:, :2]).max() == 0.0


def test_a_constant_force_leaves_its_acceleration_turned_into_the_body() -> None:
    motor_u, vel, q, turn = _random_flight()
    wind = np.array([1.2, -0.3, 0.5])
    body = turn.inv().apply(np.tile(wind, (len(q), 1)))
    force = body.copy()
    force[:, 2] -= _thrust_n(MODEL, motor_u) / MODEL.mass_kg
    np.testing.assert_allclose(true_residual_frd_mps2(MODEL, force, motor_u, vel, q), body, atol=1e-12)


def test_drag_that_the_model_knows_is_no_residual_and_drag_that_it_lacks_is() -> None:
    drag = np.array([0.3, 0.2, 0.1])
    knows = dataclasses.replace(MODEL, drag_kgps=(0.3, 0.2, 0.1))
    motor_u, vel, q, turn = _random_flight()
    dragged = -drag * turn.inv().apply(vel) / MODEL.mass_kg
    force = dragged.copy()
    force[:, 2] -= _thrust_n(MODEL, motor_u) / MODEL.mass_kg
    assert np.abs(true_residual_frd_mps2(knows, force, motor_u, vel, q)).max() < 1e-12
    np.testing.assert_allclose(true_residual_frd_mps2(MODEL, force, motor_u, vel, q), dragged, atol=1e-12)


def test_the_simulators_truth_of_a_known_mass_and_force_gives_their_residual() -> None:
    """The plant's own specific force and motor state, against m_true = 1.5 m and a force of (0.6, 0, 0) N."""
    vehicle = load_vehicle("quad-x")
    effects = {"payload": {"mass_kg": 0.5 * MODEL.mass_kg}, "constant_force": {"north_n": 0.6}}
    plant = NativePlant(with_effects(vehicle, effects), seed=0, ground=False)
    for _ in range(400):
        plant.step(np.full(4, 0.7))
    truth = plant.truth()
    rows = [np.array([part]) for part in (truth.specific_force_frd_mps2, truth.motor_u, truth.vel_ned_mps)]
    residual = true_residual_frd_mps2(MODEL, *rows, np.array([truth.q_ned_frd]))[0]
    mass = 1.5 * MODEL.mass_kg
    thrust = MODEL.thrust_of(0.7)
    expected = np.array([0.6 / mass, 0.0, thrust / MODEL.mass_kg - thrust / mass])
    np.testing.assert_allclose(residual, expected, atol=1e-6)


def test_coverage_counts_pairs_axes_and_whole_ticks() -> None:
    mean, sigma = np.zeros((4, 3)), np.ones((4, 3))
    truth = np.array([[0.0, 2.9, -3.0], [3.1, 0.0, 0.0], [0.0, np.nan, 0.0], [0.0, 0.0, -9.0]])
    seen = coverage(truth, mean, sigma)
    assert seen.share == pytest.approx(9 / 11)
    assert seen.axes == pytest.approx((3 / 4, 1.0, 3 / 4))
    assert seen.simultaneous == pytest.approx(1 / 3)


def test_a_tick_without_a_bound_does_not_count() -> None:
    nothing = np.full((3, 3), np.nan)
    seen = coverage(np.zeros((3, 3)), np.zeros((3, 3)), nothing)
    assert (seen.share, seen.axes, seen.simultaneous) == (None, (None, None, None), None)


def test_normal_errors_are_covered_as_the_normal_distribution_says() -> None:
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.1, 3.0, (40_000, 3))
    mean = rng.normal(0.0, 5.0, sigma.shape)
    seen = coverage(mean + sigma * rng.normal(size=sigma.shape), mean, sigma, sigmas=2.0)
    inside = float(stats.norm.cdf(2.0) - stats.norm.cdf(-2.0))
    assert seen.share == pytest.approx(inside, abs=4.0 * math.sqrt(inside * (1 - inside) / sigma.size))
    assert seen.simultaneous == pytest.approx(inside**3, abs=4.0 * math.sqrt(inside**3 * (1 - inside**3) / 40_000))


@pytest.mark.parametrize(
    ("n", "alpha", "place"), [(9, 0.1, 9), (19, 0.1, 18), (99, 0.05, 95), (100, 0.05, 96), (3, 0.5, 2)]
)
def test_the_quantile_is_the_k_th_smallest_of_the_scores(n: int, alpha: float, place: int) -> None:
    scores = np.random.default_rng(n).permutation(np.arange(1.0, n + 1.0))
    assert conformal_quantile(scores, alpha) == place


def test_too_few_scores_promise_nothing() -> None:
    assert conformal_quantile(np.arange(8.0), 0.1) is None
    assert conformal_check(np.zeros((10, 3)), np.zeros((10, 3)), np.ones((10, 3))) is None
    empty = np.zeros((0, 3))
    assert conformal_check(empty, empty, empty) is None


NOISE = 5.0


@pytest.mark.parametrize("alpha", [0.0027, 0.05])
@pytest.mark.parametrize("claimed", [1.0, 0.5])
def test_of_normal_scores_the_quantile_is_the_normal_distributions(alpha: float, claimed: float) -> None:
    """Errors of 1 sigma under noise of 5: claimed as such the quantile is the two-sided normal one, claimed as half,
    by that much more, with the noise of a window's mean, 5 / sqrt(15), beside it."""
    rng = np.random.default_rng(1)
    errors = np.repeat(rng.normal(size=(6_000, 3)), 150, axis=0) + NOISE * rng.normal(size=(900_000, 3))
    seen = conformal_check(errors, np.zeros_like(errors), np.full_like(errors, claimed), alpha)
    assert seen is not None
    more = math.sqrt((1.0 + NOISE**2 / 15) / (claimed**2 + NOISE**2 / 15))
    assert seen.quantile_sigma == pytest.approx(float(stats.norm.ppf(1 - alpha / 2)) * more, rel=0.04)
    n = errors.size / 15 / 10 / 2  # windows that differ
    assert seen.coverage_heldout == pytest.approx(1 - alpha, abs=5.0 * math.sqrt(2.0 * alpha * (1 - alpha) / n))


def test_errors_that_grow_after_the_calibration_show_in_the_held_out_half() -> None:
    rng = np.random.default_rng(2)
    errors = np.repeat(rng.normal(size=(20_000, 3)), 60, axis=0)
    errors[600_000:] *= 3.0
    seen = conformal_check(errors, np.zeros_like(errors), np.ones_like(errors), 0.05)
    assert seen is not None
    outside = 2.0 * float(stats.norm.sf(stats.norm.ppf(0.975) / 3.0))  # whatever the noise takes off both
    assert 1.0 - seen.coverage_heldout == pytest.approx(outside, rel=0.03)


def test_samples_without_a_measurement_are_left_out() -> None:
    rng = np.random.default_rng(3)
    errors = rng.normal(size=(4_000, 3))
    gaps = np.full((12_000, 3), np.nan)
    gaps[::3] = errors
    ones = np.ones_like(gaps)
    assert conformal_check(gaps, 0.0 * ones, ones, 0.05) == conformal_check(errors, 0.0 * errors, ones[:4_000], 0.05)


def test_the_plants_gravity_is_the_weight_that_hover_carries() -> None:
    """A sanity check of the sign: hovering with 1.4 times the mass leaves +0.4 g along z."""
    mass = 1.4 * MODEL.mass_kg
    norm = MODEL.norm_of(mass * STANDARD_GRAVITY_MPS2)
    force = np.array([[0.0, 0.0, -STANDARD_GRAVITY_MPS2]])
    upright = np.array([[1.0, 0.0, 0.0, 0.0]])
    residual = true_residual_frd_mps2(MODEL, force, np.full((1, 4), norm), np.zeros((1, 3)), upright)
    assert residual[0, 2] == pytest.approx(0.4 * STANDARD_GRAVITY_MPS2, rel=1e-9)
