"""Gaussian processes anew: kernels from their JSON form, posterior mean and covariance by one Cholesky factor.

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), chapters 2 and 4.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .intervals import F64, I64
from .reading import Refused, column, number

_AT_ONCE = 300
"""Queries in one go: a kernel's matrices then take some megabytes."""


def kernel(spec: Any, x: F64, y: F64, where: str, deep: int = 0) -> F64:
    """(n, m) covariances between rows of x (n, d) and y (m, d), of a kernel as plain JSON."""
    name = spec.get("kernel")
    if name in ("sum", "product") and deep < 30:
        left, right = (kernel(spec[side], x, y, f"{where}.{side}", deep + 1) for side in ("left", "right"))
        return left + right if name == "sum" else left * right
    variance = number(spec.get("variance"), f"{where}.variance")
    if not variance > 0.0:
        raise Refused(f"{where}.variance = {variance:g} must be above 0")
    if name == "constant":
        return np.full((len(x), len(y)), variance)
    if name == "linear":
        place = column(spec.get("column"), x, where)
        return variance * np.outer(x[:, place], y[:, place])
    if name not in ("squared_exponential", "matern"):
        raise Refused(f"{where}.kernel is not known")
    listed = spec.get("columns")
    columns = list(range(x.shape[1])) if listed is None else [column(place, x, where) for place in listed]
    given = spec.get("lengthscales")
    scales = [number(one, f"{where}.lengthscales") for one in (given if isinstance(given, list) else [given])]
    if len(scales) not in (1, len(columns)) or min(scales) <= 0.0:
        raise Refused(f"{where}.lengthscales do not fit {len(columns)} columns")
    scaled = [part[:, columns] / np.array(scales) for part in (x, y)]
    square = ((scaled[0][:, None, :] - scaled[1][None, :, :]) ** 2).sum(axis=2)
    if name == "squared_exponential":
        return np.asarray(variance * np.exp(-0.5 * square))
    nu = spec.get("nu")
    s = np.sqrt(square * (2.0 * number(nu, f"{where}.nu")))
    factors = {0.5: 1.0 + 0.0 * s, 1.5: 1.0 + s, 2.5: 1.0 + s + s * s / 3.0}
    if nu not in factors:
        raise Refused(f"{where}.nu = {nu!r} must be 0.5, 1.5 or 2.5")
    return np.asarray(variance * factors[nu] * np.exp(-s))


def factor(spec: Any, x: F64, noise: F64, where: str) -> F64:
    """(n, n) lower triangle of the points' covariance with that of their noise, (n, n)."""
    return np.asarray(np.linalg.cholesky(kernel(spec, x, x, where) + noise), np.float64)


def wandering(drift: tuple[float, float], one_us: I64, other_us: I64) -> F64:
    """(m, n) covariances of noise that wanders, of a variance and a time (s), between stamps (m,) and (n,)."""
    variance, time_s = drift
    apart = np.abs(one_us[:, None] - other_us[None, :])
    return np.asarray(variance * np.exp(apart * (-1e-6 / time_s)))


def posterior(spec: Any, x: F64, y: F64, lower: F64, queries: F64, where: str) -> tuple[F64, F64, F64]:
    """Means (m, outputs), variance and sum of absolute weights (m,) at `queries` (m, d).

    Given y (n, outputs) at x (n, d) and their `factor`.
    """
    if len(queries) > _AT_ONCE:
        parts = [queries[i : i + _AT_ONCE] for i in range(0, len(queries), _AT_ONCE)]
        found = [posterior(spec, x, y, lower, part, where) for part in parts]
        return tuple(np.concatenate(each) for each in zip(*found, strict=True))  # type: ignore[return-value]
    cross = kernel(spec, x, queries, where)
    solved = np.asarray(np.linalg.solve(lower, np.hstack([cross, y])), np.float64)
    half, weights = solved[:, : len(queries)], solved[:, len(queries) :]
    prior = np.diag(kernel(spec, queries, queries, where))
    mean: F64 = half.T @ weights
    sums = np.abs(np.linalg.solve(lower.T, half)).sum(axis=0)
    return mean, np.asarray(np.maximum(prior - (half * half).sum(axis=0), 0.0)), sums
