"""The nearest point of a polytope: min |x - w|^2 / 2 subject to low <= A x <= high, for the three axes' acceleration.

OSQP finds which rows are active, warm-started from the last problem; the point itself is then computed from these rows
in closed form (the polishing of OSQP's paper, with the rows near its guess tried one set after another), and counts
only where it meets the conditions of Karush, Kuhn and Tucker.  So what comes out is exact or is marked as not solved,
whatever the solver returned: where OSQP 1.1 does not solve, its x is 2143289344.0, a finite number.  Where OSQP's
guess does not lead there within its iterations (rows that leave next to no room hide which of them are active), every
set of three bounds is tried: that ends too, and settles it.

The work is bounded by counts, not by time: the same problem ends the same way on every machine.

Source: B. Stellato, G. Banjac, P. Goulart, A. Bemporad, S. Boyd, "OSQP: an operator splitting solver for quadratic
programs", Mathematical Programming Computation 12, 2020.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import osqp
from scipy import sparse

from flightstack.jit import njit
from flightstack.types import F64, I64

AXES = 3
ROUNDS = 12
"""Most of OSQP's runs: the next one begins where the rows found so far do not give the solution."""
ROUND_ITERATIONS = 5
"""Few: the rows are mostly found long before the point is, and a point that is exact costs less than another round."""
TOLERANCE = 1e-11
"""By which a normalised row may be violated: m/s^2 for accelerations."""
_SETTINGS = {
    "verbose": 0, "eps_abs": 1e-9, "eps_rel": 0.0, "eps_prim_inf": 1e-8, "max_iter": ROUND_ITERATIONS,
    "check_termination": 5, "adaptive_rho": 0, "rho": 1.0, "alpha": 1.8, "scaling": 0, "polishing": 0,
    "warm_starting": 1,
}  # fmt: skip
_SIGN = 1e-9
"""By which a multiplier may have the wrong sign."""
_CANDIDATES = 6
"""Bounds near OSQP's guess of which the active ones, three at most, are chosen."""
_FREE = 1e29
"""Beyond this a bound is none."""
_INFEASIBLE = 3
"""OSQP's status for: certainly no solution."""


class Solution(NamedTuple):
    """What came of one problem."""

    x: F64
    """(3,) the nearest point; NaN where it was not found."""
    solved: bool
    iterations: int
    residual: float
    """Largest violation of a normalised row by x; infinite where not solved."""


class NearestPoint:
    """The QP for a fixed number of rows; keeps the last problem's solution to start from."""

    __slots__ = ("_columns", "_lower", "_normal", "_push", "_rows", "_solver", "_upper")

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self._normal = np.empty((AXES, rows))  # column by column, as OSQP has it
        self._columns = self._normal.reshape(-1)
        self._lower, self._upper, self._push = np.empty(rows), np.empty(rows), np.empty(AXES)
        binding = osqp.OSQP(algebra="builtin").ext  # without the wrapper, which takes as long as the solver
        settings = binding.OSQPSettings()
        binding.osqp_set_default_settings(settings)
        for name, value in _SETTINGS.items():
            setattr(settings, name, value)
        dense, bound = sparse.csc_matrix(np.ones((rows, AXES))), np.ones(rows)
        identity = sparse.identity(AXES, format="csc")
        self._solver = binding.OSQPSolver(
            binding.CSC(identity), np.zeros(AXES), binding.CSC(dense), -bound, bound, rows, AXES, settings
        )
        self.forget()

    def forget(self) -> None:
        """Start from nothing: what came before no longer matters."""
        self._solver.warm_start(np.zeros(AXES), np.zeros(self._rows))

    def solve(self, rows: F64, low: F64, high: F64, wanted: F64) -> Solution:
        """The point nearest to `wanted` (3,) with low <= rows @ x <= high; rows (m, 3), bounds (m,), +-inf for none.

        Rows are normalised first; one of length 0 counts as a bound on 0.
        """
        a, lower, upper = self._normal, self._lower, self._upper
        if not _normalise(rows, low, high, wanted, a, lower, upper, self._push):
            return _unsolved(0)
        solver, x, spent = self._solver, np.empty(AXES), 0
        solver.update_data_vec(q=self._push, l=lower, u=upper)
        solver.update_data_mat(P_x=None, P_i=None, A_x=self._columns, A_i=None)
        for _ in range(ROUNDS):
            solver.solve()
            guess, spent = solver.solution, spent + int(solver.info.iter)
            residual = _finish(a, lower, upper, wanted, guess.x, guess.y, _CANDIDATES, x)
            if residual <= TOLERANCE:
                return Solution(x, True, spent, residual)
            if int(solver.info.status_val) == _INFEASIBLE:
                break
        self.forget()
        residual = _finish(a, lower, upper, wanted, wanted, np.zeros(self._rows), 2 * self._rows, x)
        return Solution(x, True, spent, residual) if residual <= TOLERANCE else _unsolved(spent)


def _unsolved(iterations: int) -> Solution:
    return Solution(np.full(AXES, np.nan), False, iterations, math.inf)


