"""The stated confidence against what it speaks of: noise of known colour, remainders, data chosen as they come in."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import beta

from flightstack.barrier.confidence import ALLOWANCE, LEAST_INFLATION, colour
from flightstack.barrier.posterior import Posterior, Process
from flightstack.certificate_check.confidence import FORMULA, STATEMENT, check_colour, peak
from flightstack.certificate_check.reading import Refused
from flightstack.gp import Constant, Linear, SquaredExponential
from flightstack.types import F64
from tests.thorough import thorough

KERNEL = Constant(1.0) + Linear(0.25, 0) + SquaredExponential(0.09, (1.5,), columns=(0,))
NOISE = 0.1
WINDOWS = 300
K = 4.31
QUERIES = np.linspace(-2.0, 2.0, 17)[:, None]
"""More than the data reach: they lie within -1.6 to 1.6."""


def white(rng: np.random.Generator, n: int) -> F64:
    return NOISE * rng.normal(size=n)


def ar1(phi: float, freedom: float = math.inf) -> Callable[[np.random.Generator, int], F64]:
    """Correlated noise whose innovations keep its variance; with `freedom` these have Student's tails."""

    def make(rng: np.random.Generator, n: int) -> F64:
        shocks = rng.normal(size=n)
        if math.isfinite(freedom):
            shocks = rng.standard_t(freedom, size=n) / math.sqrt(freedom / (freedom - 2.0))
        out = np.empty(n)
        out[0] = shocks[0]
        for i in range(1, n):
            out[i] = phi * out[i - 1] + math.sqrt(1.0 - phi * phi) * shocks[i]
        return NOISE * out

    return make


class Case(NamedTuple):
    noise: Callable[[np.random.Generator, int], F64]
    remainder: float


CASES = {
    "white": Case(white, 0.0),
    "AR(1) 0.6": Case(ar1(0.6), 0.0),
    "AR(1) 0.6 and remainder": Case(ar1(0.6), 0.05),
    "AR(1) 0.8, t4, and remainder": Case(ar1(0.8, 4.0), 0.05),
}


def trial(seed: int, case: Case) -> tuple[bool, bool, float, float]:
    """Whether the plain bound and the stated one hold at every query and time; their mean half widths.

    The data are chosen while they come in: from the middle outwards, and back to where the last values were largest.
    """
    rng = np.random.default_rng(seed)
    grid = np.concatenate([np.linspace(-2.0, 2.0, 81)[:, None], QUERIES])
    gram = KERNEL.matrix(grid) + 1e-10 * np.eye(len(grid))
    truth = np.linalg.cholesky(gram) @ rng.normal(size=len(grid))
    noise, phase = case.noise(rng, WINDOWS), rng.uniform(0.0, 2.0 * math.pi)
    x, y = np.empty((WINDOWS, 1)), np.empty((WINDOWS, 1))
    place = 0.0
    for i in range(WINDOWS):
        reach = 1.6 * min(1.0, (i + 30) / 150.0)
        pull = 0.2 * np.sign(y[i - 1, 0] - y[max(i - 5, 0), 0]) if i else 0.0
        place = float(np.clip(place + 0.15 * rng.normal() + pull * 0.2, -reach, reach))
        at = int(np.argmin(np.abs(grid[:81, 0] - place)))
        x[i] = grid[at]
        slow = case.remainder * math.sin(0.05 * i + phase)
        y[i] = truth[at] + slow + noise[i]
    plain = stated = True
    widths = (0.0, 0.0)
    for n in (100, 200, WINDOWS):
        spans = 60_000 * np.arange(n)[:, None] + np.array([0, 56_000])
        posterior = Posterior(Process(KERNEL, NOISE**2, x[:n], y[:n], np.full(1, 1e-5)))
        found = colour(y[:n] - posterior.at(x[:n])[0], spans, NOISE**2)
        mean, variance = posterior.at(QUERIES)
        off = np.abs(truth[81:] - mean[:, 0])
        simple = K * np.sqrt(variance)
        bound = K * np.sqrt(found.inflation[0] ** 2 * variance + 1.05**2 * 1e-5)
        bound = bound + found.remainder_mps2[0] * (1.0 + posterior.weight_sums(QUERIES))
        plain &= bool(np.all(off <= simple))
        stated &= bool(np.all(off <= bound))
        widths = float(simple.mean()), float(bound.mean())
    return plain, stated, *widths


def upper(failures: int, trials: int) -> float:
    """Clopper and Pearson's upper 95 % limit."""
    return float(beta.ppf(0.95, failures + 1, trials - failures)) if failures < trials else 1.0


@pytest.mark.parametrize("name", [thorough(name) if name == "AR(1) 0.6" else name for name in CASES])
def test_the_stated_bound_fails_no_more_often_than_delta(name: str) -> None:
    """K is that of delta 0.05 by the certificates' own union; three times, 17 queries each."""
    trials = 200 if "t4" in name else 100
    found = [trial(1000 + i, CASES[name]) for i in range(trials)]
    failures = sum(not each[1] for each in found)
    assert upper(failures, trials) <= 0.05, failures
    plain = sum(not each[0] for each in found)
    if "remainder" in name:
        assert plain > 0.2 * trials  # the test can fail: what takes noise for white does
    if name == "white":
        before, after = (float(np.mean([each[i] for each in found])) for i in (2, 3))
        assert after <= 1.3 * before


