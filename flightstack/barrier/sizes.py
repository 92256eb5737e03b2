"""How likely the points of a process are with its smooth part as a share of the prior's, and with this or that noise.

Their covariance is named + share smooth + white I + drift exp(-|t_i - t_j| / time): the same four matrices for every
share and every noise, so little has to be factorised anew for each.

    smooth, named   L L', by columns in the order of what they explain (Cholesky's with pivots).  A smooth function of
                    a path needs far fewer of them than there are points: as many as leave `_LEFT` of the noise, as the
                    trace of what is left; the smaller the share, the fewer
    noise           drift is first-order Gauss-Markov: R^-1/2 of any column is one pass of a Kalman filter in the order
                    of time (Rasmussen and Williams, appendix B)
    both            log det and fit of the sum, by the matrix inversion and determinant lemmas (the same, A.9 and A.10)

What is left out puts the log likelihood of P outputs off by P / 2 times `_LEFT` for the determinant at most, and for
the fit by as much times the points, if all of it lay along the residual: a hundredth of what is asked of it
(`posterior`: 1.92).  In flight it was 0.0002 at most (1,536 of them, paper-tracking, 24 November 2026).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import blas, lapack

from flightstack.jit import njit_called
from flightstack.types import F64

_LEFT = 1e-4
_WORTH_IT = 0.7
"""Share of the points that columns may come to: beyond it, one factorisation of all points costs no more."""


class SmoothSizes:
    """One process' points; final."""

    __slots__ = ("_explains", "_known", "_named", "_time_s", "_values", "columns", "worth_it")

    def __init__(self, named: F64, smooth: F64, values: F64, noise_var: float, times_s: F64, time_s: float) -> None:
        """`named`, `smooth` (N, N): the kernel's parts; `values` (N, P); `noise_var`: least white noise; `times_s` (N,)
        over `time_s`, of drift, rising."""
        left, size = _LEFT * noise_var, len(values)
        named_root, _ = _root(named, left)
        smooth_root, explains = _root(smooth, left)
        self._explains = np.maximum(float(np.trace(smooth)) - np.cumsum(explains), 0.0) / left
        """Trace that is left after each column, in shares of what may be."""
        self._named, self._values = named_root.shape[1], values.shape[1]
        self.columns = np.ascontiguousarray(np.hstack([named_root, smooth_root, values]))
        self._time_s = np.diff(times_s, prepend=times_s[:1]) / time_s
        self._known: dict[tuple[float, float], tuple[F64, float]] = {}
        self.worth_it = self.columns.shape[1] < _WORTH_IT * size and bool((self._time_s >= 0.0).all())
        """Whether that is quicker than to factorise all points anew each time."""

    def log_likelihood(self, share: float, white: float, drift: float) -> float:
        """As `Posterior.log_likelihood`."""
        if (white, drift) not in self._known:
            whitened = np.empty_like(self.columns)
            half_log_det = _whiten(self.columns, self._time_s, white, drift, whitened)
            self._known[white, drift] = blas.dsyrk(1.0, whitened.T, lower=1), half_log_det
        products, half_log_det = self._known[white, drift]
        kept = self._named + int(np.searchsorted(-share * self._explains, -1.0)) + 1
        kept, values = min(kept, len(products) - self._values), len(products) - self._values
        by = np.ones(kept)
        by[self._named :] = math.sqrt(share)
        inner = np.asfortranarray(products[:kept, :kept] * by[:, None])
        inner *= by
        inner.ravel(order="K")[:: kept + 1] += 1.0
        factor, _ = lapack.dpotrf(inner, lower=1, overwrite_a=1, clean=0)
        explained, _ = lapack.dtrtrs(factor, (products[values:, :kept] * by).T, lower=1)
        fit = float(np.trace(products[values:, values:])) - float(np.einsum("ij,ij->", explained, explained))
        size = half_log_det + float(np.log(np.diagonal(factor)).sum())
        return -0.5 * fit - float(self._values) * size


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
