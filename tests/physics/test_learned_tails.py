"""The learner's bound against the truth, axis by axis, task by task: beyond three sigma at most 0.3 % of the ticks.

A hover tells most: one sensor's bias, the same throughout, is all that there is to be wrong about.
"""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.calibration import true_residual_frd_mps2
from flightstack.cli import files
from flightstack.cli.closed_loop import fly
from flightstack.learning.learner import GpLearner
from flightstack.model import Model
from flightstack.stack import Stack
from flightstack.types import F64

VALID = 2.0
MOST = 0.003


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
    ("task", "seeds"),
    [
        ("hover", range(100, 108)),
        ("figure8", range(100, 102)),
        ("steady-wind", range(100, 102)),
        ("rotor-drag", range(100, 102)),
    ],
)
def test_the_truth_lies_beyond_three_sigma_in_no_more_than_a_normal_distributions_share(
    task: str, seeds: range
) -> None:
    found = np.concatenate([misses(task, seed) for seed in seeds])
    assert len(found) > 5000
    assert found.mean(axis=0).max() <= MOST, found.mean(axis=0)
