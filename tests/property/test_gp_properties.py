"""Any kernel, any sequence of additions and removals: the numbers of scikit-learn's exact process."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process import kernels as sk

from flightstack.gp import Constant, Kernel, Linear, Matern, RecursiveGP, SquaredExponential, kernel_from_dict
from flightstack.types import F64

INPUTS, OUTPUTS, CAPACITY = 3, 2, 12

variances = st.floats(0.05, 5.0)
scales = st.one_of(st.floats(0.3, 5.0), st.tuples(*[st.floats(0.3, 5.0)] * INPUTS))
leaves = st.one_of(
    st.builds(Constant, variances),
    st.builds(Linear, variances, st.integers(0, INPUTS - 1)),
    st.builds(SquaredExponential, variances, scales),
    st.builds(SquaredExponential, variances, st.floats(0.3, 5.0), st.just((2, 0))),
    st.builds(Matern, st.sampled_from([0.5, 1.5, 2.5]), variances, scales),
)
kernels: st.SearchStrategy[Kernel] = st.recursive(
    leaves,
    lambda part: st.one_of(st.builds(Kernel.__add__, part, part), st.builds(Kernel.__mul__, part, part)),
    max_leaves=4,
)
moves = st.lists(st.tuples(st.sampled_from(["add", "exchange", "remove", "block", "ask"]), st.integers(0, 2**32 - 1)))


class Ours(sk.Kernel):
    """One of our kernels as scikit-learn's: only the process around it is under test."""

    def __init__(self, kernel: Kernel) -> None:
        self.kernel = kernel

    def __call__(self, x: F64, y: F64 | None = None, eval_gradient: bool = False) -> F64:
        return self.kernel.matrix(x, y)

    def diag(self, x: F64) -> F64:
        return self.kernel.diagonal(x)

    def is_stationary(self) -> bool:
        return False


def exact(gp: RecursiveGP, query: F64) -> tuple[F64, F64]:
    """Mean (P,) and variance (P,) on the points held."""
    if len(gp) == 0:
        return np.zeros(OUTPUTS), np.full(OUTPUTS, gp.kernel.diagonal(query)[0])
    regressor = GaussianProcessRegressor(Ours(gp.kernel), alpha=gp.noise_var, optimizer=None).fit(gp.x, gp.y)
    mean, covariance = regressor.predict(query[None], return_cov=True)
    return np.ravel(mean), np.ravel(covariance)[:OUTPUTS]


def play(gp: RecursiveGP, move: str, rng: Any, held: list[tuple[float, ...]]) -> None:
    """One move on the process, and on a plain list with the stated rules."""
    point, value = rng.normal(size=INPUTS), rng.normal(size=OUTPUTS)
    index = int(rng.integers(CAPACITY))
    if move == "exchange":
        gp.predict(point)
    if move == "block":
        for each in sorted({i for i in range(len(held)) if rng.random() < 0.3}, reverse=True):
            held[each] = held[-1]
            held.pop()
            gp.remove(each)
    if move in ("remove", "exchange") and index < len(held):
        gp.remove(index)
        held[index] = held[-1]
        held.pop()
    if move in ("add", "exchange"):
        if len(held) == CAPACITY:
            goes = gp.oldest()
            held[goes] = held[-1]
            held.pop()
        assert gp.add(point, value) == 1
        held.append(tuple(point))


@settings(max_examples=150, deadline=None)
@given(kernels, st.floats(1e-4, 1.0), moves, st.integers(1, 20))
def test_any_sequence_gives_the_exact_process_on_the_points_held(
    kernel: Kernel, noise_var: float, sequence: list[tuple[str, int]], rebuild_steps: int
) -> None:
    gp = RecursiveGP(
        kernel, noise_var, input_dim=INPUTS, output_dim=OUTPUTS, capacity=CAPACITY, rebuild_steps=rebuild_steps
    )
    held: list[tuple[float, ...]] = []
    for move, seed in sequence:
        rng = np.random.default_rng(seed)
        play(gp, move, rng, held)
        if move == "ask":
            check(gp, rng.normal(size=INPUTS), held)
    check(gp, np.array([0.3, -0.4, 1.2]), held)


def check(gp: RecursiveGP, query: F64, held: list[tuple[float, ...]]) -> None:
    mean, variance = gp.predict(query)
    true_mean, true_variance = exact(gp, query)
    prior = max(1.0, gp.prior_variance(query), *gp.kernel.diagonal(gp.x)) if held else 1.0
    np.testing.assert_allclose(mean, true_mean, rtol=1e-7, atol=1e-8 * prior)
    np.testing.assert_allclose(variance, true_variance, rtol=1e-7, atol=1e-10 * prior)
    along = gp.predict_along(query, np.zeros(INPUTS))
    hard = max(1.0, 1e-4 * prior / gp.noise_var)  # below noise of 1e-4 of the signal's variance digits are lost
    np.testing.assert_allclose(along[0], true_mean, rtol=1e-6 * hard, atol=1e-7 * prior * hard)
    np.testing.assert_array_equal(along[1], 0.0)
    assert (variance > 0.0).all()
    assert len(gp) == len(held)
    np.testing.assert_array_equal(gp.x, np.reshape(held, (len(held), INPUTS)))


@settings(max_examples=100, deadline=None)
@given(kernels, st.integers(0, 2**32 - 1))
def test_any_kernel_is_symmetric_positive_and_survives_theta_and_tables(kernel: Kernel, seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(15, INPUTS))
    matrix = kernel.matrix(x)
    size = np.abs(matrix).max()
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-13 * size)
    np.testing.assert_allclose(np.diag(matrix), kernel.diagonal(x), rtol=1e-12)
    assert np.linalg.eigvalsh(matrix).min() > -1e-10 * size
    np.testing.assert_allclose(kernel.with_theta(kernel.theta).matrix(x), matrix, rtol=1e-10, atol=1e-13 * size)
    assert kernel_from_dict(kernel.to_dict()) == kernel
