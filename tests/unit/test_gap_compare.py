"""Residual, rollouts and their floor: Monte Carlo, the plant itself, strapdown on exact data, synthetic spectra."""

from __future__ import annotations

import os
import select
import signal
from dataclasses import replace

import numpy as np
import pytest

from flightstack.cli.compiled import GAP, compile_part
from flightstack.gap.compare import expected_noise, figures, noise_floor, residual, rollout_starts, sensor_noise
from flightstack.gap.evaluated import windows_loop
from flightstack.gap.fusion import crossovers
from flightstack.gap.records import Samples
from flightstack.gap.rollouts import rollout, rollouts
from flightstack.gap.run import ModelEvaluation, params_row
from flightstack.gap.track import track
from flightstack.types import F64
from flightstack_logs.turn import rotate, rotate_inverse, turned
from flightstack_sim.plant import NativePlant
from tests.gap_flights import as_samples, fly, hidden, quad, wander

ACCEL, GYRO = 0.08, 0.01


@pytest.fixture(scope="module")
def exact() -> Samples:
    return as_samples(fly(quad(), quad(), wander(), seconds=14.0, seed=3), exact=True)


@pytest.fixture(scope="module")
def dragged() -> tuple[Samples, Samples]:
    """A flight with rotor drag, as measured by motion capture and by GPS."""
    truth = hidden(quad(), {"rotor_drag": {"k_d_kg_per_rad": 3e-4}})
    mocap, gps = (fly(truth, quad(), wander(), seconds=30.0, seed=4, grade=g) for g in ("mocap", "gps"))
    return as_samples(mocap), as_samples(gps)


def noisy(samples: Samples, seed: int) -> Samples:
    rng = np.random.default_rng(seed)
    shape = samples.accel_frd_mps2.shape
    return replace(
        samples,
        accel_frd_mps2=samples.accel_frd_mps2 + ACCEL * rng.standard_normal(shape),
        rate_frd_radps=samples.rate_frd_radps + GYRO * rng.standard_normal(shape),
    )


def test_sensor_noise_is_what_monte_carlo_says(exact: Samples) -> None:
    clean = residual(quad(), exact).y
    said = sensor_noise(replace(exact, noise={"accel_frd_mps2": ACCEL, "rate_frd_radps": GYRO}))
    seen = np.stack([residual(quad(), noisy(exact, seed)).y - clean for seed in range(8)])
    assert np.sqrt(np.nanmean(seen[..., :6] ** 2, axis=(0, 1))) == pytest.approx(said[:6], rel=0.1)


def test_vibration_that_folds_to_the_top_of_a_slow_logs_band_is_no_noise_below_it(exact: Samples) -> None:
    """A tone near half of the rate of the samples: differences between them take it for white noise."""
    flight, clean = noisy(exact, 2), residual(quad(), exact).y
    turning = np.cos(2.0 * np.pi * 0.46 * np.arange(len(exact.t_s)))[:, None] * np.array([0.5, 0.9, 0.5])
    shaken = replace(flight, accel_frd_mps2=flight.accel_frd_mps2 + turning)
    mask = track(exact).usable
    left = np.sqrt(np.nanmean((residual(quad(), shaken).y - clean)[mask, :3] ** 2, axis=0))
    assert sensor_noise(shaken)[0] > 2.0 * left[0]
    assert expected_noise(quad(), shaken, mask)[:3] == pytest.approx(left, rel=0.3)


def test_noise_is_found_without_being_told_even_behind_the_autopilot_s_filter(exact: Samples) -> None:
    flight = noisy(exact, 1)
    mask = track(exact).usable
    assert sensor_noise(flight)[:3] == pytest.approx(
        sensor_noise(replace(exact, noise={"accel_frd_mps2": ACCEL, "rate_frd_radps": GYRO}))[:3], rel=0.15
    )
    # a moving mean of three samples hides most of the noise from differences, and little of it below 20 Hz
    kernel = np.ones(3) / 3.0
    mean = np.stack([np.convolve(x, kernel, mode="same") for x in flight.accel_frd_mps2.T], axis=1)
    filtered = replace(flight, accel_frd_mps2=mean, noise={})
    left = np.nanstd(residual(quad(), filtered).y[mask, :2], axis=0)
    assert sensor_noise(filtered)[:2].max() < 0.7 * left.min()
    assert expected_noise(quad(), filtered, mask)[:2] == pytest.approx(left, rel=0.3)


