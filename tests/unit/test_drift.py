"""Noise that wanders beside a function of the path: bounds hold for both, and the one is not taken for the other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from shipped import load_vehicle

from flightstack.barrier.posterior import Accelerations, Posterior, Process, sized_steps
from flightstack.certificate_check.floors import check_drift
from flightstack.certificate_check.knowledge import _process
from flightstack.certificate_check.reading import Refused
from flightstack.gp import Constant, Kernel, SquaredExponential
from flightstack.gp.kernels import Sum
from flightstack.learning.learner import Learnt
from flightstack.learning.priors import default_priors
from flightstack.learning.store import Evidence
from flightstack.model import Model
from flightstack.types import F64

PRIOR = default_priors().lateral.kernel
NOISE, WINDOWS, STEP_S, K = 0.014, 250, 0.06, 4.31


def drawn_kernel(size: float) -> Kernel:
    """The prior's named part, and its smooth one of so many of its sizes."""
    assert isinstance(PRIOR, Sum)
    assert isinstance(PRIOR.right, SquaredExponential)
    smooth = replace(PRIOR.right, variance=PRIOR.right.variance * max(size, 1e-6) ** 2)
    return PRIOR.left + smooth


def flight(seed: int, size: float, drift: float, time_s: float) -> tuple[Evidence, F64, F64]:
    """Windows of a loop of 12 s with some wandering, queries at the corners of what a region asks, and the truth there.

    `drift`: variance in shares of the noise's, a first-order Gauss-Markov process of `time_s`.
    """
    rng = np.random.default_rng(seed)
    t = STEP_S * np.arange(WINDOWS)
    phase, around = 2.0 * math.pi * t / 12.0, np.cumsum(rng.normal(0.0, 0.01, (WINDOWS, 5)), axis=0)
    x = np.zeros((WINDOWS, 7))
    x[:, 0], x[:, 1], x[:, 2] = 0.8 * np.cos(phase), 0.8 * np.cos(2.0 * phase), 0.3 * np.sin(phase)
    x[:, 3], x[:, 4], x[:, 5] = 0.07 - 0.04 * np.sin(phase), -0.08 * np.sin(2.0 * phase), 1.4 + 0.05 * np.cos(phase)
    x[:, :5] += 0.3 * around * np.array([1.0, 1.0, 0.5, 0.1, 0.1])
    queries = np.zeros((16, 7))
    queries[:, :3] = rng.choice([-1.0, 1.0], (16, 3)) * np.array([1.8, 1.8, 0.9])
    queries[:, 3:5], queries[:, 5] = rng.choice([-0.25, 0.25], (16, 2)), 1.4
    both = np.vstack([x, queries])
    root = np.linalg.cholesky(drawn_kernel(size).matrix(both) + 1e-9 * np.eye(len(both)))
    truth = root @ rng.normal(size=(len(both), 2))
    left, wander = math.exp(-STEP_S / time_s), np.zeros((WINDOWS, 2))
    shocks = rng.normal(size=(WINDOWS, 2))
    wander[0] = shocks[0]
    for i in range(1, WINDOWS):
        wander[i] = left * wander[i - 1] + math.sqrt(1.0 - left * left) * shocks[i]
    y = truth[:WINDOWS] + NOISE * (rng.normal(size=(WINDOWS, 2)) + math.sqrt(drift) * wander)
    last = np.round(1e6 * t).astype(np.int64) + 1_000_000
    spans_us = np.stack([last - 56_000, last], axis=1)
    return Evidence(PRIOR, NOISE**2, 300, np.full(2, 0.0075**2), x, y, spans_us), queries, truth[WINDOWS:]


def known(evidence: Evidence, dated: bool = True) -> Posterior:
    """What a certificate makes of it; not dated: noise is taken for white."""
    process = Process.resting_on(evidence)
    *_, sized = sized_steps(process if dated else replace(process, spans_us=np.zeros((0, 2), np.int64)))
    *_, coloured = sized.coloured_steps(evidence, [])
    *_, raised = coloured.widened(*evidence.pooled(100)).raised().coloured_steps(evidence, [])
    return raised


