"""The state observer and the bounds behind it: truth minus estimate, over many simulated errors, within what is stated.

The errors are made by the simulator's estimator model, which shares no code with the observer; the motion is a figure
of eight worked out here.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from measured import measured as measured_at

from flightstack.barrier.estimate_bounds import K_SIGMA, estimate_bounds
from flightstack.cli.sensors import error_statistics
from flightstack.state_observer import SAMPLE_S, StateObserver, steady
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_sim.estimator import EstimatorModel
from flightstack_sim.grade import load_grade
from tests.thorough import THOROUGH

DT_S = 0.004
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def test_two_minutes_of_samples_change_neither_gains_nor_variances() -> None:
    """They are constant: variances of GPS that still shrank by 6e-6 were those after 32 s."""
    statistics = error_statistics(load_grade("gps"))
    gains, covariances = (each[0] for each in steady(statistics))
    fades = np.exp(-SAMPLE_S / np.array([statistics.pos_time_s, statistics.vel_time_s, statistics.acc_time_s]))
    own = np.square([statistics.pos_std_m[0], statistics.vel_std_mps[0], statistics.acc_std_mps2[0]])
    moves = np.diag([1.0, 1.0, *fades])
    moves[0, 1], moves[0, 4], moves[1, 4] = SAMPLE_S, -0.5 * SAMPLE_S**2, -SAMPLE_S
    drive, seen = np.diag([0.0, 0.0, *(own * (1.0 - fades**2))]), np.array([[1.0, 0, 1, 0, 0], [0, 1.0, 0, 1, 0]])
    density = statistics.acc_noise_mps2_rthz[0] ** 2
    drive[:2, :2] += density * np.array([[SAMPLE_S**3 / 3.0, SAMPLE_S**2 / 2.0], [SAMPLE_S**2 / 2.0, SAMPLE_S]])
    p, noise, gain = covariances, 1e-6 * np.diag(own[:2]), gains
    for _ in range(15_000):
        p = moves @ p @ moves.T + drive
        gain = p @ seen.T @ np.linalg.inv(seen @ p @ seen.T + noise)
        p = (np.eye(5) - gain @ seen) @ p
    scale = np.sqrt(np.outer(np.diag(covariances), np.diag(covariances)))
    assert np.abs((p - covariances) / scale).max() < 1e-8
    assert gain == pytest.approx(gains, abs=1e-8)


def motion(t: float) -> tuple[F64, F64, F64]:
    """Position, velocity, acceleration of a figure of eight of 1.5 m at 2.5 m/s^2."""
    w, a = 1.3, np.array([1.5, 0.75, 0.3])
    n = np.array([1.0, 2.0, 1.5]) * w
    return a * np.sin(n * t), a * n * np.cos(n * t), -a * n * n * np.sin(n * t)


def errors(grade_name: str, seed: int, seconds: float, *, observed: bool = True) -> F64:
    """(ticks, 9) truth minus estimate: position, velocity, acceleration by tilt, after 3 s; level attitude."""
    grade = load_grade(grade_name)
    model = EstimatorModel(grade.estimate, np.random.default_rng(seed), DT_S)
    noise = np.random.default_rng(10_000 + seed)
    density = np.array(grade.imu.accel_noise_mps2_rthz) / math.sqrt(2.0 * DT_S)
    bias = noise.normal(0.0, grade.imu.accel_bias_std_mps2 * grade.imu.bias_left_by_estimator, 3)
    observer, rows, sample, sample_us = StateObserver(error_statistics(grade)), [], None, 0
    offset = model.model[2, :3].copy()
    for k in range(int(seconds / DT_S)):
        now_us = k * 4000
        pos, vel, acc = motion(now_us * 1e-6)
        _, _, before = motion(now_us * 1e-6 - 0.5 * DT_S)
        force = before - np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2]) + bias + density * noise.normal(size=3)
        model.step(pos, vel, LEVEL, LEVEL, force)
        if k % 2 == 0 or sample is None:  # 125 Hz
            sample, sample_us = model.state[:6].copy(), now_us
        age = (now_us - sample_us) * 1e-6
        q = model.state[6:10].copy()
        vel_now = sample[3:] + age * acc
        pos_now = sample[:3] + age * sample[3:] + 0.5 * age * age * acc
        measured = measured_at(
            now_us, pos_now, vel_now, q, np.zeros(3), force, np.full(4, math.nan), now_us - sample_us, 0, 0
        )
        seen = observer.refine(measured) if observed else measured
        if k * DT_S >= 3.0:
            w, x, y, z = seen.q_ned_frd
            axis = np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
            tilt = STANDARD_GRAVITY_MPS2 * (np.array([0.0, 0.0, 1.0]) - axis)
            rows.append(np.concatenate([pos - seen.pos_ned_m + offset, vel - seen.vel_ned_mps, tilt]))
    assert observer.restarts == 0
    return np.array(rows)


def inside(grade: str, found: F64) -> float:
    """Share of the ticks with every component within the bounds (position without where it began)."""
    statistics = error_statistics(load_grade(grade))
    bounds, (_, covariance) = estimate_bounds(statistics), steady(statistics)
    limits = np.array([*(K_SIGMA * np.sqrt(covariance[:, 0, 0])), *bounds.vel_mps, *bounds.acc_mps2])
    return float(np.all(np.abs(found) <= limits, axis=1).mean())


@pytest.mark.parametrize("grade", ["mocap", "gps"])
def test_truth_minus_estimate_lies_within_the_bounds_in_999_of_1000_ticks(grade: str) -> None:
    found = np.concatenate([errors(grade, seed, 25.0) for seed in range(6 if THOROUGH else 3)])
    assert inside(grade, found) >= 0.999


def test_what_is_reported_does_not() -> None:
    """The test can fail: without the observer the same bounds are broken."""
    assert inside("mocap", errors("mocap", 1, 25.0, observed=False)) < 0.9


def test_the_covariance_is_what_the_errors_show() -> None:
    """Standard deviations over 6 flights within a fifth of the Riccati recursion's."""
    found = np.concatenate([errors("mocap", seed, 25.0) for seed in range(6)])
    _, covariance = steady(error_statistics(load_grade("mocap")))
    for place, row in ((0, 0), (1, 3)):
        stated = np.sqrt(covariance[:, place, place])
        np.testing.assert_allclose(found[:, row : row + 3].std(axis=0), stated, rtol=0.2)


