"""The path in the (position, velocity) plane of one axis as static SVG, with the regions round it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flightstack import targets
from flightstack.barrier.shapes import Barrier
from flightstack.types import F64
from flightstack_logs.report.plot import Plot, inner_size

_SIZE = 420.0, 320.0
_ANGLES = 180
_MAP = ("east, m", "north, m")


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """A closed line round a region."""

    role: str
    """certified, before or region: how it is drawn."""
    points: F64
    """(n, 2) position and velocity."""


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """What is drawn of one axis; (n, 2) are position relative to the start, m, and velocity, m/s."""

    name: str
    idle: F64
    """While the filter was not engaged; NaN rows part it."""
    engaged: F64
    changed: F64
    """Where the filter changed the command."""
    outlines: tuple[Outline, ...] = ()
    is_map: bool = False
    """Seen from above instead: (n, 2) are east and north, m, to one scale."""


def ellipse(centre_m: float, semi_m: float, semi_mps: float) -> F64:
    """(n, 2) the boundary e^2 / a^2 + v^2 / b^2 = 1."""
    angle = np.linspace(0.0, 2.0 * math.pi, _ANGLES, endpoint=False)
    return np.stack([centre_m + semi_m * np.cos(angle), semi_mps * np.sin(angle)], axis=1)


def boundary(barrier: Barrier, centre_m: float = 0.0) -> F64:
    """(n, 2) the boundary h = 0."""
    points: F64 = np.array(targets.boundary(barrier, _ANGLES)) + np.array([centre_m, 0.0])
    return points


def plane_svg(plane: Plane) -> str:
    """An SVG image of the plane; empty where there is nothing to draw."""
    parts = [plane.engaged, *(line.points for line in plane.outlines)]
    everything = _finite(np.concatenate(parts))
    if not len(everything):
        everything = _finite(plane.idle)
    if not len(everything):
        return ""
    low, high = everything.min(axis=0), everything.max(axis=0)
    pad = 0.06 * np.maximum(high - low, 0.1)
    low, high = low - pad, high + pad
    if plane.is_map:  # a metre is as long upwards as across
        size = np.array(inner_size(*_SIZE))
        half = 0.5 * size * float(np.max((high - low) / size))
        low, high = 0.5 * (low + high) - half, 0.5 * (low + high) + half
    label = "Path from above" if plane.is_map else f"Path in the plane of position and velocity, {plane.name}"
    names = _MAP if plane.is_map else (f"position {plane.name}, m", "velocity, m/s")
    x, y = zip(low.tolist(), high.tolist(), strict=True)
    plot = Plot(x, y, names, label, width=_SIZE[0], height=_SIZE[1], role="plane", clip=f"plane-{plane.name}")
    for line in plane.outlines:
        plot.line(line.points, line.role, closed=True)
    plot.line(plane.idle, "idle")
    plot.line(plane.engaged, "flown")
    plot.dots(plane.changed, "changed")
    return plot.svg()


def _finite(points: F64) -> F64:
    return points[np.isfinite(points).all(axis=1)]


def parted(points: F64, kept: Sequence[bool] | np.ndarray) -> F64:
    """The kept rows; a NaN row wherever some were left out."""
    kept = np.asarray(kept, dtype=bool)
    lifted = points.copy()
    lifted[~kept] = np.nan
    both_gone = ~kept & ~np.concatenate([[False], kept[:-1]])
    return np.asarray(lifted[~both_gone], dtype=np.float64)
