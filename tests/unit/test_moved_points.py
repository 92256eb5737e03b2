"""A point moved to the thrust that was asked for is learned; evidence is its window's mean, as a log has it."""

from __future__ import annotations

import numpy as np
from shipped import load_vehicle

from flightstack.learning import sampler as s
from flightstack.learning.learner import FullWindow, GpLearner, _take_turn
from flightstack.model import Model


def test_evidence_is_what_the_windows_were_and_what_is_learned_is_what_was_asked_for() -> None:
    state = GpLearner(Model.from_vehicle(load_vehicle("quad-x"))).init()
    rng = np.random.default_rng(3)
    quiet, loud = 0.1 * state.noise_quiet, 10.0 * state.noise_quiet
    means = []
    for k in range(20):
        mean = rng.normal(0.0, 0.3, s.D + 10)
        mean[s.THRUST], mean[s.D + 9] = 1.0 + 0.1 * rng.normal(), 0.05
        window = FullWindow(mean, np.full(3, loud if k < 5 else quiet), (1000 * k, 1000 * k + 60))
        for turn in window.left:
            _take_turn(state, window, turn)
        means.append(mean)
    all_means = np.array(means)
    for found in state.evidence():
        assert found.spans_us[:, 0].tolist() == [1000 * k for k in range(20)]
        assert np.array_equal(found.places, all_means[:, : s.D])
    assert np.array_equal(state.vertical.evidence().values, all_means[:, s.D + 2 : s.D + 3])
    learned = np.sort(state.vertical.gp.x[:, s.THRUST])
    moved = all_means[:, s.THRUST] - np.where(np.arange(20) < 5, 0.9 * 0.05, 0.0)
    assert np.allclose(learned, np.sort(moved), rtol=0.0, atol=1e-12)
