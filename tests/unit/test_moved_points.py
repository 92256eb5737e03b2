"""A point that was moved to the thrust that was asked for is learned, but no evidence: no log could tell it."""

from __future__ import annotations

import numpy as np
from shipped import load_vehicle

from flightstack.learning import sampler as s
from flightstack.learning.learner import FullWindow, GpLearner, LearnerState, _take_turn
from flightstack.model import Model


def take_turns(state: LearnerState, window: FullWindow) -> None:
    for turn in window.left:
        _take_turn(state, window, turn)


def test_only_a_window_whose_mean_it_is_stands_behind_a_point_of_the_evidence() -> None:
    state = GpLearner(Model.from_vehicle(load_vehicle("quad-x"))).init()
    rng = np.random.default_rng(3)
    quiet, loud = 0.1 * state.noise_quiet, 10.0 * state.noise_quiet
    means = []
    for k in range(20):
        mean = rng.normal(0.0, 0.3, s.D + 10)
        mean[s.THRUST], mean[s.D + 9] = 1.0 + 0.1 * rng.normal(), 0.05
        noise = np.full(3, loud if k < 5 else quiet)
        take_turns(state, FullWindow(mean, noise, (1000 * k, 1000 * k + 60)))
        means.append(mean[: s.D])
    assert len(state.vertical.gp) == 20
    found = state.vertical.evidence()
    assert found.spans_us[:, 0].tolist() == [1000 * k for k in range(5, 20)]
    assert np.array_equal(found.places, np.array(means[5:]))
    assert state.lateral.evidence().spans_us[:, 0].tolist() == [1000 * k for k in range(20)]


def test_a_store_of_moved_points_alone_has_no_evidence() -> None:
    state = GpLearner(Model.from_vehicle(load_vehicle("quad-x"))).init()
    mean = np.full(s.D + 10, 0.1)
    mean[s.THRUST] = 1.0
    assert not state.vertical.has_evidence
    take_turns(state, FullWindow(mean, np.full(3, 10.0 * state.noise_quiet), (0, 60)))
    assert not state.vertical.has_evidence
    take_turns(state, FullWindow(mean + 0.01, np.full(3, 0.1 * state.noise_quiet), (100, 160)))
    assert state.vertical.has_evidence
