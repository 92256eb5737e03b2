"""Learning from what PX4 with its simulator delivers: coloured noise, a wrong bias, slow errors of velocity."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from shipped import load_scenario, load_vehicle

from flightstack.learning.learner import GpLearner
from flightstack.model import Limits, Model
from flightstack.stack import Stack
from flightstack.types import Learned
from tests.closed_loop import ClosedLoopFlight, fly
from tests.thorough import thorough

SIH = load_vehicle("px4-sihsim-quadx")
FLIGHTS = [
    ("hover", 11),
    thorough("hover", 12),
    ("figure8", 13),
    thorough("figure8", 14),
    ("paper-tracking", 15),
    thorough("paper-tracking", 16),
]


def learning(model: Model, limits: Limits) -> Stack:
    return Stack(model, limits, learner=GpLearner(model))


@functools.cache
def flown(name: str, seed: int) -> ClosedLoopFlight:
    """What flies is what is believed: gain 1, no force."""
    scenario = load_scenario(name).with_duration(20.0)
    return fly(scenario, SIH, seed=seed, grade="px4-sih", make_stack=learning, truth=SIH)


@pytest.mark.parametrize(("name", "seed"), FLIGHTS)
def test_the_thrust_gain_is_right_within_0_03_and_within_what_is_said_of_it(name: str, seed: int) -> None:
    learned = flown(name, seed).records[-1].learned
    assert abs(learned.thrust_gain - 1.0) <= 0.03
    assert abs(learned.thrust_gain - 1.0) <= 3.0 * learned.thrust_gain_sigma
    assert 3.0 * learned.thrust_gain_sigma < 0.1, "and says something"


@pytest.mark.parametrize(("name", "seed"), FLIGHTS)
def test_the_vertical_bound_is_narrow_though_the_imu_is_noisy(name: str, seed: int) -> None:
    """Three sigma below the 0.6 m/s^2 that a first certificate needs, over the flight's last quarter."""
    records = flown(name, seed).records
    rows = np.array([record.learned.row for record in records[-1250:]])
    assert np.median(3.0 * rows[:, Learned.sigma_frd_mps2.place][:, 2]) < 0.6


@pytest.mark.parametrize(("name", "seed"), FLIGHTS)
def test_a_bias_that_the_filter_takes_out_is_learned_as_no_force(name: str, seed: int) -> None:
    """It reaches 0.35 m/s^2; with it taken for a force the mean sideways residual was up to 0.46."""
    records = flown(name, seed).records
    rows = np.array([record.learned.row for record in records[-2500:]])
    assert np.abs(rows[:, Learned.residual_frd_mps2.place][:, :2].mean(axis=0)).max() < 0.2
    assert np.isnan(records[-1].learned.latency_s), "unknown: this IMU can't show it"
