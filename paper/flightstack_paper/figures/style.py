"""Colours and axes that the figures share; green and red are the paper's."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from flightstack.types import F64

GREEN, RED, BLUE, GREY, AMBER = "#1a7f37", "#b3261e", "#0066b3", "#8a929c", "#b06c00"
GRID: dict[str, Any] = {"alpha": 0.3, "linewidth": 0.6}


def closed(
    axes: Axes, points: list[list[float]], colour: str, style: str = "-", label: str = "", width: float = 1.8
) -> None:
    """A closed line."""
    if not points:
        return
    line: F64 = np.array([*points, points[0]])
    axes.plot(line[:, 0], line[:, 1], style, color=colour, linewidth=width, label=label or None)


def plane(axes: Axes, title: str = "") -> None:
    """Axes of e and v."""
    axes.set(xlabel="e = z + 0.8, m (down positive)", ylabel="v, m/s (down positive)")
    axes.grid(**GRID)
    if title:
        axes.set_title(title, fontsize=10)
