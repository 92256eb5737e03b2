"""Likelihoods of a process' sizes and noises against SciPy's density of the points' whole covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from flightstack.barrier.sizes import SHARES, SmoothSizes
from flightstack.types import F64

COUNT, NOISE_VAR, TIME_S = 250, 0.014**2, 2.0


def loop(count: int, wander: float) -> tuple[F64, F64]:
    """Times, and speeds and leans of so many windows on laps of 12 s that are no longer the same after a while."""
    rng = np.random.default_rng(3)
    t = np.cumsum(np.where(rng.uniform(size=count) < 0.05, 1.5, 0.06))
    phase = 2.0 * math.pi * t / 12.0
    x = np.stack([0.8 * np.cos(phase), 0.8 * np.cos(2.0 * phase), 0.3 * np.sin(phase), 0.1 * np.sin(phase)], axis=1)
    return t, x + wander * rng.normal(size=x.shape) * np.array([1.0, 1.0, 0.5, 0.1])


def parts(x: F64) -> tuple[F64, F64, F64]:
    """A root of the covariance of a constant and drag, that of a smooth function, and a root of a force's."""
    apart = ((x[:, None, :] - x[None, :, :]) / np.array([4.0, 4.0, 4.0, 0.5])) ** 2
    named = np.hstack([np.ones((len(x), 1)), 0.5 * x[:, :3]])
    return named, 0.36 * np.exp(-0.5 * apart.sum(axis=2)), x[:, 3:]


@pytest.mark.parametrize("outputs", [1, 2])
@pytest.mark.parametrize("wander", [0.02, 0.3])
def test_the_likelihood_is_that_of_the_whole_covariance(outputs: int, wander: float) -> None:
    t, x = loop(COUNT, wander)
    root, smooth, push = parts(x)
    named = root @ root.T
    drift = np.exp(-np.abs(t[:, None] - t[None, :]) / TIME_S)
    rng = np.random.default_rng(4)
    y = np.linalg.cholesky(named + 0.1 * smooth + NOISE_VAR * np.eye(COUNT)) @ rng.normal(size=(COUNT, outputs))
    sizes = SmoothSizes(root, np.tril(smooth), y, NOISE_VAR, t, TIME_S, push)
    assert sizes.worth_it
    assert sizes.columns.shape[1] < 0.6 * COUNT
    for share in SHARES:
        for white, drifting in ((1.0, 0.0), (1.0, 0.25), (1.5, 0.25), (1.0, 1.0)):
            for forced in (False, True):
                whole = named + share * smooth + NOISE_VAR * (white * np.eye(COUNT) + drifting * white * drift)
                whole += push @ push.T if forced else 0.0
                wanted = multivariate_normal(np.zeros(COUNT), whole).logpdf(y.T).sum()
                ours = sizes.log_likelihood(share, white * NOISE_VAR, drifting * white * NOISE_VAR, forced)
                assert ours - 0.5 * outputs * COUNT * math.log(2.0 * math.pi) == pytest.approx(wanted, abs=2e-3)


def test_values_that_are_all_alike_or_nothing_have_likelihoods() -> None:
    """Two outputs that are the same leave a corner of rank one, none at all one of zeros."""
    t, x = loop(COUNT, 0.3)
    root, smooth, _ = parts(x)
    y = np.repeat(np.random.default_rng(5).normal(size=(COUNT, 1)), 2, axis=1)
    one, two, none = (SmoothSizes(root, smooth, v, NOISE_VAR, t, TIME_S) for v in (y[:, :1], y, 0.0 * y))
    alone, nothing = (each.log_likelihood(0.25, NOISE_VAR, 0.0) for each in (one, none))
    assert two.log_likelihood(0.25, NOISE_VAR, 0.0) == pytest.approx(2.0 * alone, rel=1e-12)
    whole = root @ root.T + 0.25 * smooth + NOISE_VAR * np.eye(COUNT)
    assert nothing == pytest.approx(-np.linalg.slogdet(whole)[1], abs=2e-3)


def test_a_function_that_is_as_rough_as_its_points_are_far_apart_is_not_shortened() -> None:
    t, x = loop(80, 3.0)
    root, smooth, _ = parts(20.0 * x)
    assert not SmoothSizes(root, smooth, x[:, :1], NOISE_VAR, t, TIME_S).worth_it


def test_stamps_that_fall_are_not_filtered() -> None:
    t, x = loop(COUNT, 0.02)
    root, smooth, _ = parts(x)
    assert not SmoothSizes(root, smooth, x[:, :1], NOISE_VAR, t[::-1], TIME_S).worth_it
