"""Marginal likelihood and its search, against scikit-learn and finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process import kernels as sk

from flightstack.gp import (
    Constant,
    Kernel,
    Linear,
    Matern,
    SquaredExponential,
    affine_in,
    fit,
    log_marginal_likelihood,
)
from flightstack.types import F64, InputError

RNG = np.random.default_rng(0)
X = RNG.uniform(-2.0, 2.0, (60, 2))
Y = np.column_stack([np.sin(2.0 * X[:, 0]), X[:, 1] * np.cos(X[:, 0])]) + 0.1 * RNG.normal(size=(60, 2))

PAIRS: list[tuple[Kernel, sk.Kernel]] = [
    (SquaredExponential(1.5, (0.7, 1.3)), sk.ConstantKernel(1.5) * sk.RBF([0.7, 1.3])),
    (Matern(1.5, 0.8, 0.9), sk.ConstantKernel(0.8) * sk.Matern(0.9, nu=1.5)),
    (Matern(2.5, 0.8, (0.9, 2.0)), sk.ConstantKernel(0.8) * sk.Matern([0.9, 2.0], nu=2.5)),
    (SquaredExponential(1.0, 0.5) + Constant(0.3), sk.RBF(0.5) + sk.ConstantKernel(0.3)),
]


@pytest.mark.parametrize(("kernel", "oracle"), PAIRS)
def test_the_likelihood_is_that_of_scikit_learn(kernel: Kernel, oracle: sk.Kernel) -> None:
    wanted = sum(
        GaussianProcessRegressor(oracle, alpha=0.02, optimizer=None).fit(X, y).log_marginal_likelihood_value_
        for y in Y.T
    )
    assert log_marginal_likelihood(kernel, 0.02, X, Y)[0] == pytest.approx(wanted, rel=1e-10)


@pytest.mark.parametrize(
    "kernel",
    [
        *(pair[0] for pair in PAIRS),
        Matern(0.5, 0.8, 0.9) * Constant(2.0),
        affine_in(1, SquaredExponential(0.5, 1.0, columns=(0,)), Matern(2.5, 1.0, 0.7)) + Linear(0.2, 0),
    ],
)
def test_its_gradient_is_its_slope(kernel: Kernel) -> None:
    def value(theta: F64) -> float:
        return log_marginal_likelihood(kernel.with_theta(theta[:-1]), math.exp(theta[-1]), X, Y)[0]

    theta, step = np.append(kernel.theta, math.log(0.02)), 1e-5
    shifts = step * np.eye(len(theta))
    slopes = [(value(theta + shift) - value(theta - shift)) / (2 * step) for shift in shifts]
    np.testing.assert_allclose(log_marginal_likelihood(kernel, 0.02, X, Y)[1], slopes, rtol=1e-5, atol=1e-5)


def test_a_fit_finds_what_scikit_learn_finds() -> None:
    bounds = [(1e-3, 1e3)] * 4
    found = fit(SquaredExponential(1.0, (1.0, 1.0)), 0.1, X, Y[:, 1], seed=1, restarts=3, bounds=bounds)
    oracle = sk.ConstantKernel(1.0, (1e-3, 1e3)) * sk.RBF([1.0, 1.0], (1e-3, 1e3)) + sk.WhiteKernel(0.1, (1e-3, 1e3))
    regressor = GaussianProcessRegressor(oracle, alpha=0.0, n_restarts_optimizer=3, random_state=0).fit(X, Y[:, 1])
    assert found.log_marginal_likelihood == pytest.approx(regressor.log_marginal_likelihood_value_, abs=1e-3)
    assert found.log_marginal_likelihood > found.before
    assert found.converged
    assert found.log_marginal_likelihood == pytest.approx(
        log_marginal_likelihood(found.kernel, found.noise_var, X, Y[:, 1:])[0]
    )


def test_a_fit_recovers_the_hyper_parameters_that_made_the_data() -> None:
    rng = np.random.default_rng(7)
    x = rng.uniform(-4.0, 4.0, (150, 1))
    truth = SquaredExponential(2.0, 0.8)
    root = np.linalg.cholesky(truth.matrix(x) + 0.01 * np.eye(150))
    y = root @ rng.normal(size=(150, 6))  # six outputs share what they tell of the hyper-parameters
    found = fit(SquaredExponential(0.3, 3.0), 0.3, x, y, restarts=0)
    np.testing.assert_allclose(np.exp(found.kernel.theta), [2.0, 0.8], rtol=0.3)
    assert found.noise_var == pytest.approx(0.01, rel=0.15)


def test_a_fit_is_the_same_every_time_and_seeds_differ_only_in_where_it_begins() -> None:
    first, again = (fit(Matern(2.5, 1.0, 1.0), 0.1, X, Y, seed=3, restarts=2) for _ in range(2))
    assert first == again


def test_bounds_hold_are_told_and_fix_what_they_pinch() -> None:
    bounds = [(0.5, 0.5), (1.5, 1.6), (1e-2, 1.0)]
    found = fit(SquaredExponential(1.0, 1.0), 0.1, X, Y, bounds=bounds, restarts=1)
    variance, scale = np.exp(found.kernel.theta)
    assert variance == pytest.approx(0.5)
    assert 1.5 <= scale <= 1.6 + 1e-9
    assert 1 in found.at_bounds
    assert 0 not in found.at_bounds
    kept = fit(SquaredExponential(1.0, 1.0), 0.1, X, Y, restarts=1, fit_noise=False)
    assert kept.noise_var == pytest.approx(0.1, rel=1e-12)


def test_what_cannot_be_fitted_is_refused() -> None:
    kernel = SquaredExponential(1.0, 1.0)
    for x, y, words in (
        (X, Y[:5], "don't fit"),
        (X[:0], Y[:0], "N at least 1"),
        (np.where(X > 1.9, np.nan, X), Y, "must be finite"),
    ):
        with pytest.raises(InputError, match=words):
            fit(kernel, 0.1, x, y)
    with pytest.raises(InputError, match="1 bounds for 2 hyper-parameters"):
        fit(kernel, 0.1, X, Y, bounds=[(1.0, 2.0)])
    with pytest.raises(InputError, match=r"bounds\[1\]"):
        fit(kernel, 0.1, X, Y, bounds=[(1.0, 2.0), (2.0, 1.0), (1.0, 2.0)])
    with pytest.raises(InputError, match="noise_var"):
        fit(kernel, math.nan, X, Y)
