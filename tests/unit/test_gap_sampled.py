"""The part of the noise floor that no sensor makes: what a log doesn't know of the motors' commands."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flightstack.gap.records import Samples
from flightstack.gap.sampled import sampling_floor, timing_s
from tests.gap_flights import as_samples, fly, quad, wander

HZ, SWING, MEAN = 3.0, 0.05, 0.45


@pytest.fixture(scope="module")
def flown() -> Samples:
    return as_samples(fly(quad(), quad(), wander(), seconds=20.0, seed=3))


def with_commands(samples: Samples, command: np.ndarray) -> Samples:
    return replace(samples, motor=np.repeat(command[:, None], 4, axis=1))


def test_steady_commands_hide_nothing(flown: Samples) -> None:
    steady = with_commands(flown, np.full(len(flown.t_s), MEAN))
    assert sampling_floor(quad(), steady, steady.valid) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_commands_that_swing_may_have_acted_sooner_or_later(flown: Samples) -> None:
    """A sine's change over the timing's error: amplitude times angular frequency times seconds, through the lag."""
    v, omega = quad(), 2.0 * math.pi * HZ
    swinging = with_commands(flown, MEAN + SWING * np.sin(omega * flown.t_s))
    force, _ = sampling_floor(v, swinging, swinging.valid)
    slope = 2.0 * MEAN * v.max_total_thrust_n / v.mass_kg  # thrust goes with the command's square
    followed = 1.0 / math.hypot(1.0, omega * v.rotors.time_constant_s)
    expected = slope * SWING / math.sqrt(2.0) * omega * followed * timing_s(flown.dt_s)
    assert force == pytest.approx(expected, rel=0.1)  # and a little for what a straight line between stamps leaves out


def test_a_log_without_motors_has_no_such_part(flown: Samples) -> None:
    blind = replace(flown, motor=np.full_like(flown.motor, np.nan))
    assert sampling_floor(quad(), blind, blind.valid) == (0.0, 0.0)
