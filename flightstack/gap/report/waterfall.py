"""The waterfall of the gap: what each named effect takes off the held-out disagreement, down to the sensors' noise."""

from __future__ import annotations

import math
from html import escape

from flightstack.gap.report import words
from flightstack.gap.report.record import Step

_WIDTH, _LABEL, _VALUE, _ROW, _BAR = 640.0, 200.0, 124.0, 26.0, 15.0


def waterfall_svg(steps: tuple[Step, ...], floor: float | None, quantity: str, unit: str, title: str) -> str:
    """Bars for the figure `quantity` of each step; empty where the logs can't show it."""
    values = [getattr(step.figures, quantity) for step in steps]
    known = [(step, value) for step, value in zip(steps, values, strict=True) if value is not None]
    if not known or known[0][1] <= 0.0:
        return ""
    top = max(value for _, value in known)
    rows: list[str] = []
    before = 0.0
    for index, (step, value) in enumerate(known):
        y = 30.0 + index * _ROW
        if index == 0:
            rows.append(_bar(0.0, value, top, y, "whole", "the model as it was", f"{value:.3g} {unit}"))
        else:
            name = words.effect(step.name)
            change = value - before
            kind = "drop" if change <= 0.0 else "rise"
            text = f"{change:+.2g} {unit}".replace("-", "−")
            rows.append(_bar(min(value, before), max(value, before), top, y, kind, f"with {name}", text))
            rows.append(_link(before, top, y))
        before = value
    count = len(known)
    if count > 1:
        rows.append(_bar(0.0, before, top, 30.0 + count * _ROW, "left", "what is left", f"{before:.3g} {unit}"))
        count += 1
    height = 30.0 + count * _ROW + (18.0 if floor is not None else 4.0)
    if floor is not None and math.isfinite(floor):
        x = _x(floor, top)
        rows.append(f'<line class="floor" x1="{x:.1f}" x2="{x:.1f}" y1="22" y2="{height - 16:.0f}"/>')
        told = f"noise {floor:.2g} {escape(unit)}"
        end = ' text-anchor="end"' if x > 0.7 * _WIDTH else ""  # else it would leave the picture
        rows.append(f'<text class="muted" x="{x:.1f}" y="{height - 4:.0f}"{end}>{told}</text>')
    head = f'<text x="0" y="14" font-weight="650">{escape(title)}</text>'
    return (
        f'<svg class="waterfall" viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img" aria-label="{escape(title)}">'
        f"{head}{''.join(rows)}</svg>"
    )


def _x(value: float, top: float) -> float:
    return _LABEL + value / top * (_WIDTH - _LABEL - _VALUE)


def _bar(low: float, high: float, top: float, y: float, kind: str, label: str, text: str) -> str:
    left, right = _x(low, top), _x(high, top)
    return (
        f'<text x="{_LABEL - 8:.0f}" y="{y + 12:.1f}" text-anchor="end">{escape(label)}</text>'
        f'<rect class="{kind}" x="{left:.1f}" y="{y:.1f}" width="{max(right - left, 1.0):.1f}" height="{_BAR}"/>'
        f'<text class="muted" x="{right + 6:.1f}" y="{y + 12:.1f}">{escape(text)}</text>'
    )


def _link(value: float, top: float, y: float) -> str:
    x = _x(value, top)
    return f'<line class="link" x1="{x:.1f}" x2="{x:.1f}" y1="{y - _ROW + _BAR:.1f}" y2="{y:.1f}"/>'