def spans_of(n: int) -> np.ndarray:
    return 60_000 * np.arange(n)[:, None] + np.array([0, 56_000])


def test_white_noise_costs_little_more_than_the_allowance() -> None:
    rng = np.random.default_rng(5)
    found = [colour(white(rng, 500)[:, None], spans_of(500), NOISE**2) for _ in range(50)]
    inflation = np.array([each.inflation[0] for each in found])
    assert inflation.min() >= LEAST_INFLATION
    assert np.median(inflation) <= 1.2 * LEAST_INFLATION
    assert np.mean([each.remainder_mps2[0] for each in found]) < 0.02 * NOISE


@pytest.mark.parametrize("phi", [-0.6, 0.3, 0.6, 0.8])
def test_the_inflation_is_that_of_the_spectrums_peak(phi: float) -> None:
    """An AR(1)'s spectrum is (1 - phi^2) / |1 - phi e^(-i w)|^2, highest at one end."""
    rng = np.random.default_rng(7)
    exact = (1.0 - phi * phi) / (1.0 - abs(phi)) ** 2
    for n in (500, 2000):
        found = [float(colour(ar1(phi)(rng, n)[:, None], spans_of(n), NOISE**2).inflation[0]) for _ in range(30)]
        assert 0.85 * exact <= np.median(found) ** 2 / ALLOWANCE <= 1.4 * exact
        assert np.mean(np.square(found) >= exact) > 0.6  # the allowance makes up for what the window leaves out


def test_the_inflation_bounds_what_noise_does_to_any_weighted_mean() -> None:
    """Variance of w' noise at most i_B^2 s_r^2 |w|^2: weights that are smooth, that alternate, that ring."""
    rng = np.random.default_rng(8)
    n = 300
    weights = [np.ones(n), np.cos(math.pi * np.arange(n)), np.sin(0.9 * np.arange(n)), rng.normal(size=n)]
    for make in (ar1(0.6), ar1(-0.6)):
        draws = np.array([make(rng, n) for _ in range(400)])
        inflation = np.median([float(colour(draw[:, None], spans_of(n), NOISE**2).inflation[0]) for draw in draws[:40]])
        for w in weights:
            assert (draws @ w).var() <= inflation**2 * NOISE**2 * float(w @ w)


def test_a_slow_remainder_beyond_noise_is_seen() -> None:
    rng = np.random.default_rng(9)
    slow = 0.3 * np.sign(np.sin(2.0 * math.pi * np.arange(600) / 300.0))
    found = colour((0.02 * rng.normal(size=600) + slow)[:, None], spans_of(600), 0.02**2)
    assert found.inflation[0] > 10.0 or found.remainder_mps2[0] > 0.2


def test_gaps_between_windows_are_no_correlation() -> None:
    """Windows a second apart say nothing of noise that lasts a tenth of it; too few say nothing at all."""
    rng = np.random.default_rng(10)
    noise = ar1(0.9)(rng, 6000)[::20]
    apart = 1_000_000 * np.arange(300)[:, None] + np.array([0, 56_000])
    assert colour(noise[:, None], apart, NOISE**2).inflation[0] < 1.5
    assert colour(noise[:5, None], apart[:5], NOISE**2).inflation[0] == LEAST_INFLATION


def test_the_checker_finds_the_same_peak_and_refuses_less() -> None:
    rng = np.random.default_rng(11)
    noise = ar1(0.6)(rng, 1000)
    last = 15 * np.arange(1000) + 14
    found = float(colour(noise[:, None], spans_of(1000), NOISE**2).inflation[0])
    assert peak(noise, last) == pytest.approx(found**2 / ALLOWANCE * NOISE**2, rel=0.15)
    check_colour(noise, last, NOISE**2, found, 1e-5)
    with pytest.raises(Refused, match="the windows show"):
        check_colour(noise, last, NOISE**2, LEAST_INFLATION, 1e-5)
    with pytest.raises(Refused, match="the windows show"):
        check_colour(noise, last, 1e-6 * NOISE**2, found, 1e-5)


def test_maker_and_checker_say_the_same() -> None:
    from flightstack.barrier import confidence

    assert (confidence.STATEMENT, confidence.FORMULA) == (STATEMENT, FORMULA)


def test_the_sum_of_weights_is_the_sum_over_the_points() -> None:
    rng = np.random.default_rng(12)
    x, y = rng.uniform(-2.0, 2.0, (40, 1)), rng.normal(size=(40, 1))
    posterior = Posterior(Process(KERNEL, NOISE**2, x, y, np.full(1, 1e-5)))
    factor = cho_factor(KERNEL.matrix(x) + NOISE**2 * np.eye(40))
    weights = cho_solve(factor, KERNEL.matrix(x, QUERIES))
    np.testing.assert_allclose(posterior.weight_sums(QUERIES), np.abs(weights).sum(axis=0), rtol=1e-9)
