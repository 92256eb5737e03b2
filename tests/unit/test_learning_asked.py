"""Thrust that a reference asks for, told from thrust that answers errors of the estimate."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shipped import load_scenario, load_vehicle

from flightstack.learning import asked
from flightstack.learning.learner import GpLearner
from flightstack.model import Limits, Model
from flightstack.stack import Stack
from flightstack.vehicle import with_effects
from tests.closed_loop import fly
from tests.thorough import thorough

DT_S, LAG_S = 0.004, 0.05
SIH = load_vehicle("px4-sihsim-quadx")


def test_what_a_lagged_reference_explains_at_any_level_is_not_apart_and_the_rest_is() -> None:
    """Asked for 1 + 0.3 sin(2 t): applied is 1.4 times its first-order lag in closed form, and then 0.1 sin(40 t)."""
    row = np.zeros(asked.ROW)
    gain, phase = 1.0 / math.hypot(1.0, 2.0 * LAG_S), math.atan(2.0 * LAG_S)
    times = np.arange(0.0, 60.0, DT_S)
    apart, answers = [], 0.1 * np.sin(40.0 * times)
    for time, answer in zip(times, answers, strict=True):
        row[asked.NOW] = 1.0 + 0.3 * math.sin(2.0 * (time + 0.5 * DT_S))
        lagged = 1.0 + 0.3 * gain * math.sin(2.0 * (time + DT_S) - phase)
        apart.append(asked.apart(row, 1.4 * lagged + answer, DT_S, LAG_S))
    np.testing.assert_allclose(apart[5000:], answers[5000:], atol=5e-3)


def test_where_no_reference_asks_nothing_is_apart() -> None:
    assert asked.apart(np.zeros(asked.ROW), 0.9, DT_S, LAG_S) == 0.0


@pytest.mark.parametrize("seed", [13, thorough(14), thorough(15), thorough(16)])
def test_with_twice_the_drag_and_a_poor_estimator_the_gain_is_right(seed: int) -> None:
    """Velocity's errors come back through the drag and through thrust: 0.959 to 0.978 with thrust as it was applied."""

    def learning(model: Model, limits: Limits) -> Stack:
        return Stack(model, limits, learner=GpLearner(model))

    truth = with_effects(SIH, {"linear_drag": {"d_x_kgps": 2.0, "d_y_kgps": 2.0, "d_z_kgps": 2.0}})
    scenario = load_scenario("paper-tracking").with_duration(40.0)
    learned = fly(scenario, SIH, seed=seed, grade="px4-sih", make_stack=learning, truth=truth).records[-1].learned
    assert abs(learned.thrust_gain - 1.0) <= min(0.03, 3.0 * learned.thrust_gain_sigma)
