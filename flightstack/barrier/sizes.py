"""How likely the points of a process are with its smooth part as a share of the prior's, and with this or that noise.

Their covariance is named + share smooth + white I + drift exp(-|t_i - t_j| / time), and a force's beside it where there
may be one: the same matrices for every share and every noise, so little has to be factorised anew for each.

    smooth          L L', by columns in the order of what they explain (Cholesky's with pivots).  A smooth function of
                    a path needs far fewer of them than there are points: as many as leave `_LEFT` of the noise, as the
                    trace of what is left; the smaller the share, the fewer
    named, force    a column each term
    noise           drift is first-order Gauss-Markov: R^-1/2 of any column is one pass of a Kalman filter in the order
                    of time (Rasmussen and Williams, appendix B)
    all             log det and fit of the sum, by the matrix inversion and determinant lemmas (the same, A.9 and A.10):
                    one small Cholesky factor for each noise and share, whose last rows are the force's and the values',
                    so that it has the likelihood without the force and with it

What is left out puts the log likelihood of P outputs off by P / 2 times `_LEFT` for the determinant at most, and for
the fit by as much times the points, if all of it lay along the residual: a hundredth of what is asked of it
(`posterior`: 1.92).  In flight it was 0.0002 at most (1,536 of them, paper-tracking, 24 November 2026).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import blas, lapack

from flightstack.jit import njit_called
from flightstack.types import F64, I64

SHARES = tuple(4.0**-i for i in range(6))
_LEFT = 1e-4
_WORTH_IT = 0.7
"""Share of the points that columns may come to: beyond it, one factorisation of all points costs no more."""


class SmoothSizes:
    """One process' points; final."""

    __slots__ = ("_counts", "_kept", "_known", "_time_s", "columns", "worth_it")

    def __init__(
        self, named: F64, smooth: F64, values: F64, noise_var: float, times_s: F64, time_s: float,
        force: F64 | None = None,
    ) -> None:  # fmt: skip
        """`named`, `force` (N, terms): roots of the kernel's parts; `smooth` (N, N): the lower triangle of the rest;
        `values` (N, P); `noise_var`: least white noise; `times_s` (N,) over `time_s`, of drift, rising."""
        left, forces = _LEFT * noise_var, np.zeros((len(values), 0)) if force is None else force
        root, explains = _root(smooth, left)
        beyond = np.maximum(float(np.trace(smooth)) - np.cumsum(explains), 0.0) / left
        """Trace that is left after each column, in shares of what may be."""
        enough = [min(int(np.searchsorted(-share * beyond, -1.0)) + 1, root.shape[1]) for share in SHARES]
        self._kept = np.array(enough, np.int64) + named.shape[1]
        self._counts = named.shape[1], forces.shape[1], values.shape[1]
        self.columns = np.hstack([named, root, forces, values])
        self._time_s = np.diff(times_s, prepend=times_s[:1]) / time_s
        self._known: dict[tuple[float, float], F64] = {}
        self.worth_it = self.columns.shape[1] < _WORTH_IT * len(values) and bool((self._time_s >= 0.0).all())
        """Whether that is quicker than to factorise all points anew each time."""

    def log_likelihood(self, share: float, white: float, drift: float, forced: bool = False) -> float:
        """As `Posterior.log_likelihood`, of one of the `SHARES`; all of a noise are worked out together."""
        if (white, drift) not in self._known:
            whitened = np.empty_like(self.columns)
            half_log_det = _whiten(self.columns, self._time_s, white, drift, whitened)
            products = blas.dsyrk(1.0, whitened.T, lower=1).T
            self._known[white, drift] = _likelihoods(products, self._kept, np.array(SHARES), self._counts, half_log_det)
        return float(self._known[white, drift][int(forced), SHARES.index(share)])


def _root(matrix: F64, left: float) -> tuple[F64, F64]:
    """(N, m) L with L L' the matrix but for a trace of `left`, and what each column takes from the trace."""
    factor, places, rank, _ = lapack.dpstrf(matrix, tol=left / len(matrix), lower=1)
    root = np.empty((len(matrix), rank))
    root[places - 1] = np.tril(factor[:, :rank])
    return root, np.einsum("ij,ij->j", root, root)


@njit_called
def _whiten(columns: F64, steps: F64, white: float, drift: float, out: F64) -> float:
    """R^-1/2 of the columns (N, m), and half the logarithm of R's determinant; `steps` (N,): times between rows.

    Row by row what is new beyond the drift that was seen so far, over its deviation.
    """
    half_log_det, variance = 0.0, drift
    mean = np.zeros(columns.shape[1])
    for i in range(columns.shape[0]):
        keep = math.exp(-steps[i])
        variance = keep * keep * variance + (1.0 - keep * keep) * drift
        new = variance + white
        gain, scale = variance / new, 1.0 / math.sqrt(new)
        half_log_det += 0.5 * math.log(new)
        for j in range(columns.shape[1]):
            ahead = keep * mean[j]
            more = columns[i, j] - ahead
            out[i, j] = scale * more
            mean[j] = ahead + gain * more
        variance *= 1.0 - gain
    return half_log_det


@njit_called
def _likelihoods(products: F64, kept: I64, shares: F64, counts: tuple[int, int, int], half_log_det: float) -> F64:
    """(2, shares) without the force and with it.

    `products` (m, m): of the whitened columns, the upper triangle; `kept`: how many of them a share takes of those
    before the force's; `counts`: of the named ones, the force's and the values.
    """
    named, forces, values = counts
    found, m = np.empty((2, len(shares))), len(products)
    for s in range(len(shares)):
        count = kept[s]
        size, by = count + forces, math.sqrt(shares[s])
        inner = np.zeros((size + values, size + values))
        for i in range(size + values):
            row = i if i < count else i + m - size - values
            for j in range(i + 1):
                column = j if j < count else j + m - size - values
                scale = (by if named <= i < count else 1.0) * (by if named <= j < count else 1.0)
                inner[i, j] = scale * products[column, row]
            inner[i, i] = inner[i, i] + 1.0  # of the values' own corner nothing is used: it only has to be large enough
        factor, fit = np.linalg.cholesky(inner), 0.0
        for i in range(m - values, m):
            fit += products[i, i]
        size_log = half_log_det
        for forced in range(2):
            for j in range(count if forced else 0, size if forced else count):
                size_log += math.log(factor[j, j])
                for i in range(size, size + values):
                    fit -= factor[i, j] ** 2
            found[forced, s] = -0.5 * fit - values * size_log
    return found