def test_a_rollout_is_the_plant_s_own_flight(exact: Samples) -> None:
    """The same second by the plant at 1 ms, commands interpolated by hand."""
    vehicle = hidden(quad(), {"rotor_drag": {"k_d_kg_per_rad": 3e-4}, "transport_delay": {"delay_s": 0.0}})
    start, flight = 600, track(exact)
    got = rollout(vehicle, exact, [start], 1.0)
    plant = NativePlant(vehicle, seed=0, ground=False)
    plant.pos_ned_m[:] = flight.pos_ned_m[start]
    plant.vel_ned_mps[:] = flight.vel_ned_mps[start]
    plant.q_ned_frd[:] = flight.q_ned_frd[start]
    plant.rate_frd_radps[:] = flight.rate_frd_radps[start]
    plant.motor_u[:] = ModelEvaluation(params_row(vehicle, flight.step_s), flight).u[start]
    for ms in range(1000):
        at = exact.t_s[start] + 0.001 * ms + 0.0005
        plant.step(np.array([np.interp(at, exact.t_s, column) for column in exact.motor.T]))
    assert got.pos_ned_m[0, -1] == pytest.approx(plant.pos_ned_m, abs=2e-3)
    assert got.vel_ned_mps[0, -1] == pytest.approx(plant.vel_ned_mps, abs=5e-3)
    assert got.q_ned_frd[0, -1] == pytest.approx(plant.q_ned_frd, abs=2e-3)


def test_many_at_once_are_the_same_as_one_by_one(exact: Samples) -> None:
    lagging = hidden(quad(), {"motor_lag": {"time_constant_s": 0.04}, "transport_delay": {"delay_s": 0.013}})
    compile_part(GAP)
    ahead = list(windows_loop.signatures)
    batch = rollouts([(quad(), 0.0), (lagging, 0.002)], exact, [200, 500, 900], 0.4)
    assert windows_loop.signatures == ahead != []  # `warmup gap` had compiled it
    alone = rollouts([(lagging, 0.002)], exact, [500], 0.4)[0]
    assert np.array_equal(batch[1].pos_ned_m[1], alone.pos_ned_m[0])
    assert np.array_equal(batch[1].force_frd_mps2[1], alone.force_frd_mps2[0])
    assert not np.array_equal(batch[0].pos_ned_m[1], alone.pos_ned_m[0])


def test_starts_lie_half_a_second_apart_and_their_second_is_whole(exact: Samples) -> None:
    mask = np.ones(len(exact.t_s), dtype=bool)
    mask[800] = False
    starts = rollout_starts(exact, mask)
    assert np.all(np.isin(np.diff(starts), [62, 62 * 3, 62 * 4]))
    assert not np.any((starts <= 800) & (starts + 125 >= 800))
    assert exact.t_s[starts[0]] >= exact.t_s[0] + 1.0


def test_a_perfect_simulator_is_at_the_floor_and_a_wrong_one_is_not(dragged: tuple[Samples, Samples]) -> None:
    truth = hidden(quad(), {"rotor_drag": {"k_d_kg_per_rad": 3e-4}})
    for samples in dragged:
        mask = track(samples).usable
        before, after = figures(quad(), samples, mask), figures(truth, samples, mask)
        floor = noise_floor(truth, samples, mask)
        assert after.one_step_mps2 == pytest.approx(floor.one_step_mps2, rel=0.15)
        assert after.one_step_radps2 == pytest.approx(floor.one_step_radps2, rel=0.15)
        assert after.rollout_1s_m == pytest.approx(floor.rollout_1s_m, rel=0.35)
        assert before.one_step_mps2 > 4.0 * floor.one_step_mps2
        assert before.rollout_1s_m > 2.0 * floor.rollout_1s_m


def test_the_floor_of_exact_data_is_nothing(exact: Samples) -> None:
    mask = track(exact).usable
    assert noise_floor(quad(), exact, mask).rollout_1s_m < 1e-3
    assert figures(quad(), exact, mask).rollout_1s_m < 5e-3


def test_without_position_there_are_no_rollouts(exact: Samples) -> None:
    nothing = np.full_like(exact.pos_ned_m, np.nan)
    bare = replace(exact, pos_ned_m=nothing, vel_ned_mps=nothing)
    assert figures(quad(), bare, np.ones(len(nothing), dtype=bool)).rollout_1s_m is None


def test_the_smoothed_velocity_is_nearer_to_the_truth_than_the_measured_one() -> None:
    flight = fly(quad(), quad(), wander(), seconds=40.0, seed=8, grade="gps")
    samples = as_samples(flight)
    prepared = track(samples)
    left = (prepared.vel_ned_mps - flight.true_vel)[prepared.usable].std(axis=0)
    raw = (flight.vel - flight.true_vel)[prepared.usable].std(axis=0)
    assert np.linalg.norm(left) < 0.6 * np.linalg.norm(raw)
    assert np.linalg.norm(prepared.vel_std_mps) == pytest.approx(np.linalg.norm(left), rel=0.6)


