"""Hyper-parameters by marginal likelihood: its value, its gradient, and a seeded search for the largest.

log p(y | x, theta) = -1/2 y' G^-1 y - 1/2 log |G| - N/2 log 2 pi,  G = K(theta) + noise I, summed over the outputs,
which are taken as independent functions with the same hyper-parameters.  Source: Rasmussen and Williams, Gaussian
Processes for Machine Learning (2006), section 5.4.1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flightstack.checked import number
from flightstack.gp import program
from flightstack.gp.kernels import Kernel
from flightstack.types import F64, InputError

Bounds = Sequence[tuple[float, float]]
_DEFAULT_RANGE = 1e3
"""Without bounds every hyper-parameter may change by this factor either way."""
_ITERATIONS = 200
_HOPELESS = 1e25
"""What the search is told where the matrix can't be factored."""


@dataclass(frozen=True, slots=True)
class FitResult:
    """What a fit found."""

    kernel: Kernel
    noise_var: float
    log_marginal_likelihood: float
    before: float
    """The log marginal likelihood at the start."""
    evaluations: int
    """Likelihoods computed in all."""
    converged: bool
    """Whether the search that won ended by itself."""
    at_bounds: tuple[int, ...]
    """Hyper-parameters that ended on a bound (the noise is the last): data leave them open, or the bound is wrong."""


def log_marginal_likelihood(kernel: Kernel, noise_var: float, x: F64, y: F64) -> tuple[float, F64]:
    """Value for x (N, D), y (N, P) and gradient (kernel.size + 1,) by theta and log noise_var, the noise last.

    Raises numpy.linalg.LinAlgError where the matrix is not positive definite in floating point.
    """
    from scipy.linalg import cho_factor, cho_solve  # here: whoever only flies needn't wait for SciPy

    flat = kernel.program(x.shape[1])
    matrix = program.matrix(flat, x, x)
    matrix[np.diag_indices_from(matrix)] += noise_var
    factor = cho_factor(matrix, lower=True, overwrite_a=True)
    weights = cho_solve(factor, y)
    count, outputs = y.shape
    log_det = 2.0 * float(np.log(np.diagonal(factor[0])).sum())
    value = -0.5 * float(np.sum(y * weights)) - 0.5 * outputs * (log_det + count * math.log(2.0 * math.pi))
    outer: F64 = weights @ weights.T - outputs * cho_solve(factor, np.eye(count))
    slopes = 0.5 * program.gradient(flat, x, outer)
    return value, np.append(slopes, 0.5 * noise_var * np.trace(outer))


def fit(
    kernel: Kernel,
    noise_var: float,
    x: F64,
    y: F64,
    *,
    seed: int = 0,
    restarts: int = 4,
    bounds: Bounds | None = None,
    fit_noise: bool = True,
) -> FitResult:
    """The hyper-parameters of largest marginal likelihood for x (N, D), y (N, P) or (N,), by L-BFGS-B in log space.

    The search begins at the kernel given and at `restarts` places drawn log-uniformly between the bounds; the same
    arguments give the same result.  `bounds` are (least, most) of every hyper-parameter, in the order of kernel.theta,
    then of the noise; equal ends fix one.  Raises InputError on data or bounds that can't be used.
    """
    from scipy.optimize import minimize

    points, values = _checked_data(x, y)
    start = np.append(kernel.theta, math.log(number(noise_var, "noise_var", 1e-50, 1e50)))
    limits = _checked_bounds(start, bounds)
    if not fit_noise:
        limits[-1] = start[-1]
    start = np.clip(start, limits[:, 0], limits[:, 1])
    seen: list[float] = []

    def objective(theta: F64) -> tuple[float, F64]:
        value, slopes = _value_and_slopes(kernel, theta, points, values)
        seen.append(value)
        return -value, -slopes

    best, best_theta, converged = objective(start)[0], start, False
    draws = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (restarts, len(start)))
    for theta in [start, *draws]:
        found = minimize(objective, theta, jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": _ITERATIONS})
        if found.fun < best:
            best, best_theta, converged = float(found.fun), found.x, bool(found.success)
    free = limits[:, 0] < limits[:, 1]
    on_bound = free & ((best_theta <= limits[:, 0] + 1e-6) | (best_theta >= limits[:, 1] - 1e-6))
    return FitResult(
        kernel.with_theta(best_theta[:-1]),
        math.exp(best_theta[-1]),
        -best,
        seen[0],
        len(seen),
        converged,
        tuple(np.flatnonzero(on_bound).tolist()),
    )


def _value_and_slopes(kernel: Kernel, theta: F64, x: F64, y: F64) -> tuple[float, F64]:
    """The likelihood at theta, the noise last; hopeless and flat where the matrix can't be factored."""
    try:
        return log_marginal_likelihood(kernel.with_theta(theta[:-1]), math.exp(theta[-1]), x, y)
    except np.linalg.LinAlgError:
        return -_HOPELESS, np.zeros_like(theta)


def _checked_data(x: F64, y: F64) -> tuple[F64, F64]:
    points = np.ascontiguousarray(x, np.float64)
    values = np.ascontiguousarray(y, np.float64)
    if values.ndim == 1:
        values = values[:, None]
    if points.ndim != 2 or values.ndim != 2 or len(points) != len(values) or len(points) == 0:
        raise InputError(f"fit: x {points.shape} and y {values.shape} don't fit; give (N, D) and (N, P), N at least 1")
    if not (np.isfinite(points).all() and np.isfinite(values).all()):
        raise InputError("fit: x and y must be finite; leave out the samples that aren't")
    return points, values


def _checked_bounds(start: F64, bounds: Bounds | None) -> F64:
    """(hyper-parameters + 1, 2) logarithms."""
    if bounds is None:
        return start[:, None] + math.log(_DEFAULT_RANGE) * np.array([-1.0, 1.0])
    if len(bounds) != len(start):
        raise InputError(f"fit: {len(bounds)} bounds for {len(start) - 1} hyper-parameters and the noise; give as many")
    for i, (least, most) in enumerate(bounds):
        if not 1e-50 <= least <= most <= 1e50:
            raise InputError(f"fit: bounds[{i}] = ({least}, {most}) is not allowed; give 0 < least <= most")
    return np.log(np.array(bounds, np.float64))