def test_a_jump_or_a_gap_begins_anew() -> None:
    observer = StateObserver(error_statistics(load_grade("mocap")))
    still = np.array([0.0, 0.0, -STANDARD_GRAVITY_MPS2])

    def seen(t_us: int, north_m: float) -> float:
        pos = np.array([north_m, 0.0, 0.0])
        measured = measured_at(t_us, pos, np.zeros(3), LEVEL, np.zeros(3), still, np.full(4, math.nan), 0, 0, 0)
        return float(observer.refine(measured).pos_ned_m[0])

    for k in range(500):
        seen(4000 * k, 0.0)
    assert abs(seen(2_000_000, 0.005)) < 0.005
    assert observer.restarts == 0
    assert seen(2_004_000, 1.0) == 1.0
    assert observer.restarts == 1
    assert seen(9_000_000, 1.2) == 1.2


def test_the_checkers_table_of_grades_is_the_observers() -> None:
    from flightstack.certificate_check.premises import _STEADIEST

    for name, table in _STEADIEST.items():
        bounds = estimate_bounds(error_statistics(load_grade(name)), 1.0)
        stated = np.array([bounds.pos_m, bounds.vel_mps, bounds.acc_mps2]).T
        assert np.all(table <= 1.001 * stated)
        assert np.all(table >= 0.97 * stated)
