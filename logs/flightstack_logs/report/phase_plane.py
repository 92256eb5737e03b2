"""The path in the (position, velocity) plane of one axis as static SVG, with the regions round it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flightstack.barrier.shapes import Barrier, value
from flightstack.types import F64

_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 8.0, 8.0, 36.0
_ANGLES = 180
_HALVINGS = 40
_TICKS = 5
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


def boundary(barrier: Barrier, centre_m: float) -> F64:
    """(n, 2) the boundary h = 0, found by halving along rays from inside: the region is convex."""
    low, high, slowest, fastest = barrier.box
    e_mid, half_e = 0.5 * (low + high), 0.5 * (high - low)
    half_v = 0.5 * (fastest - slowest)
    v_mid = max((0.0, 0.5 * (slowest + fastest)), key=lambda v: value(barrier, e_mid, v))
    points = []
    for angle in np.linspace(0.0, 2.0 * math.pi, _ANGLES, endpoint=False).tolist():
        along_e, along_v = half_e * math.cos(angle), half_v * math.sin(angle)
        inside, outside = 0.0, 4.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (inside + outside)
            if value(barrier, e_mid + middle * along_e, v_mid + middle * along_v) >= 0.0:
                inside = middle
            else:
                outside = middle
        points.append((centre_m + e_mid + inside * along_e, v_mid + inside * along_v))
    return np.array(points)


def plane_svg(plane: Plane, *, width: float = 420.0, height: float = 320.0) -> str:
    """An SVG image of the plane; empty where there is nothing to draw.

    It shows the regions and the path among them; the rest of the path, from the ground and back, may be cut off.
    """
    parts = [plane.engaged, *(line.points for line in plane.outlines)]
    everything = _finite(np.concatenate(parts))
    if not len(everything):
        everything = _finite(plane.idle)
    if not len(everything):
        return ""
    low, high = everything.min(axis=0), everything.max(axis=0)
    pad = 0.06 * np.maximum(high - low, 0.1)
    low, high = low - pad, high + pad
    size = np.array([width - _LEFT - _RIGHT, -(height - _TOP - _BOTTOM)])
    if plane.is_map:
        half = 0.5 * np.abs(size) * float(np.max((high - low) / np.abs(size)))
        low, high = 0.5 * (low + high) - half, 0.5 * (low + high) + half
    corner = np.array([_LEFT, height - _BOTTOM])

    def place(points: F64) -> F64:
        return np.asarray(corner + (points - low) / (high - low) * size, dtype=np.float64)

    clip = f"plane-{plane.name}"
    frame = f'x="{_LEFT}" y="{_TOP}" width="{size[0]:.0f}" height="{-size[1]:.0f}"'
    label = "Path from above" if plane.is_map else f"Path in the plane of position and velocity, {plane.name}"
    names = _MAP if plane.is_map else (f"position {plane.name}, m", "velocity, m/s")
    out = [f'<svg class="plane" viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{label}">']
    out += _axes(low, high, place, width, height, names)
    out.append(f'<clipPath id="{clip}"><rect {frame}/></clipPath><g clip-path="url(#{clip})">')
    for line in plane.outlines:
        closed = " ".join(_xy(place(line.points)))
        out.append(f'<polygon class="{line.role}" points="{closed}"/>')
    out += [_line("idle", place(plane.idle)), _line("flown", place(plane.engaged))]
    out += [f'<circle class="changed" cx="{x:.1f}" cy="{y:.1f}" r="2"/>' for x, y in place(plane.changed).tolist()]
    out.append("</g></svg>")
    return "".join(part for part in out if part)


def _finite(points: F64) -> F64:
    return points[np.isfinite(points).all(axis=1)]


def _xy(points: F64) -> list[str]:
    return [f"{x:.1f},{y:.1f}" for x, y in points.tolist()]


def _line(role: str, points: F64) -> str:
    """One path, lifted where a row is NaN."""
    parts, down = [], False
    for x, y in points.tolist():
        if not (math.isfinite(x) and math.isfinite(y)):
            down = False
            continue
        parts.append(f"{'L' if down else 'M'}{x:.1f} {y:.1f}")
        down = True
    return f'<path class="{role}" d="{"".join(parts)}"/>' if parts else ""


def ticks(low: float, high: float) -> list[float]:
    """Round numbers (1, 2 or 5 times a power of ten apart) within a range."""
    step = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(step))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= step * 0.999)
    return [round(i * step, 9) for i in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _axes(
    low: F64, high: F64, place: Callable[[F64], F64], width: float, height: float, names: tuple[str, str]
) -> list[str]:  # fmt: skip
    """Grid, numbers and names."""
    base, left = height - _BOTTOM, _LEFT
    out: list[str] = []
    for at in ticks(low[0], high[0]):
        x = float(place(np.array([at, low[1]]))[0])
        out.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP:.1f}" y2="{base:.1f}"/>')
        out.append(f'<text x="{x:.1f}" y="{base + 14:.1f}" text-anchor="middle">{_number(at)}</text>')
    for at in ticks(low[1], high[1]):
        y = float(place(np.array([low[0], at]))[1])
        out.append(f'<line class="grid" x1="{left:.1f}" x2="{width - _RIGHT:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>')
        out.append(f'<text x="{left - 6:.1f}" y="{y + 4:.1f}" text-anchor="end">{_number(at)}</text>')
    middle = left + 0.5 * (width - left - _RIGHT)
    out.append(f'<text x="{middle:.1f}" y="{height - 6:.1f}" text-anchor="middle">{names[0]}</text>')
    half = 0.5 * (base + _TOP)
    turn = f'transform="rotate(-90 11 {half:.1f})"'
    out.append(f'<text x="11" y="{half:.1f}" text-anchor="middle" {turn}>{names[1]}</text>')
    return out


def _number(value: float) -> str:
    return f"{value:g}".replace("-", "−")


def parted(points: F64, kept: Sequence[bool] | np.ndarray) -> F64:
    """The kept rows; a NaN row wherever some were left out."""
    kept = np.asarray(kept, dtype=bool)
    lifted = points.copy()
    lifted[~kept] = np.nan
    both_gone = ~kept & ~np.concatenate([[False], kept[:-1]])
    return np.asarray(lifted[~both_gone], dtype=np.float64)
