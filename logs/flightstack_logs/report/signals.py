"""Numbers on their way to the page: comparison of two signals, attitude angles, decimation for display, encoding."""

from __future__ import annotations

import base64
from typing import overload

import numpy as np
from numpy.typing import NDArray

from flightstack.types import F64, Mask
from flightstack_logs.report.flight import ReportSamples

MAX_GAP_S = 0.25
"""A signal is not bridged over a longer hole in its samples."""


def resample(signal: ReportSamples, t_s: F64, max_gap_s: float = MAX_GAP_S) -> F64:
    """`signal` at the times `t_s` (m,), linear between its samples, -> (m, k); NaN outside and in holes."""
    out = np.full((len(t_s), signal.values.shape[1]), np.nan, dtype=np.float64)
    if len(signal.t_s) == 0:
        return out
    after = np.clip(np.searchsorted(signal.t_s, t_s), 0, len(signal.t_s) - 1)
    before = np.maximum(after - 1, 0)
    exact = signal.t_s[after] == t_s
    inside = (t_s >= signal.t_s[0]) & (t_s <= signal.t_s[-1])
    known = inside & (exact | (signal.t_s[after] - signal.t_s[before] <= max_gap_s))
    for column in range(out.shape[1]):
        out[known, column] = np.interp(t_s[known], signal.t_s, signal.values[:, column])
    return out


def difference(signal: ReportSamples, minus: ReportSamples) -> ReportSamples:
    """`signal - minus`, (n, k), at the times of `signal`."""
    return ReportSamples(signal.t_s, signal.values - resample(minus, signal.t_s))


@overload
def column(signal: ReportSamples, number: int) -> ReportSamples: ...
@overload
def column(signal: ReportSamples | None, number: int) -> ReportSamples | None: ...
def column(signal: ReportSamples | None, number: int) -> ReportSamples | None:
    """One column, (n, 1), of a signal; nothing stays nothing."""
    return None if signal is None else ReportSamples(signal.t_s, signal.values[:, number : number + 1])


@overload
def scaled(signal: ReportSamples, factor: float) -> ReportSamples: ...
@overload
def scaled(signal: ReportSamples | None, factor: float) -> ReportSamples | None: ...
def scaled(signal: ReportSamples | None, factor: float) -> ReportSamples | None:
    """The signal times a number; nothing stays nothing."""
    return None if signal is None else ReportSamples(signal.t_s, signal.values * factor)


def mean_over(signal: ReportSamples, period_s: float) -> ReportSamples:
    """Means of the finite values in consecutive stretches of `period_s`; a stretch without any is NaN."""
    stretch = ((signal.t_s - signal.t_s[0]) / period_s).astype(np.intp)
    known = np.isfinite(signal.values)
    first = np.flatnonzero(np.diff(stretch, prepend=-1))
    with np.errstate(invalid="ignore"):
        sums = np.add.reduceat(np.where(known, signal.values, 0.0), first, axis=0)
        means = sums / np.add.reduceat(known, first, axis=0, dtype=np.intp)
    return ReportSamples(signal.t_s[0] + (stretch[first] + 0.5) * period_s, means)


def norm(signal: ReportSamples) -> ReportSamples:
    """Euclidean length of each row, (n, 1)."""
    return ReportSamples(signal.t_s, np.sqrt(np.sum(signal.values**2, axis=1, keepdims=True)))


def tilt_deg(q_ned_frd: ReportSamples) -> ReportSamples:
    """Angle between the body's and the world's vertical, degrees, (n, 1); cos = 1 - 2 (x^2 + y^2)."""
    x, y = q_ned_frd.values[:, 1], q_ned_frd.values[:, 2]
    # 2 asin(sqrt(x^2 + y^2)) stays exact for small angles, where acos of the cosine would not.
    sine = np.sqrt(x * x + y * y) / np.linalg.norm(q_ned_frd.values, axis=1)
    return ReportSamples(q_ned_frd.t_s, np.degrees(2.0 * np.arcsin(np.minimum(sine, 1.0)))[:, None])


def rotation_between_deg(a: ReportSamples, b: ReportSamples) -> ReportSamples:
    """Angle of the rotation from attitude `b` to `a`, degrees, (n, 1), at the times of `a`."""
    q = a.values / np.linalg.norm(a.values, axis=1, keepdims=True)
    p = resample(ReportSamples(b.t_s, _same_hemisphere(b.values)), a.t_s)
    p = p / np.linalg.norm(p, axis=1, keepdims=True)
    # |q - p| and |q + p| give half the angle without the loss of precision of acos(q . p).
    minus, plus = np.linalg.norm(q - p, axis=1), np.linalg.norm(q + p, axis=1)
    angle: F64 = 4.0 * np.arctan2(np.minimum(minus, plus), np.maximum(minus, plus))
    return ReportSamples(a.t_s, np.asarray(np.degrees(angle)[:, None], dtype=np.float64))


