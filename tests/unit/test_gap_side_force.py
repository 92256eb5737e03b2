"""Which of position and velocity errs, told by the side force; the truth is what was added to made-up signals."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from flightstack.gap.records import Samples
from flightstack.gap.side_force import velocity_share
from flightstack.gap.track import track
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack_logs.turn import multiply, rotate_inverse, turned
from tests.gap_flights import Flown, as_samples, fly, hidden, quad, wander

DRAG = {"linear_drag": {"d_x_kgps": 1.0, "d_y_kgps": 1.0, "d_z_kgps": 1.0}}


def slow(count: int, dt_s: float, seed: int, std: float = 1.0, below_hz: float = 0.2) -> F64:
    """(N, 3) noise below a frequency, flat beneath it."""
    white = np.random.default_rng(seed).standard_normal((count, 3))
    out = sosfiltfilt(butter(2, below_hz, fs=1.0 / dt_s, output="sos"), white, axis=0)
    return np.asarray(std * out / out.std(axis=0))


def inertial_errors(samples: Samples, std_mps: float, seed: int) -> Samples:
    """The flight by a filter that believes its IMU: it tilts, and its velocity errs by what the tilt adds up to."""
    off = slow(len(samples.t_s), samples.dt_s, seed, std_mps)
    faster = np.gradient(off, samples.dt_s, axis=0) / STANDARD_GRAVITY_MPS2
    tilt = np.stack([faster[:, 1], -faster[:, 0], 0.0 * faster[:, 2]], axis=1)
    return replace(samples, vel_ned_mps=samples.vel_ned_mps + off, q_ned_frd=multiply(turned(tilt), samples.q_ned_frd))


@pytest.fixture(scope="module")
def flown() -> Flown:
    truth = hidden(quad(), DRAG)
    return fly(truth, truth, wander(), seconds=45.0, seed=6)


def first(samples: Samples, seconds: float) -> Samples:
    """The beginning of a flight."""
    count, rows = round(seconds / samples.dt_s), len(samples.t_s)
    each = {field.name: getattr(samples, field.name) for field in fields(samples)}
    return replace(samples, **{k: v[:count] for k, v in each.items() if isinstance(v, np.ndarray) and len(v) == rows})


@pytest.mark.parametrize("seconds", [20.0, 45.0])
def test_a_velocity_that_errs_as_its_own_inertia_does_is_mended_by_the_position(flown: Flown, seconds: float) -> None:
    """An autopilot that believes its IMU more than it may: 0.3 m/s, as PX4's with its own simulator."""
    for seed in range(3):
        errs = first(inertial_errors(as_samples(flown), 0.3, seed), seconds)
        flight = track(errs)
        true, rows = flown.true_vel[: len(errs.t_s)], flight.usable
        raw = np.sqrt(np.mean((errs.vel_ned_mps - true)[rows] ** 2, axis=0))
        left = np.sqrt(np.mean((flight.vel_ned_mps - true)[rows] ** 2, axis=0))
        assert np.all(left[:2] < 0.6 * raw[:2])
        assert np.all(flight.vel_std_mps[:2] > 0.6 * left[:2])


def test_a_velocity_beside_a_position_that_errs_stays(flown: Flown) -> None:
    samples = as_samples(flown)
    way = np.cumsum(slow(len(samples.t_s), samples.dt_s, 4, 0.3), axis=0) * samples.dt_s
    flight = track(replace(samples, pos_ned_m=samples.pos_ned_m + way))
    off = (flight.vel_ned_mps - flown.true_vel)[flight.usable]
    assert np.all(np.sqrt(np.mean(off[:, :2] ** 2, axis=0)) < 0.05)


def test_of_two_that_err_alike_each_has_a_half_and_without_drag_nothing_is_told(flown: Flown) -> None:
    """The share that leaves the least error of two independent ones is that of their variances."""
    samples = as_samples(flown)
    count, dt = len(samples.t_s), samples.dt_s
    shares, errors, rows = [], [], np.ones(count, np.bool_)
    for seed in range(12):
        own, other = slow(count, dt, seed, 0.3), slow(count, dt, 100 + seed, 0.3)
        level = rotate_inverse(samples.q_ned_frd, flown.true_vel)
        force = -0.8 * level + 0.05 * np.random.default_rng(seed).standard_normal((count, 3))
        share, error = velocity_share(other - own, flown.true_vel + own, samples.q_ned_frd, force, rows, dt)
        shares.append(share)
        errors.append(error)
        no_drag = force + 0.8 * level
        told = velocity_share(other - own, flown.true_vel + own, samples.q_ned_frd, no_drag, rows, dt)
        assert told[1] == np.inf
    assert np.mean(shares) == pytest.approx(0.5, abs=0.1)
    assert np.median(np.abs(np.array(shares) - 0.5) / errors) < 1.5
