"""What `benchmarks/gp.py` measures itself against: the same step done by others' means.

Each maker takes the first points (N, D), their values (N, P), length-scales (D,) and noise, and gives a function that
lets the oldest point go, takes a new one and answers mean (P,) and latent variance (P,) at a query.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from flightstack.jit import njit
from flightstack.types import F64

Step = Callable[[F64, F64, F64], tuple[F64, F64]]


def _rbf(x: F64, y: F64, scales: F64) -> F64:
    """Squared exponential of unit variance, as NumPy does it fastest."""
    a, b = x / scales, y / scales
    square = (a * a).sum(1)[:, None] + (b * b).sum(1) - 2.0 * a @ b.T
    k: F64 = np.exp(-0.5 * np.maximum(square, 0.0))
    return k


def cholesky_refit(x: F64, y: F64, scales: F64, noise: float) -> Step:
    """SciPy: build the matrix, factor it, solve, at every step."""
    xs, ys = x.copy(), y.copy()

    def step(point: F64, value: F64, query: F64) -> tuple[F64, F64]:
        nonlocal xs, ys
        xs, ys = np.vstack([xs[1:], point]), np.vstack([ys[1:], value])
        gram = _rbf(xs, xs, scales)
        gram[np.diag_indices_from(gram)] += noise
        factor = cho_factor(gram, lower=True, overwrite_a=True, check_finite=False)
        k = _rbf(query[None], xs, scales)[0]
        half = solve_triangular(factor[0], k, lower=True, check_finite=False)
        mean = k @ cho_solve(factor, ys, check_finite=False)
        return mean, np.full(y.shape[1], 1.0 - half @ half)

    return step


def sklearn_refit(x: F64, y: F64, scales: F64, noise: float) -> Step:
    """scikit-learn's regressor, refitted at every step."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF

    xs, ys = x.copy(), y.copy()
    regressor = GaussianProcessRegressor(RBF(scales), alpha=noise, optimizer=None)

    def step(point: F64, value: F64, query: F64) -> tuple[F64, F64]:
        nonlocal xs, ys
        xs, ys = np.vstack([xs[1:], point]), np.vstack([ys[1:], value])
        mean, sigma = regressor.fit(xs, ys).predict(query[None], return_std=True)
        return mean[0], np.ravel(sigma) ** 2

    return step


def numpy_block_inverse(x: F64, y: F64, scales: F64, noise: float) -> Step:
    """The paper's recursion on the inverse, its signs put right: delete by blocks, then border."""
    xs, ys = x.copy(), y.copy()
    inverse = np.linalg.inv(_rbf(xs, xs, scales) + noise * np.eye(len(xs)))

    def step(point: F64, value: F64, query: F64) -> tuple[F64, F64]:
        nonlocal xs, ys, inverse
        less = inverse[1:, 1:] - np.outer(inverse[1:, 0], inverse[0, 1:]) / inverse[0, 0]
        k = _rbf(xs[1:], point[None], scales)[:, 0]
        u = less @ k
        s = 1.0 + noise - k @ u
        inverse = np.block([[less + np.outer(u, u) / s, -u[:, None] / s], [-u[None] / s, np.array([[1.0 / s]])]])
        xs, ys = np.vstack([xs[1:], point]), np.vstack([ys[1:], value])
        across = _rbf(xs, query[None], scales)[:, 0]
        v = inverse @ across
        return v @ ys, np.full(y.shape[1], 1.0 - across @ v)

    return step


class CholeskyFactor:
    """Numba: the factor loses a row by a rank-1 update of what follows and gains one by a triangular solve; final."""

    def __init__(self, x: F64, y: F64, scales: F64, noise: float) -> None:
        n = len(x)
        self.factor = np.linalg.cholesky(_rbf(x, x, scales) + noise * np.eye(n))
        self.x, self.y, self.noise, self.weights = np.ascontiguousarray(x / scales), y.copy(), noise, scales
        self.work = np.zeros((3, n))

    def __call__(self, point: F64, value: F64, query: F64) -> tuple[F64, F64]:
        """One step."""
        mean = np.empty(self.y.shape[1])
        variance = _factor_step(
            self.factor, self.x, self.y, self.noise, point / self.weights, value, query / self.weights, self.work, mean
        )
        return mean, np.full(len(mean), variance)