def _same_hemisphere(q: F64) -> F64:
    """The same attitudes (n, 4) without jumps between q and -q, so that they may be interpolated."""
    turned = np.sum(q[1:] * q[:-1], axis=1) < 0.0
    sign = np.where(np.cumsum(np.concatenate([[False], turned])) % 2 == 1, -1.0, 1.0)
    return q * sign[:, None]


def decimate(signal: ReportSamples, points: int) -> ReportSamples:
    """At most `points` rows for display: minimum and maximum of every column in each of `points / 2` equal intervals.

    No peak is lost; each extreme stands at most one interval's width from where it was, earlier one first.  An interval
    without samples becomes NaN, a break in the line.
    """
    n, columns = signal.values.shape
    if n <= points or points < 4:
        return signal
    start, end = float(signal.t_s[0]), float(signal.t_s[-1])
    buckets = points // 2
    width = (end - start) / buckets
    if width <= 0.0:
        return ReportSamples(signal.t_s[:1], signal.values[:1])
    bucket = np.minimum(((signal.t_s - start) / width).astype(np.int64), buckets - 1)
    used, first = np.unique(bucket, return_index=True)
    t = np.asarray(start + width * (np.arange(2 * buckets) + 0.5) / 2.0, dtype=np.float64)
    out = np.full((2 * buckets, columns), np.nan)
    low = np.fmin.reduceat(signal.values, first, axis=0)
    high = np.fmax.reduceat(signal.values, first, axis=0)
    row = np.searchsorted(used, bucket)
    for column in range(columns):
        values = signal.values[:, column]
        at_low = _first_row(values == low[row, column], row, len(used))
        at_high = _first_row(values == high[row, column], row, len(used))
        low_first = at_low <= at_high
        out[2 * used, column] = np.where(low_first, low[:, column], high[:, column])
        out[2 * used + 1, column] = np.where(low_first, high[:, column], low[:, column])
    return ReportSamples(t, out)


def _first_row(hit: Mask, group: NDArray[np.intp], groups: int) -> NDArray[np.intp]:
    """Index of the first hit in each group; 0 where there is none (its value is NaN anyway)."""
    index = np.flatnonzero(hit)
    found, where = np.unique(group[index], return_index=True)
    out = np.zeros(groups, dtype=np.intp)
    out[found] = index[where]
    return out


def thin(signal: ReportSamples, points: int) -> ReportSamples:
    """At most `points` rows, evenly picked, the last one kept: for curves in space, whose columns belong together."""
    n = len(signal.t_s)
    if n <= points:
        return signal
    index = np.round(np.linspace(0, n - 1, points)).astype(np.intp)
    return ReportSamples(signal.t_s[index], signal.values[index])


def intervals(flags: ReportSamples, limit: int = 400) -> list[tuple[float, float]]:
    """Spans of time in which a 0/1 signal (n, 1) is set; near ones are joined until at most `limit` remain."""
    on = flags.values[:, 0] > 0.5
    if not on.any():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(np.int8)))
    last = len(flags.t_s) - 1
    spans = [(float(flags.t_s[a]), float(flags.t_s[min(b, last)])) for a, b in edges.reshape(-1, 2)]
    gap = (float(flags.t_s[-1]) - float(flags.t_s[0])) / 2000.0
    while True:
        joined = [spans[0]]
        for span in spans[1:]:
            if span[0] - joined[-1][1] <= gap:
                joined[-1] = (joined[-1][0], span[1])
            else:
                joined.append(span)
        if len(joined) <= limit:
            return joined
        gap *= 2.0


def rms(values: F64) -> float | None:
    """Root mean square of the finite values; None where there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else None


def within(signal: ReportSamples, start_s: float, end_s: float) -> F64:
    """The rows (m, k) between two times, both included."""
    return signal.values[(signal.t_s >= start_s) & (signal.t_s <= end_s)]


def encode(values: F64) -> str:
    """Little-endian float32 in base64: an array as the page's script reads it; what float32 can't hold is unknown."""
    with np.errstate(invalid="ignore"):
        fits = np.abs(values) <= np.finfo(np.float32).max
    return base64.b64encode(np.where(fits, values, np.nan).astype("<f4").tobytes()).decode("ascii")
