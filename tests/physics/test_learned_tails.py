"""The learner's bound against the truth, axis by axis, task by task: beyond three sigma at most 0.3 % of the ticks.

A hover tells most: one sensor's bias, the same throughout, is all that there is to be wrong about.
"""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.calibration import true_residual_frd_mps2
from flightstack.cli import files
from flightstack.learning.learner import GpLearner
from flightstack.model import Model
from flightstack.stack import Stack
from flightstack.types import F64
from tests.closed_loop import fly
from tests.thorough import THOROUGH, thorough

VALID = 2.0
MOST = np.full(3, 0.003)
LIFT = np.array([0.003, 0.003, 0.009])
"""A fifth of the thrust as translational lift is more than the vertical prior expects (0.12 m/s^2 and what is linear):
the first fast laps miss more, 0.81 % over these seeds (0.4 to 1.0 by seed); a prior as wide would cost certificates
(docs/limits.md)."""


def misses(task: str, seed: int) -> F64:
    """(n, 3) whether each tick's true residual lies beyond three sigma, body axes, once the learner is valid."""
    believed, _ = files.load_vehicle(None)
    model, (scenario, _) = Model.from_vehicle(believed), files.load_scenario(task)
    flight = fly(
        scenario, believed, seed=seed, make_stack=lambda model, limits: Stack(model, limits, learner=GpLearner(model))
    )
    told = [(r.learned, t) for r, t in zip(flight.records, flight.truths, strict=True) if r.learned.stage >= VALID]
    mean, sigma = (np.array([getattr(a, key) for a, _ in told]) for key in ("residual_frd_mps2", "sigma_frd_mps2"))
    force, motors, vel, q = (
        np.array([getattr(t, key) for _, t in told])
        for key in ("specific_force_frd_mps2", "motor_u", "vel_ned_mps", "q_ned_frd")
    )
    return 1.0 * (np.abs(true_residual_frd_mps2(model, force, motors, vel, q) - mean) > 3.0 * sigma)


@pytest.mark.parametrize(
    ("task", "seeds", "most"),
    [
        thorough("hover", range(200, 208), MOST),
        ("figure8", range(200, 203 if THOROUGH else 201), MOST),
        thorough("steady-wind", range(200, 203), MOST),
        thorough("rotor-drag", range(200, 206), LIFT),
    ],
)
def test_the_truth_lies_beyond_three_sigma_in_no_more_than_a_normal_distributions_share(
    task: str, seeds: range, most: F64
) -> None:
    found = np.concatenate([misses(task, seed) for seed in seeds])
    assert len(found) > 5000
    assert (found.mean(axis=0) <= most).all(), found.mean(axis=0)
