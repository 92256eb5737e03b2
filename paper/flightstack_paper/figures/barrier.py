"""Figures of the paper's second example: regions, growth, adaptive sampling, and what they are worth."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from flightstack.barrier import viability
from flightstack.barrier.published import on_the_vertical
from flightstack_logs.report.phase_plane import boundary
from flightstack_paper.figures import Source
from flightstack_paper.figures.style import BLUE, GREEN, GREY, GRID, RED, closed, plane
from flightstack_paper.plan import MODES, PUBLISHED, SOUND, certify_name

_PAPER_MU = 0.6


def growth(source: Source) -> Figure | None:
    """Every region that was certified in flight, in its order."""
    found = source.part(certify_name(source.plant, SOUND))
    if found is None:
        return None
    figure, (axes, beside) = plt.subplots(1, 2, figsize=(9.4, 4.2), layout="constrained", width_ratios=(1.3, 1.0))
    regions = found["regions"]
    shades = plt.get_cmap("RdYlGn_r")(np.linspace(0.05, 0.95, len(regions)))
    for number, (region, shade) in enumerate(zip(regions, shades, strict=True)):
        label = "first" if number == 0 else "last" if number == len(regions) - 1 else ""
        closed(axes, region, shade, "-", label)
    plane(axes)
    axes.legend(fontsize=8)
    rounds = found["growth"]
    areas = found["areas_m2ps"]
    beside.step(
        [row["time_s"] for row in rounds],
        [row["area_m2ps"] for row in rounds],
        where="post",
        color=BLUE,
        label="in flight, at each round",
    )
    beside.axhline(areas[-1], color=RED, linestyle="--", linewidth=1.2, label="designed anew with all that was learned")
    beside.set(xlabel="time since take-off, s", ylabel="certified area, m²/s", ylim=(0.0, 1.15 * max(areas)))
    beside.legend(fontsize=8, loc="lower right")
    beside.grid(**GRID)
    return figure


def regions(source: Source) -> Figure | None:
    """First and last region, the flown path, the states flown through."""
    found = {mode: source.part(certify_name(source.plant, mode)) for mode in (PUBLISHED, SOUND)}
    if None in found.values():
        return None
    figure, panels = plt.subplots(1, 2, figsize=(10.0, 4.8), sharex=True, sharey=True, layout="constrained")
    for axes, (mode, part) in zip(panels, found.items(), strict=True):
        assert part is not None
        path = np.array(part["path"])
        axes.plot(path[:, 0], path[:, 1], color=BLUE, linewidth=0.5, alpha=0.7, label="flown (truth)")
        closed(axes, part["kernel"], GREY, ":", "viability kernel", 1.2)
        closed(axes, part["regions"][0], GREEN, "-", "first region")
        closed(axes, part["regions"][-1], RED, "--", "final region")
        if mode == SOUND:
            points = [list(point) for point in boundary(on_the_vertical(part["limit_m"], _PAPER_MU)).tolist()]
            closed(axes, points, "black", "-.", "the paper's, mu = 0.6", 0.9)
        targets = np.array(part["targets"]).reshape(-1, 2)
        axes.plot(targets[:, 0], targets[:, 1], "*", color=RED, markersize=6, label="flown through")
        plane(axes, f"{mode}: mu {part['mu_initial']:.1f} to {part['mu_final']:.3f}, area {part['area_m2ps']:.2f} m²/s")
        axes.legend(fontsize=7, loc="lower left")
    return figure


def sampling(source: Source) -> Figure | None:
    """Samples with the circles that they vouch for: the paper's form and the strict one."""
    found = source.part(certify_name(source.plant, PUBLISHED))
    if found is None or found["sampling"] is None:
        return None
    figure, panels = plt.subplots(1, 2, figsize=(11.0, 5.2), layout="constrained")
    sampled = found["sampling"]
    for axes, form, words in zip(panels, ("published", "strict"), ("the paper's h", "with a cross term"), strict=True):
        _samples(axes, sampled[form], sampled["present"])
        count = f"{len(sampled[form]['points'])} samples, {len(sampled[form]['open'])} cells open"
        plane(axes, f"{words}, mu = {sampled[form]['mu']:.3f}: {count}")
    return figure


