"""How whitened rows are measured: chi-square in which every candidate may be there at a negligible size."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flightstack.gap.naming.design import Linearised
from flightstack.gap.naming.whitening import Mask
from flightstack.types import F64


@dataclass(frozen=True, slots=True, eq=False)
class Metric:
    """Chi-square with every candidate a little there: r' (I + X T X')^-1 r over the rows to learn from."""

    rows: Mask
    x: F64
    inner: F64
    """(T^-1 + X'X)^-1."""
    _last: list[tuple[F64, F64, F64]] = field(default_factory=list, repr=False)

    def against(self, r: F64) -> tuple[F64, F64]:
        """Of whitened rows (R,) those to learn from, and X' of them; kept for two sets: a step asks for each twice."""
        for known, mine, shown in self._last:
            if known is r:
                return mine, shown
        mine = r[self.rows]
        self._last[:] = [*self._last[-1:], (r, mine, self.x.T @ mine)]
        return self._last[-1][1:]

    def chi2(self, r: F64) -> float:
        """Of whitened rows (R,)."""
        mine, shown = self.against(r)
        return float(mine @ mine - shown @ self.inner @ shown)

    def columns(self, x: F64) -> Columns:
        """Columns (R, k), ready for any rows."""
        mine = x[self.rows]
        cross = self.x.T @ mine
        return Columns(self, mine, cross, mine.T @ mine - cross.T @ self.inner @ cross)

    def normal(self, x: F64, r: F64) -> tuple[F64, F64]:
        """K (k, k) and b (k,) of columns (R, k) against rows (R,)."""
        ready = self.columns(x)
        return ready.k, ready.toward(r)


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns as a metric measures them."""

    metric: Metric
    x: F64
    cross: F64
    k: F64
    """(k, k)."""

    def toward(self, r: F64) -> F64:
        """b (k,) against rows (R,)."""
        data, shown = self.metric.against(r)
        return np.asarray(self.x.T @ data - self.cross.T @ (self.metric.inner @ shown))


def metric_of(point: Linearised) -> Metric:
    """The metric at a point."""
    x, xx = point.learned()
    t = 1.0 / point.sizes
    inner = np.linalg.inv(xx / np.outer(t, t) + np.eye(len(t))) / np.outer(t, t)
    return Metric(point.fit_rows(), x, inner)


def bounded_step(k: F64, b: F64, low: F64, high: F64) -> tuple[F64, int]:
    """The step that gains most within the bounds, and how many coefficients it could move.

    Active set: what leaves its range is put on the edge and the others are solved again.
    """
    size = np.sqrt(np.maximum(np.diag(k), 0.0))
    active = size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)
    movable = active.copy()
    step = np.zeros(len(b))
    for _ in range(len(b) + 1):
        if not active.any():
            break
        at = np.flatnonzero(active)
        rest = b[at] - k[np.ix_(at, ~active)] @ step[~active]
        scaled = k[np.ix_(at, at)] / np.outer(size[at], size[at]) + 1e-9 * np.eye(len(at))
        step[at] = np.linalg.solve(scaled, rest / size[at]) / size[at]
        beyond = active & ((step < low) | (step > high))
        if not beyond.any():
            break
        step[beyond] = np.clip(step[beyond], low[beyond], high[beyond])
        active &= ~beyond
    return step, int(movable.sum())
