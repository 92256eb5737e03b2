"""Small plots as static SVG: axes with round ticks, lines, areas, boxes and marks in data coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from flightstack.types import F64

_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 12.0, 10.0, 38.0


class Plot:
    """One image; everything is drawn in the order of the calls."""

    def __init__(
        self, x: tuple[float, float], y: tuple[float, float], labels: tuple[str, str], title: str, *,
        width: float = 560.0, height: float = 400.0, role: str = "plot", clip: str = "",
    ) -> None:  # fmt: skip
        """`clip`: a name of its own on the page, where what reaches beyond the axes is cut off."""
        self._x, self._y, self._width, self._height = x, y, width, height
        self._out = [
            f'<svg class="{role}" viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(title)}">'
        ]
        self._axes(labels)
        self._end = "</g></svg>" if clip else "</svg>"
        if clip:
            across, up = inner_size(width, height)
            frame = f'<rect x="{_LEFT}" y="{_TOP}" width="{across:.0f}" height="{up:.0f}"/>'
            self._out.append(f'<clipPath id="{clip}">{frame}</clipPath><g clip-path="url(#{clip})">')

    def x(self, value: float) -> float:
        """Place of a value along x."""
        low, high = self._x
        return _LEFT + (value - low) / (high - low) * (self._width - _LEFT - _RIGHT)

    def y(self, value: float) -> float:
        """Place of a value along y; larger values lie higher."""
        low, high = self._y
        return self._height - _BOTTOM - (value - low) / (high - low) * (self._height - _TOP - _BOTTOM)

    def line(self, points: F64, role: str, *, closed: bool = False, label: str = "") -> None:
        """Points (n, 2) joined; gaps where they are not finite."""
        parts, pen = [], "M"
        for px, py in points.tolist():
            if not (math.isfinite(px) and math.isfinite(py)):
                pen = "M"
                continue
            parts.append(f"{pen}{self.x(px):.1f} {self.y(py):.1f}")
            pen = "L"
        if parts:
            end = "Z" if closed else ""
            self._out.append(f'<path class="{role}" d="{"".join(parts)}{end}">{_title(label)}</path>')

    def boxes(self, rows: F64, opacity: F64, role: str) -> None:
        """Rows (n, 4) x_low, x_high, y_low, y_high, each as opaque as `opacity` (n,) says."""
        for (x0, x1, y0, y1), share in zip(rows.tolist(), opacity.tolist(), strict=True):
            left, top = self.x(x0), self.y(y1)
            self._out.append(
                f'<rect class="{role}" x="{left:.2f}" y="{top:.2f}" width="{self.x(x1) - left:.2f}" '
                f'height="{self.y(y0) - top:.2f}" fill-opacity="{share:.2f}"/>'
            )

    def marks(self, points: F64, role: str, labels: Sequence[str] = ()) -> None:
        """A cross at each of the points (n, 2)."""
        for k, (px, py) in enumerate(points.tolist()):
            x, y = self.x(px), self.y(py)
            cross = f"M{x - 4:.1f} {y - 4:.1f}l8 8m0 -8l-8 8"
            self._out.append(f'<path class="{role}" d="{cross}">{_title(labels[k] if labels else "")}</path>')

    def dots(self, points: F64, role: str) -> None:
        """A dot at each of the points (n, 2)."""
        places = ((self.x(px), self.y(py)) for px, py in points.tolist())
        self._out += [f'<circle class="{role}" cx="{x:.1f}" cy="{y:.1f}" r="2"/>' for x, y in places]

    def svg(self) -> str:
        """The image."""
        return "".join(self._out) + self._end

    def _axes(self, labels: tuple[str, str]) -> None:
        low_x, high_x, low_y, high_y = *self._x, *self._y
        for value in ticks(low_x, high_x):
            x = self.x(value)
            self._out.append(f'<path class="grid" d="M{x:.1f} {self.y(low_y):.1f}V{self.y(high_y):.1f}"/>')
            self._out.append(
                f'<text x="{x:.1f}" y="{self.y(low_y) + 15:.1f}" text-anchor="middle">{_number(value)}</text>'
            )
        for value in ticks(low_y, high_y):
            y = self.y(value)
            self._out.append(f'<path class="grid" d="M{self.x(low_x):.1f} {y:.1f}H{self.x(high_x):.1f}"/>')
            self._out.append(f'<text x="{_LEFT - 6:.1f}" y="{y + 4:.1f}" text-anchor="end">{_number(value)}</text>')
        middle = 0.5 * (_LEFT + self._width - _RIGHT)
        self._out.append(
            f'<text x="{middle:.0f}" y="{self._height - 5:.0f}" text-anchor="middle">{escape(labels[0])}</text>'
        )
        turned = 0.5 * (_TOP + self._height - _BOTTOM)
        self._out.append(
            f'<text x="12" y="{turned:.0f}" text-anchor="middle" transform="rotate(-90 12 {turned:.0f})">'
            f"{escape(labels[1])}</text>"
        )


def inner_size(width: float, height: float) -> tuple[float, float]:
    """Width and height between the axes of an image."""
    return width - _LEFT - _RIGHT, height - _TOP - _BOTTOM


def ticks(low: float, high: float) -> list[float]:
    """Round values in [low, high], about five of them."""
    span = high - low
    step = 10.0 ** math.floor(math.log10(span / 4.0))
    step *= next(factor for factor in (1.0, 2.0, 5.0, 10.0) if span / (factor * step) <= 7.0)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def padded(values: F64, share: float = 0.06) -> tuple[float, float]:
    """The range of the finite values, a little wider; never empty."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    room = share * (high - low) or 0.5
    return low - room, high + room


def _number(value: float) -> str:
    return f"{0.0 if abs(value) < 1e-12 else value:.6g}".replace("-", "−")


def _title(words: str) -> str:
    return f"<title>{escape(words)}</title>" if words else ""
