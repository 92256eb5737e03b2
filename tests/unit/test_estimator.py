"""The estimate's errors have the statistics that the grade file states."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flightstack.types import F64
from flightstack_sim.estimator import EstimatorModel
from flightstack_sim.grade import EstimateGrade, load_grade

DT_S = 0.004
UNIT = np.array([1.0, 0.0, 0.0, 0.0])


def turn(q: F64) -> Rotation:
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


def quaternion(rotation: Rotation) -> F64:
    return np.roll(rotation.as_quat(), 1)


def errors(grade: EstimateGrade, seed: int, steps: int) -> F64:
    """(steps, 9): position, velocity, small rotation, for a vehicle somewhere in motion and turned."""
    model = EstimatorModel(grade, np.random.default_rng(seed), DT_S)
    pos, vel = np.array([3.0, -2.0, -10.0]), np.array([1.0, 2.0, -0.5])
    attitude = Rotation.from_euler("ZYX", [2.0, 0.2, -0.4])
    q, accel = quaternion(attitude), np.zeros(3)
    states = np.empty((steps, 13))
    for row in states:
        model.step(pos, vel, q, UNIT, accel)
        row[:] = model.state
    small = (attitude.inv() * turn(states[:, 6:10])).as_rotvec()
    return np.hstack([states[:, :3] - pos, states[:, 3:6] - vel, small])


def table(grade: EstimateGrade) -> tuple[F64, F64]:
    tilt, heading = grade.tilt_std_rad, grade.heading_std_rad
    std = np.array([*grade.pos_std_m, *grade.vel_std_mps, tilt, tilt, heading])
    tau = [grade.pos_time_constant_s] * 3 + [grade.vel_time_constant_s] * 3
    return std, np.array([*tau, *[grade.tilt_time_constant_s] * 2, grade.heading_time_constant_s])


def faster(grade: EstimateGrade) -> EstimateGrade:
    """The same errors with every time constant a fifth, so that a test sees many of them; no constant bias."""
    return replace(
        grade,
        pos_bias_std_m=(0.0, 0.0, 0.0),
        pos_time_constant_s=grade.pos_time_constant_s / 5.0,
        vel_time_constant_s=grade.vel_time_constant_s / 5.0,
        tilt_time_constant_s=grade.tilt_time_constant_s / 5.0,
        heading_time_constant_s=grade.heading_time_constant_s / 5.0,
    )


@pytest.mark.parametrize("name", ["mocap", "gps"])
def test_standard_deviations_and_correlation_times_are_those_of_the_file(name: str) -> None:
    """N samples over T seconds hold about T / (2 tau) independent ones; the variance's scatter follows from that."""
    grade = faster(load_grade(name).estimate)
    std, tau = table(grade)
    steps = 100_000
    rows = errors(grade, 11, steps)
    independent = steps * DT_S / (2.0 * tau)
    assert (np.abs(rows.std(axis=0) / std - 1.0) < 4.0 / np.sqrt(2.0 * independent)).all()
    for column, tau_s in zip(rows.T, tau, strict=True):
        lag = round(tau_s / DT_S)
        correlation = np.mean(column[lag:] * column[:-lag]) / np.mean(column**2)
        expected = math.exp(-lag * DT_S / tau_s)
        assert correlation == pytest.approx(expected, abs=4.0 * math.sqrt(2.0 * tau_s / (steps * DT_S)))


def test_errors_start_in_their_stationary_spread() -> None:
    grade = load_grade("gps").estimate
    first = np.array([errors(grade, seed, 1)[0] for seed in range(300)])
    std, _ = table(grade)
    std[:3] = np.hypot(std[:3], grade.pos_bias_std_m)
    np.testing.assert_allclose(np.sqrt(np.mean(first**2, axis=0)), std, rtol=4.0 / math.sqrt(600.0))


def test_one_step_decays_exactly_whatever_the_time_constant() -> None:
    """var(x[k+1] - a x[k]) = sigma^2 (1 - a^2) with a = exp(-dt / tau), here with tau of one step only."""
    grade = replace(faster(load_grade("gps").estimate), pos_time_constant_s=DT_S)
    rows = errors(grade, 4, 20_000)[:, :3]
    a = math.exp(-1.0)
    drive = (rows[1:] - a * rows[:-1]).std(axis=0)
    np.testing.assert_allclose(drive, np.array(grade.pos_std_m) * math.sqrt(1.0 - a * a), rtol=4.0 / math.sqrt(40_000))


def test_the_position_bias_is_constant_in_a_flight_and_about_20_cm_with_gps() -> None:
    """rms of its length over seeds: sqrt(3) 0.12 m = 0.21 m."""
    base = load_grade("gps").estimate
    grade = replace(base, pos_std_m=(0.0, 0.0, 0.0))
    ends = np.array([errors(grade, seed, 3)[[0, -1], :3] for seed in range(300)])
    np.testing.assert_allclose(ends[:, 0], ends[:, 1], atol=1e-12)
    assert math.sqrt(np.mean(np.sum(ends[:, 0] ** 2, axis=1))) == pytest.approx(0.2, abs=0.03)


def test_the_attitude_is_the_truth_followed_by_the_misalignment() -> None:
    perfect = EstimateGrade((0.0,) * 3, (0.0,) * 3, 1.0, (0.0,) * 3, 1.0, 0.0, 1.0, 0.0, 1.0)  # type: ignore[arg-type]
    model = EstimatorModel(perfect, np.random.default_rng(0), DT_S)
    attitude = Rotation.from_euler("ZYX", [1.0, 0.5, -0.3])
    wrong = Rotation.from_euler("XYZ", [0.02, -0.01, 0.03])
    model.step(np.zeros(3), np.zeros(3), quaternion(attitude), quaternion(wrong), np.zeros(3))
    assert (turn(model.state[6:10]).inv() * (attitude * wrong)).magnitude() < 1e-12


def test_the_quaternion_stays_unit() -> None:
    model = EstimatorModel(load_grade("gps").estimate, np.random.default_rng(1), DT_S)
    for _ in range(1000):
        model.step(np.zeros(3), np.zeros(3), UNIT, UNIT, np.zeros(3))
        assert abs(np.linalg.norm(model.state[6:10]) - 1.0) < 1e-12


def test_stated_accuracies_include_the_bias() -> None:
    grade = load_grade("gps").estimate
    accuracy = EstimatorModel(grade, np.random.default_rng(0), DT_S).accuracy
    assert accuracy.pos_vertical_std_m == pytest.approx(math.hypot(0.15, 0.12))
    assert accuracy.pos_horizontal_std_m == pytest.approx(math.sqrt(2.0) * math.hypot(0.15, 0.12))
