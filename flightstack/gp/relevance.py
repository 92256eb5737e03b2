"""Which points to hold: the one that tells least about a place, and a set that tells most about a region.

A tracking set follows the vehicle: `least_relevant` names the point to let go.  A certificate set stays: `cover`
chooses it so that the largest posterior variance over a region becomes small.  Kept apart, what the first forgets the
second still knows.
"""

from __future__ import annotations

import numpy as np

from flightstack.gp.kernels import Kernel
from flightstack.gp.recursive import RecursiveGP
from flightstack.types import F64, InputError


def least_relevant(gp: RecursiveGP, query: F64) -> int:
    """Index of the held point with the least |k(x, query)|, query (D,); of equals the oldest.

    The paper's rule: what the kernel calls unrelated to where the vehicle is now, is let go.  Raises InputError where
    nothing is held.
    """
    _some(gp)
    return gp.least_covariant(query)


def oldest(gp: RecursiveGP) -> int:
    """Index of the point that has been held longest; raises InputError where nothing is held."""
    _some(gp)
    return gp.oldest()


def cover(kernel: Kernel, noise_var: float, candidates: F64, queries: F64, count: int) -> list[int]:
    """Indices of `count` candidates (N, D), as chosen, that make the largest variance over queries (M, D) small.

    Greedy: each choice is the candidate after which the largest posterior variance over the queries is least; of
    equals the first.  Values don't matter: a variance depends on places only.  Each candidate is chosen once.  The cost
    is count x N x M steps and N x M numbers of memory.
    """
    points, places = np.atleast_2d(candidates), np.atleast_2d(queries)
    if not 0 <= count <= len(points):
        raise InputError(f"cover: count = {count} is not allowed; there are {len(points)} candidates")
    if not (np.isfinite(points).all() and np.isfinite(places).all()):
        raise InputError("cover: candidates and queries must be finite")
    # cov(candidate, query) and variances given the chosen ones: each choice takes one outer product away
    across, among = kernel.matrix(points, places), kernel.matrix(points)
    at_points, at_queries = kernel.diagonal(points), kernel.diagonal(places)
    chosen: list[int] = []
    left = np.ones(len(points), bool)
    for _ in range(count):
        worst = np.max(at_queries - across**2 / (at_points + noise_var)[:, None], axis=1, initial=-np.inf)
        best = int(np.argmin(np.where(left, worst, np.inf)))
        chosen.append(best)
        left[best] = False
        scale = 1.0 / (at_points[best] + noise_var)
        row, column = across[best].copy(), among[best].copy()
        across -= np.outer(column * scale, row)
        among -= np.outer(column * scale, column)
        at_queries -= scale * row**2
        at_points -= scale * column**2
    return chosen


def _some(gp: RecursiveGP) -> None:
    if len(gp) == 0:
        raise InputError("relevance: no point is held; add one first")