def _samples(axes: Axes, sampled: dict[str, Any], present: list[list[float]]) -> None:
    points, radius = np.array(sampled["points"]), np.array(sampled["radius"])
    still = np.array(sampled["open"]).reshape(-1, 2)
    inside = _inside(points, np.array(present)) if present else np.zeros(len(points), dtype=bool)
    axes.add_collection(
        EllipseCollection(
            2.0 * radius,
            2.0 * radius,
            np.zeros(len(points)),
            units="xy",
            offsets=points,
            transOffset=axes.transData,
            facecolors="none",
            edgecolors=RED,
            linewidths=0.35,
            alpha=0.5,
        )
    )
    axes.plot(*points[inside].T, "+", color=GREEN, markersize=5, label="sampled before")
    axes.plot(*points[~inside].T, "*", color=RED, markersize=3.5, label="to be sampled")
    if len(still):
        axes.plot(*still.T, "s", color="black", markersize=2.5, label="open")
    closed(axes, present, GREEN, "-", "present region")
    closed(axes, sampled["outline"], RED, "--", "next region")
    axes.set_aspect("equal")
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.02, 1.0))


def _inside(points: Any, boundary: Any) -> Any:
    """Which of the points (n, 2) lie in an ellipse about the origin, given by its boundary (m, 2)."""
    a, b = np.abs(boundary).max(axis=0)
    return (points[:, 0] / a) ** 2 + (points[:, 1] / b) ** 2 <= 1.0


def sampled(source: Source) -> Figure | None:
    """How far the published filter lets a pushed vehicle go, at each period of its commands."""
    found = source.part("theory")
    if found is None:
        return None
    both = found["sampled"]
    figure, panels = plt.subplots(1, 2, figsize=(9.4, 3.6), sharey=True, layout="constrained")
    for axes, (name, title) in zip(
        panels, (("published", "as published"), ("cross", "with a cross term")), strict=True
    ):
        for period_s, trace, shade in zip(
            both["periods_s"], both[name]["traces"], (GREEN, BLUE, "#b06c00", RED), strict=True
        ):
            line = np.array(trace)
            axes.plot(
                line[:, 0], line[:, 1], color=shade, linewidth=1.0, label=f"a command every {1000 * period_s:g} ms"
            )
        axes.axhline(0.6, color="black", linestyle="--", linewidth=1.0, label="the region's end")
        axes.set(xlabel="time, s", ylabel="e, m")
        axes.set_title(title, fontsize=10)
        axes.grid(**GRID)
    panels[0].legend(fontsize=7)
    return figure


def areas(source: Source) -> Figure | None:
    """Final regions beside the kernels that bound them."""
    found = {mode: source.part(certify_name(source.plant, mode)) for mode in MODES}
    sound, published = found[SOUND], found[PUBLISHED]
    if sound is None or published is None:
        return None
    limit, truth = sound["limit_m"], 1.0 / (sound["limit_m"] * sound["mu_physics_bare"])
    bars = {
        "viability kernel, no margin at all": (viability.area(-limit, limit, -truth, 9.80665), GREY),
        "viability kernel, every margin": (sound["area_kernel_m2ps"], GREY),
        "sound: certified and checked": (sound["area_m2ps"], GREEN),
        "as published": (published["area_m2ps"], RED),
        "the paper's, mu = 0.6": (float(np.pi * limit / np.sqrt(_PAPER_MU)), RED),
        "the first region": (sound["area_initial_m2ps"], BLUE),
    }
    figure, axes = plt.subplots(figsize=(8.0, 2.8), layout="constrained")
    for place, (value, colour) in enumerate(bars.values()):
        axes.barh(place, value, color=colour, height=0.7)
        axes.annotate(
            f"{value:.2f}", (value, place), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8
        )
    axes.set_yticks(range(len(bars)), list(bars), fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="area in the plane of e and v, m²/s", xlim=(0.0, 1.12 * max(value for value, _ in bars.values())))
    axes.grid(axis="x", **GRID)
    return figure
