"""The lateness histogram as static SVG, logarithmic: a punctual loop and a missed deadline lie decades apart."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from flightstack.types import F64

BINS_PER_DECADE = 5
_LEFT, _RIGHT, _TOP, _BOTTOM = 44.0, 8.0, 8.0, 34.0


def edges_us(lateness_us: F64) -> F64:
    """Bin edges, microseconds, whole decades round the data; what is below 1 us falls into the first bin."""
    largest = max(float(np.max(lateness_us)), 10.0)
    decades = max(2, math.ceil(math.log10(largest) - 1e-12))
    return np.power(10.0, np.arange(decades * BINS_PER_DECADE + 1) / BINS_PER_DECADE)


def counts(lateness_us: F64, edges: F64) -> list[int]:
    """Samples in each bin; none is left out: below the first edge counts as first, at the last edge as last."""
    inside = np.clip(lateness_us, edges[0], np.nextafter(edges[-1], 0.0))
    return [int(n) for n in np.histogram(inside, edges)[0]]


def lateness_svg(lateness_us: F64, period_us: float | None, *, width: float = 520.0, height: float = 190.0) -> str:
    """An SVG image of how late the ticks were; heights are logarithmic too, so that a single late tick is seen."""
    finite = lateness_us[np.isfinite(lateness_us)]
    if not finite.size:
        return ""
    edges = edges_us(finite)
    return histogram_svg(edges, counts(finite, edges), "lateness", "ticks", period_us, width=width, height=height)


def histogram_svg(
    edges: F64, bins: Sequence[int], of: str, counted: str, period_us: float | None = None,
    *, width: float = 520.0, height: float = 190.0,
) -> str:  # fmt: skip
    """An SVG image of counts in logarithmic bins of microseconds: `of` what, and how many of what are `counted`."""
    plot_w, plot_h = width - _LEFT - _RIGHT, height - _TOP - _BOTTOM
    top_decade = max(1, math.ceil(math.log10(max(bins)) + 1e-9))
    bar_w = plot_w / len(bins)

    def y_of(count: float) -> float:
        # Half a count is the floor: a bin with one sample still shows.
        return _TOP + plot_h * (1.0 - math.log10(count / 0.5) / (top_decade + math.log10(2.0)))

    def x_of(us: float) -> float:
        return _LEFT + plot_w * math.log10(max(us, 1.0)) / math.log10(float(edges[-1]))

    out = [f'<svg class="histogram" viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="Histogram of {of}">']
    for decade in range(top_decade + 1):
        y = y_of(10.0**decade)
        out.append(f'<line class="grid" x1="{_LEFT:.1f}" x2="{width - _RIGHT:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>')
        out.append(f'<text x="{_LEFT - 6:.1f}" y="{y + 4:.1f}" text-anchor="end">{_si(10**decade)}</text>')
    for i, count in enumerate(bins):
        if count:
            y = y_of(count)
            title = f"{_us(float(edges[i]))} to {_us(float(edges[i + 1]))}: {count} {counted}"
            out.append(
                f'<rect class="bar" x="{_LEFT + i * bar_w + 0.5:.1f}" y="{y:.1f}" width="{bar_w - 1:.1f}" '
                f'height="{_TOP + plot_h - y:.1f}"><title>{title}</title></rect>'
            )
    base = _TOP + plot_h
    for decade in range(round(math.log10(float(edges[-1]))) + 1):
        x = x_of(10.0**decade)
        anchor = "end" if x > width - _RIGHT - 1.0 else "middle"
        out.append(f'<text x="{x:.1f}" y="{base + 15:.1f}" text-anchor="{anchor}">{_us(10.0**decade)}</text>')
    if period_us is not None and period_us < edges[-1]:
        x = x_of(period_us)
        out.append(f'<line class="limit" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP:.1f}" y2="{base:.1f}"/>')
        out.append(f'<text class="limit" x="{x - 4:.1f}" y="{_TOP + 10:.1f}" text-anchor="end">one period</text>')
    middle = _LEFT + plot_w / 2
    out.append(
        f'<text x="{middle:.1f}" y="{height - 4:.1f}" text-anchor="middle">{of}; height: number of {counted}</text>'
    )
    out.append("</svg>")
    return "".join(out)


def _us(value: float) -> str:
    if value < 999.5:
        return f"{value:.0f} µs" if value >= 9.95 or value == int(value) else f"{value:.1f} µs"
    if value < 999_500.0:
        return f"{value / 1000.0:.3g} ms"
    return f"{value / 1e6:.3g} s"


def _si(value: int) -> str:
    return f"{value // 1000} k" if value >= 1000 else str(value)
