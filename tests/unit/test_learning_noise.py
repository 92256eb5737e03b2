"""How noisy a window is, as the learner measures it: the truth is drawn here, its colour included."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from flightstack.learning import sampler as s
from flightstack.learning.learner import LearnerConfig
from flightstack.learning.priors import StorePrior, default_priors
from flightstack.learning.store import Store
from flightstack.learning.watch import Watch
from flightstack.types import F64

TICKS = 15


def measured(noise: F64, slow: F64 | None = None) -> F64:
    """(3,) variance of a window's mean as the watch finds it; `noise` (n, 3) on a target that moves slowly."""
    watch = Watch(TICKS, 6.0)
    sample, expected, variance = np.zeros(s.SAMPLE), np.zeros(3), np.ones(3)
    for k, row in enumerate(noise):
        sample[s.S_TARGET : s.S_TARGET + 3] = row + (0.0 if slow is None else slow[k])
        watch.step(sample, expected, variance)
        if watch.full:
            watch.take()
    return watch.noise_var


def coloured(kind: str, n: int, rng: np.random.Generator) -> F64:
    white = rng.normal(size=(n + 100, 3))
    if kind == "white":
        return white[100:]
    if kind == "trapezoid":
        return 0.5 * (white[100:] + white[99:-1])
    return np.asarray(lfilter([1.0], [1.0, -0.4], white, axis=0)[100:])


@pytest.mark.parametrize("kind", ["white", "trapezoid", "first-order"])
def test_a_windows_noise_is_that_of_its_mean_whatever_the_colour(kind: str) -> None:
    """The oracle is the variance of the means themselves; differences of samples find a third of the trapezoid's."""
    rng = np.random.default_rng(5)
    scale = np.array([0.35, 1.2, 1.0])
    noise = coloured(kind, 600 * TICKS, rng) * scale
    true = coloured(kind, 20_000 * TICKS, rng).reshape(-1, TICKS, 3).mean(axis=1).var(axis=0) * scale**2
    np.testing.assert_allclose(measured(noise), true, rtol=0.35)


def test_what_moves_slowly_is_no_noise() -> None:
    rng = np.random.default_rng(6)
    noise = 0.1 * coloured("white", 600 * TICKS, rng)
    slow = 0.5 * np.sin(0.9 * 0.004 * np.arange(len(noise)))[:, None]
    np.testing.assert_allclose(measured(noise, slow), 0.01 / TICKS, rtol=0.5)


def test_after_three_windows_the_noise_is_known_within_a_factor_of_two() -> None:
    rng = np.random.default_rng(7)
    ratios = [measured(coloured("trapezoid", 3 * TICKS, rng)) / (1.0 / TICKS) for _ in range(100)]
    assert 0.5 < np.median(ratios) < 2.0


def filled(noise_std: float, offset: float, windows: int, seed: int, *, prior: StorePrior | None = None) -> Store:
    """A vertical store that hovers, with noise in each window and an offset of changing sign that no kernel can say."""
    prior = prior or default_priors().vertical
    store = Store(prior, inputs=s.D, outputs=1, capacity=300, floor=LearnerConfig().floor_mps2)
    rng = np.random.default_rng(seed)
    for k in range(windows):
        x = np.zeros(s.D)
        x[s.THRUST] = 1.0 + 0.02 * rng.normal()
        x[s.V_X] = rng.normal()
        store.hear(noise_std**2)
        shift = offset * np.sign(np.sin(0.2 * k))
        store.take(x, np.array([noise_std * rng.normal() + shift]))
    return store


@pytest.mark.parametrize("noise_std", [0.02, 0.41])
def test_noise_alone_is_no_doubt_of_the_model(noise_std: float) -> None:
    """Three sigma of the doubt that noise alone leaves are below half of its own deviation, however large."""
    for seed in range(10):
        store = filled(noise_std, 0.0, 600, seed)
        assert 3.0 * np.sqrt(store.excess[0]) < max(0.5 * noise_std, 3.2 * LearnerConfig().floor_mps2)


def test_one_outlier_widens_the_bound_and_is_forgotten() -> None:
    store = filled(0.05, 0.0, 200, 1)
    x = np.zeros(s.D)
    x[s.THRUST] = 1.0
    calm = float(store.excess[0])
    store.take(x, np.array([2.0]))
    assert 3.0 * np.sqrt(store.excess[0]) > 1.0
    for k in range(1200):
        x[s.V_X] = np.sin(k)
        store.take(x, np.array([0.05 * np.cos(7.0 * k)]))
    assert store.excess[0] < max(4.0 * calm, 2e-3)


def test_what_the_kernel_cannot_say_is_doubt_under_noise_too() -> None:
    """An offset of 0.5 m/s^2 that changes its sign every second: noise of 0.41 a window must not hide it."""
    assert 3.0 * np.sqrt(filled(0.41, 0.5, 600, 2).excess[0]) > 0.5