@njit
def _normalise(
    rows: F64, low: F64, high: F64, wanted: F64, a: F64, lower: F64, upper: F64, push: F64
) -> bool:  # fmt: skip
    """Rows of length 1 into the columns of `a` (3, m), their bounds (-+1e30: none) into `lower`, `upper`, the cost's
    slope into `push` (3,); whether all of it makes sense."""
    fine = math.isfinite(wanted[0] + wanted[1] + wanted[2])
    for i in range(rows.shape[0]):
        size = math.sqrt(rows[i, 0] * rows[i, 0] + rows[i, 1] * rows[i, 1] + rows[i, 2] * rows[i, 2])
        fine = fine and math.isfinite(size) and low[i] <= high[i]  # NaN is not
        scale = 1.0 / size if size > 1e-12 else 1.0
        for k in range(3):
            a[k, i] = rows[i, k] * scale
        lower[i] = max(low[i] * scale, -1e30)
        upper[i] = min(high[i] * scale, 1e30)
    for k in range(3):
        push[k] = -wanted[k]
    return fine


@njit
def _finish(a: F64, low: F64, high: F64, wanted: F64, guess: F64, multipliers: F64, most: int, x: F64) -> float:
    """The solution from the rows that a guess says are active, into `x`; the largest violation, infinite if none fits.

    Candidates are the `most` bounds with the least slack less multiplier; every set of up to three of them is tried,
    the likeliest first, until one meets all conditions.
    """
    row = np.zeros(most, np.int64)
    side = np.zeros(most)
    score = np.full(most, np.inf)
    for i in range(a.shape[1]):
        z = a[0, i] * guess[0] + a[1, i] * guess[1] + a[2, i] * guess[2]
        below, above = (z - low[i]) + multipliers[i], (high[i] - z) - multipliers[i]
        if low[i] > -_FREE:
            _keep(row, side, score, i, -1.0, below)
        if high[i] < _FREE:
            _keep(row, side, score, i, 1.0, above)
    count = 0
    while count < most and score[count] < np.inf:
        count += 1
    likely = 0
    while likely < min(count, 3) and score[likely] < 0.0:
        likely += 1
    chosen = np.zeros(3, np.int64)
    for i in range(likely):
        chosen[i] = i
    residual = _attempt(a, low, high, wanted, row, side, chosen[:likely], x)
    if residual < np.inf:
        return residual
    for i in range(-1, count):
        for j in range(-1, max(i, 0)):
            for k in range(-1, max(j, 0)):
                size = (i >= 0) + (j >= 0) + (k >= 0)
                chosen[0], chosen[1], chosen[2] = i, j, k
                residual = _attempt(a, low, high, wanted, row, side, chosen[:size], x)
                if residual < np.inf:
                    return residual
    return np.inf


@njit
def _keep(row: I64, side: F64, score: F64, i: int, sign: float, value: float) -> None:
    """Insert a candidate into the list of the best, kept in order; what is not a number is none."""
    if not value < score[-1]:
        return
    at = len(score) - 1
    while at > 0 and score[at - 1] > value:
        row[at], side[at], score[at] = row[at - 1], side[at - 1], score[at - 1]
        at -= 1
    row[at], side[at], score[at] = i, sign, value


@njit
def _attempt(
    a: F64, low: F64, high: F64, wanted: F64, row: I64, side: F64, chosen: I64, x: F64
) -> float:  # fmt: skip
    """Project `wanted` onto the planes of the chosen bounds, into `x`; the largest violation, infinite where one of the
    conditions fails.

    The planes' normals are made orthogonal one after another (Gram-Schmidt), so that neighbours in direction cost no
    more digits than they must.
    """
    basis = np.zeros((3, 3))
    part = np.zeros((3, 3))
    along = np.zeros(3)
    for k in range(3):
        x[k] = wanted[k]
    for n in range(len(chosen)):
        i = row[chosen[n]]
        bound = high[i] if side[chosen[n]] > 0.0 else low[i]
        for k in range(3):
            basis[n, k] = a[k, i]
        at = bound
        for _ in range(2):  # twice: once more takes out what rounding left
            for m in range(n):
                share = basis[n, 0] * basis[m, 0] + basis[n, 1] * basis[m, 1] + basis[n, 2] * basis[m, 2]
                part[n, m] += share
                for k in range(3):
                    basis[n, k] -= share * basis[m, k]
        for m in range(n):
            at -= part[n, m] * along[m]
        length = math.sqrt(basis[n, 0] ** 2 + basis[n, 1] ** 2 + basis[n, 2] ** 2)
        if length < 1e-9:
            return np.inf
        part[n, n], along[n] = length, at / length
        step = along[n]
        for k in range(3):
            basis[n, k] /= length
        for k in range(3):
            step -= basis[n, k] * wanted[k]
        for k in range(3):
            x[k] += step * basis[n, k]
    if not _signs(basis, part, wanted, side, chosen, x):
        return np.inf
    worst = 0.0
    for i in range(a.shape[1]):
        z = a[0, i] * x[0] + a[1, i] * x[1] + a[2, i] * x[2]
        worst = max(worst, low[i] - z, z - high[i])
    return worst if worst <= TOLERANCE else np.inf


@njit
def _signs(basis: F64, part: F64, wanted: F64, side: F64, chosen: I64, x: F64) -> bool:
    """Whether every chosen bound pushes inwards: wanted - x = sum of multiplier times normal, by back substitution."""
    multiplier, size = np.zeros(3), len(chosen)
    for back in range(size):
        n = size - 1 - back
        value = 0.0
        for k in range(3):
            value += basis[n, k] * (wanted[k] - x[k])
        for m in range(n + 1, size):
            value -= part[m, n] * multiplier[m]
        multiplier[n] = value / part[n, n]
        if multiplier[n] * side[chosen[n]] < -_SIGN:
            return False
    return True
