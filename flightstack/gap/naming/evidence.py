"""The evidence: Gram matrices of all candidates' columns, with every candidate a little there.

With whitened data y and columns X, each coefficient of a candidate that is *not* named is taken as N(0, t^2), t its
negligible size: y ~ N(X_S theta, I + X T X').  By Woodbury all that any subset needs are three small arrays,
    K = G - G (T^-1 + G)^-1 G,   b = g - G (T^-1 + G)^-1 g,   c = y'y - g' (T^-1 + G)^-1 g     (G = X'X, g = X'y)
so each of thousands of subsets costs one solve of its own size.  Bounds are tests, not prices: a coefficient that
leaves its allowed range is taken out again, and a candidate with none left is out of the race.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from flightstack.types import F64

_PASSES = 3
_BATCH = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Gram:
    """Normal equations: K (n, n), b (n,), c and the count of independent rows."""

    k: F64
    b: F64
    c: float
    rows: float


def robust(g: F64, gy: F64, yy: float, rows: float, negligible: F64) -> Gram:
    """The normal equations with every column a little there (module docstring)."""
    scale = 1.0 / np.maximum(negligible, 1e-300)
    inner = np.diag(scale**2) + g
    norm = 1.0 / np.sqrt(np.diag(inner))
    factor = np.linalg.inv(inner * np.outer(norm, norm)) * np.outer(norm, norm)
    # (T^-1 + G)^-1 T^-1 G is G - G (T^-1 + G)^-1 G without the cancellation
    k = (scale[:, None] ** 2) * (factor @ g)
    b = (scale**2) * (factor @ gy)
    return Gram(0.5 * (k + k.T), b, yy - float(gy @ factor @ gy), rows)


@dataclass(frozen=True, slots=True, eq=False)
class Subset:
    """One subset of candidates: what it gains and with which coefficients."""

    members: tuple[int, ...]
    """Candidate numbers, ascending."""
    gain: float
    """How far chi-square falls."""
    used: int
    """Coefficients that are left in it."""
    at: NDArray[np.int64]
    """(k,) columns of its members (n: none)."""
    values: F64
    """(k,) their coefficients, 0 where not used."""
    width: int
    """n, columns in all."""

    @property
    def theta(self) -> F64:
        """(n,) all coefficients, 0 where not used."""
        full = np.zeros(self.width + 1)
        full[self.at] = self.values
        return full[: self.width]


def nothing(width: int) -> Subset:
    """The subset of no candidate, of `width` columns."""
    return Subset((), 0.0, 0, np.empty(0, dtype=np.int64), np.empty(0), width)


def score(gain: F64 | float, used: F64 | int, size: F64 | int, rows: float, candidates: int) -> F64 | float:
    """Extended BIC, less is better (Chen and Chen, Biometrika 2008): chi-square, rows, and how many had the chance."""
    price: F64 | float = used * np.log(max(rows, 2.0)) + 2.0 * size * np.log(max(candidates, 2)) - gain
    return price


def fit_subsets(
    gram: Gram, subsets: Sequence[tuple[int, ...]], columns: Sequence[NDArray[np.int64]], low: F64, high: F64
) -> list[Subset]:
    """Each subset fitted within the bounds (n,); a subset with a member that has no coefficient left gains nothing."""
    n, most = len(gram.b), max((len(s) for s in subsets), default=0)
    table = np.full((len(columns) + 1, max((len(c) for c in columns), default=0)), n)
    for m, own in enumerate(columns):
        table[m, : len(own)] = own
    fitted: list[Subset] = []
    for begin in range(0, len(subsets), _BATCH):
        part = subsets[begin : begin + _BATCH]
        members = np.array([(*s, *([-1] * (most - len(s)))) for s in part], dtype=np.int64).reshape(len(part), most)
        theta, gain, used = _fit_batch(gram, members, table, low, high)
        at = table[members].reshape(len(part), -1)
        fitted += map(Subset, part, gain.tolist(), used.tolist(), at, theta, [n] * len(part))
    return fitted


def _fit_batch(
    gram: Gram, members: NDArray[np.int64], table: NDArray[np.int64], low: F64, high: F64
) -> tuple[F64, F64, NDArray[np.int64]]:
    """Coefficients (S, k), gain (S,) and count of coefficients used (S,) of subsets (S, most), -1: no member.

    `table`: (candidates + 1, width) columns of each candidate, n where there is none.
    """
    n = len(gram.b)
    index = table[members].reshape(len(members), -1)
    width = index.shape[1]
    size = np.sqrt(np.maximum(np.diag(gram.k), 1e-300))
    k = np.zeros((n + 1, n + 1))
    k[:n, :n] = gram.k / np.outer(size, size)
    b = np.append(gram.b / size, 0.0)
    lower, upper = np.append(low * size, -np.inf), np.append(high * size, np.inf)
    active = (index < n) & (np.append(np.diag(gram.k), 0.0)[index] > 0.0)
    own = k[index[:, :, None], index[:, None, :]]
    theta = np.zeros(index.shape)
    for _ in range(_PASSES):
        matrix = np.where(active[:, :, None] & active[:, None, :], own, 0.0)
        matrix[:, np.arange(width), np.arange(width)] += np.where(active, 1e-9, 1.0)
        theta = np.linalg.solve(matrix, np.where(active, b[index], 0.0)[:, :, None])[:, :, 0]
        outside = active & ((theta < lower[index]) | (theta > upper[index]))
        if not outside.any():
            break
        active &= ~outside
    theta = np.where(active & (theta >= lower[index]) & (theta <= upper[index]), theta, 0.0)
    gain = np.einsum("ij,ij->i", theta, 2.0 * b[index]) - np.einsum("ij,ijk,ik->i", theta, own, theta)
    left = active.reshape(*members.shape, table.shape[1]).any(axis=2)
    gain = np.where((left | (members < 0)).all(axis=1), gain, -np.inf)
    return theta / np.append(size, 1.0)[index], gain, active.sum(axis=1)


def all_subsets(count: int, most: int, exclusive: Sequence[str]) -> list[tuple[int, ...]]:
    """Subsets of up to `most` of `count` candidates, never two of the same effect (`exclusive`: its name for each)."""
    return [
        members
        for size in range(most + 1)
        for members in combinations(range(count), size)
        if len({exclusive[m] for m in members}) == size
    ]