def test_crossovers_follow_the_noise() -> None:
    dt, n = 0.01, 6000
    rng = np.random.default_rng(2)
    t = dt * np.arange(n)
    truth = 2.0 * np.sin(0.7 * t)[:, None] * np.ones(3)
    pos, acc = np.cumsum(truth, axis=0) * dt, np.gradient(truth, dt, axis=0)

    def coloured(std: float, tau: float) -> F64:
        decay = np.exp(-dt / tau)
        x = np.zeros((n, 3))
        for k in range(1, n):
            x[k] = decay * x[k - 1] + std * np.sqrt(1.0 - decay**2) * rng.standard_normal(3)
        return x

    poor, good = coloured(0.4, 2.0), coloured(0.01, 0.1)
    by_position, _ = crossovers(truth + poor, pos, acc + 0.05 * rng.standard_normal((n, 3)), dt)
    by_velocity, _ = crossovers(truth + good, pos + coloured(0.5, 1.0), acc + coloured(0.2, 5.0), dt)
    assert min(low for low, _ in by_position) > 0.0
    assert max(low for low, _ in by_velocity) == 0.0


def test_a_filters_velocity_that_errs_slowly_as_its_own_inertia_does_gives_way_to_the_position() -> None:
    """An autopilot's velocity is its acceleration, integrated: both err by the same 0.3 m/s, the position by 0.2 m."""
    dt, n = 0.02, 3000
    t = dt * np.arange(n)
    truth = 2.0 * np.sin(0.7 * t)[:, None] * np.ones(3)
    pos, acc = np.cumsum(truth, axis=0) * dt, np.gradient(truth, dt, axis=0)
    slow = 0.3 * np.sqrt(2.0) * np.sin(2.0 * np.pi * np.outer(t, [1 / 40.0, 1 / 50.0, 1 / 60.0]) + 1.0)
    wander = 0.2 * np.sin(2.0 * np.pi * np.outer(t, [1 / 15.0, 1 / 13.0, 1 / 11.0]))
    chosen, std = crossovers(truth + slow, pos + wander, acc + np.gradient(slow, dt, axis=0), dt)
    assert min(low for low, _ in chosen) >= 0.16
    assert np.all((std > 0.1) & (std < 0.3))  # its error is not known, only by how much the two differ
    chosen, std = crossovers(truth, pos + wander, acc, dt)  # a position that wanders is told by its rising spectrum
    assert np.all(std < 0.05)


def test_few_slow_means_of_white_noise_are_not_taken_for_a_velocity_that_errs_slowly() -> None:
    """50 s hold four means of 12 s; at a third of the power of those over 3 s, one axis in seven was taken for slow."""
    rng, dt, n = np.random.default_rng(11), 0.02, 2555
    still, taken = np.zeros((n, 3)), 0
    for _ in range(40):
        steps = np.repeat(0.2 * rng.standard_normal((n // 50 + 1, 3)), 50, axis=0)[:n]
        chosen, _ = crossovers(steps, still, np.gradient(steps, dt, axis=0), dt)
        taken += sum(low == 0.16 for low, _ in chosen)
    assert taken <= 12  # of 120, a tenth


def test_turning_there_and_back(exact: Samples) -> None:
    v = exact.accel_frd_mps2
    assert rotate_inverse(exact.q_ned_frd, rotate(exact.q_ned_frd, v)) == pytest.approx(v, abs=1e-12)
    assert rotate(turned(np.array([[0.0, 0.0, np.pi / 2.0]])), np.array([1.0, 0.0, 0.0])) == pytest.approx(
        np.array([[0.0, 1.0, 0.0]])
    )


def _evaluated(cores: int, monkeypatch: pytest.MonkeyPatch, samples: Samples) -> F64:
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    flight = track(samples)
    p = params_row(hidden(quad(), {"linear_drag": {"d_x_kgps": 0.2, "d_y_kgps": 0.3, "d_z_kgps": 0.4}}), flight.step_s)
    return ModelEvaluation(p, flight).moved(p)


def test_on_several_cores_it_is_the_same_and_in_a_forked_process_too(
    exact: Samples, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A child has none of the threads that its parent began."""
    alone = _evaluated(1, monkeypatch, exact)
    assert np.array_equal(_evaluated(4, monkeypatch, exact), alone)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(writer, b"same" if np.array_equal(_evaluated(4, monkeypatch, exact), alone) else b"else")
        os._exit(0)
    try:
        assert select.select([reader], [], [], 60.0)[0], "the child stands still"
        assert os.read(reader, 4) == b"same"
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(reader)
        os.close(writer)