def bound(posterior: Posterior, queries: F64) -> F64:
    colour, (_, variance) = posterior.process.colour, posterior.at(queries)
    wide = K * np.sqrt(colour.inflation**2 * variance[:, None] + posterior.process.excess)
    found: F64 = wide + colour.remainder_mps2 * (1.0 + posterior.weight_sums(queries)[:, None])
    return found


def test_each_store_rests_on_points_of_its_own() -> None:
    evidence = replace(flight(500, 0.25, 0.0, 2.0)[0], capacity=100)
    other = replace(evidence, places=evidence.places + 0.1 * np.sin(np.arange(WINDOWS))[:, None])
    smaller = replace(evidence, capacity=80)
    for vertical in (evidence, other, smaller):
        *_, frozen = Accelerations.frozen_steps(Learnt(evidence, vertical), Model.from_vehicle(load_vehicle("quad-x")))
        assert frozen is not None
        for each, posterior in ((evidence, frozen.lateral), (vertical, frozen.vertical)):
            np.testing.assert_array_equal(posterior.process.x, each.places[each.chosen(each.capacity)])


@pytest.mark.parametrize(("drift", "time_s"), [(0.0, 2.0), (0.25, 2.0), (1.0, 0.5), (0.25, 8.0)])
def test_bounds_hold_whatever_is_function_and_whatever_is_drift(drift: float, time_s: float) -> None:
    for seed, size in enumerate((0.0, 0.06, 0.25, 1.0) * 3):
        evidence, queries, truth = flight(500 + seed, size, drift, time_s)
        posterior = known(evidence)
        assert np.all(np.abs(truth - posterior.mean(queries)) <= bound(posterior, queries)), (seed, size)


def test_drift_is_not_taken_for_a_function_of_the_path() -> None:
    """Where it is, one flight in some has bounds several times as wide."""
    widths = []
    for seed in range(6):
        evidence, queries, _ = flight(700 + seed, 0.0, 0.25, 2.0)
        widths.append([bound(known(evidence, dated), queries).mean() for dated in (True, False)])
    worst, worst_white = np.array(widths).max(axis=0)
    assert worst < 0.5 * worst_white, widths
    assert worst < 0.4


def test_a_large_function_stays_large_beside_drift() -> None:
    for seed in range(4):
        kernel = known(flight(800 + seed, 1.0, 0.25, 2.0)[0]).process.kernel
        assert isinstance(kernel, Sum)
        assert isinstance(kernel.right, SquaredExponential)
        assert kernel.right.variance >= 0.6**2 / 16.0


def test_the_checker_works_out_the_same_and_refuses_drift_that_the_rule_does_not_give() -> None:
    evidence, queries, _ = flight(3, 0.0, 1.0, 2.0)
    posterior = known(evidence)
    file = posterior.process.as_json()
    assert file["drift"]
    stated = _process(file, 2, "lateral")
    mean, variance, _ = stated.at(queries, "queries")
    np.testing.assert_allclose(mean, posterior.mean(queries), rtol=0.0, atol=1e-9)
    ours = posterior.process.colour.inflation**2 * posterior.at(queries)[1][:, None] + posterior.process.excess
    np.testing.assert_allclose(variance, ours, rtol=1e-6)
    noise, excess = NOISE**2, np.full(2, NOISE**2)
    check_drift((0.25 * noise, 2.0), noise, excess, True, "lateral")
    for drift, dated in (((1.1 * noise, 2.0), True), ((0.25 * noise, 20.0), True), ((0.25 * noise, 2.0), False)):
        with pytest.raises(Refused, match=r"lateral\.drift"):
            check_drift(drift, noise, excess, dated, "lateral")
    with pytest.raises(Refused, match=r"lateral\.excess"):
        check_drift((0.99 * noise, 2.0), noise, excess, True, "lateral")
    with pytest.raises(Refused, match=r"lateral\.drift"):
        check_drift((-noise, 2.0), noise, excess, True, "lateral")


def test_without_stamps_there_is_no_drift() -> None:
    x, y = np.zeros((30, 7)), np.random.default_rng(1).normal(0.0, NOISE, (30, 1))
    *_, sized = sized_steps(Process(Constant(1.0) + PRIOR.right, NOISE**2, x, y, np.zeros(1)))  # type: ignore[attr-defined]
    assert sized.process.drift.variance == 0.0