@njit
def _factor_step(
    factor: F64, x: F64, y: F64, noise: float, point: F64, value: F64, query: F64, work: F64, mean: F64
) -> float:
    """Drop the first row of the factor, append the new point's, answer the query."""
    n = len(x)
    a, k = work[0], work[1]
    for i in range(1, n):
        a[i] = factor[i, 0]
    for i in range(1, n):  # L L' + a a' of the trailing block, moved one place up
        old, r = factor[i, i], math.sqrt(factor[i, i] ** 2 + a[i] ** 2)
        c, s = r / old, a[i] / old
        factor[i - 1, i - 1] = r
        for j in range(i + 1, n):
            below = (factor[j, i] + s * a[j]) / c
            factor[j - 1, i - 1] = below
            a[j] = c * a[j] - s * below
    x[:-1] = x[1:].copy()
    y[:-1] = y[1:].copy()
    x[-1], y[-1] = point, value
    _row(x, point, k)
    _forward(factor, k, n - 1)
    rest = 1.0 + noise
    for i in range(n - 1):
        factor[n - 1, i] = k[i]
        rest -= k[i] * k[i]
    factor[n - 1, n - 1] = math.sqrt(rest)
    _row(x, query, k)
    _forward(factor, k, n)
    variance = 1.0
    for i in range(n):
        variance -= k[i] * k[i]
    for i in range(n - 1, -1, -1):  # L' v = k, by rows of L
        k[i] /= factor[i, i]
        for j in range(i):
            k[j] -= factor[i, j] * k[i]
    for p in range(len(mean)):
        mean[p] = 0.0
        for i in range(n):
            mean[p] += k[i] * y[i, p]
    return variance


@njit
def _row(x: F64, query: F64, out: F64) -> None:
    for i in range(len(x)):
        square = 0.0
        for c in range(len(query)):
            square += (x[i, c] - query[c]) ** 2
        out[i] = math.exp(-0.5 * square)


@njit
def _forward(factor: F64, b: F64, size: int) -> None:
    for i in range(size):
        total = b[i]
        for j in range(i):
            total -= factor[i, j] * b[j]
        b[i] = total / factor[i, i]


def jax_recursion(x: F64, y: F64, scales: F64, noise: float) -> Step:
    """JAX: our own recursion (slot overwritten, rank-2 update, then the product), compiled by XLA."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)

    def row(points: Any, query: Any) -> Any:
        return jnp.exp(-0.5 * (((points - query) / scales) ** 2).sum(1))

    def step(inverse: Any, xs: Any, ys: Any, slot: Any, point: Any, value: Any, query: Any) -> Any:
        column = inverse[:, slot]
        unit = jnp.zeros(len(x)).at[slot].set(1.0)
        k = row(xs, point).at[slot].set(0.0)
        u = inverse @ k - column * (column @ k) / column[slot]
        w = (u - unit).at[slot].set(-1.0)
        s = 1.0 + noise - k @ u
        inverse = inverse - jnp.outer(column, column) / column[slot] + jnp.outer(w, w) / s
        inverse = inverse.at[slot].set(-w / s).at[:, slot].set(-w / s)
        xs, ys = xs.at[slot].set(point), ys.at[slot].set(value)
        across = row(xs, query)
        v = inverse @ across
        return inverse, xs, ys, v @ ys, 1.0 - across @ v

    compiled = jax.jit(step, donate_argnums=(0, 1, 2))
    state: tuple[Any, Any, Any] = (
        jnp.asarray(np.linalg.inv(_rbf(x, x, scales) + noise * np.eye(len(x)))),
        jnp.asarray(x),
        jnp.asarray(y),
    )
    slot = -1

    def run(point: F64, value: F64, query: F64) -> tuple[F64, F64]:
        nonlocal state, slot
        slot = (slot + 1) % len(x)
        *kept, mean, variance = compiled(*state, slot, point, value, query)
        state = (kept[0], kept[1], kept[2])
        return np.asarray(mean), np.full(y.shape[1], float(variance))

    return run


def gpytorch_refit(x: F64, y: F64, scales: F64, noise: float) -> Step:
    """GPyTorch's exact process, the outputs as a batch that shares its inputs."""
    import gpytorch
    import torch

    torch.set_num_threads(1)
    batch = torch.Size([y.shape[1]])

    class Model(gpytorch.models.ExactGP):
        """Zero mean, squared exponential."""

        def __init__(self, xs: Any, ys: Any, likelihood: Any) -> None:
            gpytorch.models.ExactGP.__init__(self, xs, ys, likelihood)
            self.mean_module = gpytorch.means.ZeroMean(batch_shape=batch)
            self.covar_module = gpytorch.kernels.RBFKernel(ard_num_dims=x.shape[1], batch_shape=batch)

        def forward(self, xs: Any) -> Any:
            """The prior."""
            return gpytorch.distributions.MultivariateNormal(self.mean_module(xs), self.covar_module(xs))

    def batched(points: F64) -> Any:
        return torch.from_numpy(points).expand(y.shape[1], *points.shape)

    xs, ys = x.copy(), y.copy()
    likelihood = gpytorch.likelihoods.GaussianLikelihood(
        batch_shape=batch, noise_constraint=gpytorch.constraints.GreaterThan(1e-8)
    ).double()
    model = Model(batched(xs), torch.from_numpy(ys.T.copy()), likelihood).double()
    model.covar_module.lengthscale = torch.from_numpy(np.asarray(scales))
    likelihood.noise = noise
    model.eval()

    def step(point: F64, value: F64, query: F64) -> tuple[F64, F64]:
        nonlocal xs, ys
        xs, ys = np.vstack([xs[1:], point]), np.vstack([ys[1:], value])
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            model.set_train_data(batched(xs), torch.from_numpy(ys.T.copy()), strict=False)
            answer = model(batched(query[None]))
            return answer.mean[:, 0].numpy(), answer.variance[:, 0].numpy()

    return step
