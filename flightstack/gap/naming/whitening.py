"""Coloured noise made white: one autoregressive model per channel, applied to data and columns alike.

Residuals at 50 to 250 Hz remember their past, so that plain least squares believes its errors several times too small.
A model of the noise, e[t] = sum_k a_k e[t-k] + white, fitted to what no candidate explains, turns generalised least
squares into ordinary least squares on the filtered rows (Cochrane and Orcutt, JASA 1949).  What colour is left is
counted in the estimates' covariance (`gap.naming.estimate`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flightstack.jit import njit_free
from flightstack.types import F64

Mask = NDArray[np.bool_]
ORDER = 16
_FEWEST_ROWS = 40
"""Rows below which a channel has nothing to say."""
_ROWS_PER_TAP = 12
"""A short or slow flight's noise model has fewer taps."""
_OUTLIER = 6.0
_FADES = 0.999
"""Greatest root of a noise that is there: a drift that never comes back is no noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """The noise of one channel: `taps` (order + 1,) of the filter that whitens it, `sigma` of what comes out."""

    taps: F64
    sigma: float

    @property
    def usable(self) -> bool:
        """Whether the channel had data to learn from."""
        return bool(np.isfinite(self.sigma) and self.sigma > 0.0)

    @property
    def order(self) -> int:
        """How many rows before its own one a whitened row needs."""
        return len(self.taps) - 1

    @property
    def stable_taps(self) -> F64:
        """Taps of the same colour whose inverse fades: least squares may put a root beyond the unit circle."""
        roots = np.roots(self.taps)
        size = np.maximum(np.abs(roots), 1e-12)
        return np.real(np.poly(roots / size * np.minimum(np.minimum(size, 1.0 / size), _FADES)))


def fit(errors: list[F64], ok: list[Mask], *, most: int = ORDER) -> Whitener:
    """The noise model of one channel from its errors (N,) in each flight, by least squares over whole windows."""
    rows, targets = [], []
    order = max(2, min(most, sum(int(good.sum()) for good in ok) // _ROWS_PER_TAP))
    for e, good in zip(errors, ok, strict=True):
        window = whole_windows(good, order)
        e = np.where(good, e, 0.0)
        lags = np.stack([np.roll(e, k) for k in range(1, order + 1)], axis=1)
        rows.append(lags[window])
        targets.append(e[window])
    x, y = np.concatenate(rows), np.concatenate(targets)
    if len(y) < _FEWEST_ROWS or not np.any(y):
        return Whitener(np.eye(1, order + 1)[0], np.nan)
    scale = float(np.sqrt(np.mean(y**2)))
    gram = x.T @ x + 1e-9 * len(y) * scale**2 * np.eye(order)
    coefficients = np.linalg.solve(gram, x.T @ y)
    rest = y - x @ coefficients
    spread = 1.4826 * float(np.median(np.abs(rest)))
    core = rest[np.abs(rest) <= _OUTLIER * max(spread, 1e-12 * scale)]
    sigma = float(np.sqrt(np.mean(core**2))) if len(core) else scale
    return Whitener(np.concatenate([[1.0], -coefficients]), max(sigma, 1e-9 * scale))


def plain(errors: list[F64], ok: list[Mask]) -> Whitener:
    """Noise of one channel without colour: its size only."""
    rows = np.concatenate([e[good] for e, good in zip(errors, ok, strict=True)])
    usable = len(rows) >= _FEWEST_ROWS and bool(np.any(rows))
    return Whitener(np.ones(1), float(np.sqrt(np.mean(rows**2))) if usable else np.nan)


@njit_free
def whiten(taps: F64, values: F64, channel: int, rows: NDArray[np.int64], out: F64) -> None:
    """One channel of `values` (N, channels, K) filtered by `taps` at these rows, into `out` (rows, K)."""
    if out.shape[1] == 1:
        for r in range(len(rows)):
            total = 0.0
            for k in range(len(taps)):
                total += taps[k] * values[rows[r] - k, channel, 0]
            out[r, 0] = total
        return
    for r in range(len(rows)):
        filtered = out[r]  # rows of their own: indexed whole, each product took four to eight times as long
        filtered[:] = 0.0
        for k in range(len(taps)):
            tap, row = taps[k], values[rows[r] - k, channel]
            for j in range(len(filtered)):
                filtered[j] += tap * row[j]


def whole_windows(ok: Mask, order: int) -> Mask:
    """Rows that are good and follow `order` good rows."""
    count = np.cumsum(np.concatenate([[0], ok.astype(np.int64)]))
    window = np.zeros(len(ok), dtype=bool)
    window[order:] = count[order + 1 :] - count[: -order - 1] == order + 1
    return window
