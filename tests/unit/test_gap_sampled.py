"""The part of the noise floor that no sensor makes: what a log doesn't know of the motors' commands."""

from __future__ import annotations

import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from flightstack.gap import pooled
from flightstack.gap.records import Figures, Samples
from flightstack.gap.sampled import sampling_floor, timing_s
from tests.gap_flights import Flown, as_samples, fly, hidden, quad, wander

HZ, SWING, MEAN = 3.0, 0.05, 0.45


@pytest.fixture(scope="module")
def flown() -> Flown:
    return fly(quad(), quad(), wander(), seconds=20.0, seed=3)


@pytest.fixture(scope="module")
def samples(flown: Flown) -> Samples:
    return as_samples(flown)


def with_commands(samples: Samples, command: np.ndarray) -> Samples:
    return replace(samples, motor=np.repeat(command[:, None], 4, axis=1))


def test_steady_commands_hide_nothing(samples: Samples) -> None:
    steady = with_commands(samples, np.full(len(samples.t_s), MEAN))
    floor = sampling_floor(quad(), steady, steady.valid)
    assert astuple(floor) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_commands_that_swing_may_have_acted_sooner_or_later(samples: Samples) -> None:
    """A sine's change over the timing's error: amplitude times angular frequency times seconds, through the lag."""
    v, omega = quad(), 2.0 * math.pi * HZ
    swinging = with_commands(samples, MEAN + SWING * np.sin(omega * samples.t_s))
    force = sampling_floor(v, swinging, swinging.valid).one_step_mps2
    slope = 2.0 * MEAN * v.max_total_thrust_n / v.mass_kg  # thrust goes with the command's square
    followed = 1.0 / math.hypot(1.0, omega * v.rotors.time_constant_s)
    expected = slope * SWING / math.sqrt(2.0) * omega * followed * timing_s(samples.dt_s)
    assert force == pytest.approx(expected, rel=0.1)  # and a little for what a straight line between stamps leaves out


def test_a_log_without_motors_has_no_such_part(samples: Samples) -> None:
    blind = replace(samples, motor=np.full_like(samples.motor, np.nan))
    assert sampling_floor(quad(), blind, blind.valid) == Figures(0.0, 0.0, 0.0)


@pytest.mark.parametrize("lacks", [(), ("accel_frd_mps2",), ("accel_frd_mps2", "rate_frd_radps")])
def test_the_true_models_path_is_no_gap_whatever_the_log_lacks(flown: Flown, lacks: tuple[str, ...]) -> None:
    """White noise on exact states, commands of a faster loop, sensors that are missing: the truth is at its floor."""
    rng, exact = np.random.default_rng(5), as_samples(flown, exact=True)
    noise = {
        "pos_ned_m": 0.002,
        "vel_ned_mps": 0.015,
        "q_ned_frd": 6e-4,
        "rate_frd_radps": 3e-3,
        "accel_frd_mps2": 0.06,
    }
    noisy = {name: np.array(getattr(exact, name)) for name in noise}
    for name, std in noise.items():
        noisy[name] += std * rng.standard_normal(noisy[name].shape)
    noisy["q_ned_frd"] /= np.linalg.norm(noisy["q_ned_frd"], axis=1, keepdims=True)
    noisy |= {name: np.full_like(exact.accel_frd_mps2, np.nan) for name in lacks}
    of = pooled.split([replace(exact, derived=lacks, motor=flown.motor, **noisy)], [])
    after, before = (pooled.figures(v, of) for v in (quad(), hidden(quad(), {"payload": {"mass_kg": 0.4}})))
    floor = pooled.noise_floor(quad(), of, after).rollout_1s_m
    assert floor == pytest.approx(after.rollout_1s_m, rel=0.2)
    assert before.rollout_1s_m > 2.0 * floor
