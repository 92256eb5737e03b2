"""Figures of the paper's first example: wind field, tracking error, inference time, and the baselines."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flightstack.frames import quat_to_matrix
from flightstack_paper.figures import Source
from flightstack_paper.figures.plain import quadrotor, shown
from flightstack_paper.figures.style import AMBER, BLUE, GREEN, GREY, GRID, RED
from flightstack_paper.plan import PILOTS, inputs_name, tracking_name

_ENLARGED = 2.0
_ROTOR_RADIUS_M = 0.1


def wind_field(source: Source) -> Figure | None:
    """The true vehicle on its way, the desired trajectory, and the force as a field of arrows."""
    found = source.part(tracking_name(source.plant, "learning", source.seed))
    if found is None:
        return None
    picture = found["picture"]
    figure = plt.figure(figsize=(8.0, 5.4), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    force = np.array(picture["force_n"]) / (picture["mass_kg"] * 9.80665)
    grid = np.stack(np.meshgrid((-1.8, 0.0, 1.8), (-1.4, 0.0, 1.4), (-2.2, -1.5, -0.8)), axis=-1).reshape(-1, 3)
    arrow = 5.0 * force
    axes.quiver(*np.array([shown(point) for point in grid]).T, *shown(arrow), color=BLUE, alpha=0.4, linewidth=1.0)
    path, reference = (np.array([shown(p) for p in picture[name]]) for name in ("pos_ned_m", "reference_ned_m"))
    without = source.part(tracking_name(source.plant, "none", source.seed))
    if without is not None:
        line = np.array([shown(p) for p in without["picture"]["pos_ned_m"]])
        axes.plot(*line.T, color=GREY, linewidth=1.0, label="flown without learning")
    axes.plot(*path.T, color=RED, linewidth=1.4, label="flown, learning")
    axes.plot(*reference.T, "--", color="black", linewidth=1.0, label="desired trajectory")
    for pose in picture["poses"]:
        body = quat_to_matrix(np.array(pose["q_ned_frd"]))
        rotors = _ENLARGED * np.array(picture["rotors_frd_m"])
        quadrotor(axes, np.array(pose["pos_ned_m"]), body, rotors, _ENLARGED * _ROTOR_RADIUS_M)
    axes.plot([], [], color=BLUE, label=f"unknown wind: {np.linalg.norm(force):.1f} g")
    axes.set(xlabel="east, m", ylabel="north, m", zlabel="up, m")
    axes.set_box_aspect((1.2, 1.5, 0.7))
    axes.view_init(elev=26, azim=-22)
    axes.legend(loc="upper left", fontsize=9)
    return figure


def error(source: Source) -> Figure | None:
    """Error over time, without and with."""
    both = {name: source.part(tracking_name(source.plant, name, source.seed)) for name in ("none", "learning")}
    if None in both.values():
        return None
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.4), layout="constrained")
    words = ("a", "Tracking error without GP", RED), ("b", "Tracking error with GP", GREEN)
    for axes, found, (letter, title, colour) in zip(panels, both.values(), words, strict=True):
        assert found is not None
        trace = 100.0 * np.array(found["trace_m"])
        time_s = found["trace_from_s"] + (np.arange(len(trace)) + 0.5) / 10.0
        axes.plot(time_s, trace, color=colour, linewidth=1.2)
        axes.axvline(0.0, color="black", linewidth=0.8)
        settled = 100.0 * found["rmse_settled_m"]
        axes.axhline(settled, color=GREY, linestyle="--", linewidth=0.9, label=f"settled rms {settled:.2f} cm")
        axes.set(xlabel="time on the path, s", ylabel="distance, cm", xlim=(time_s[0], time_s[-1]), ylim=(0.0, None))
        axes.set_title(f"({letter}) {title}", fontsize=10)
        axes.legend(fontsize=8)
        axes.grid(**GRID)
    return figure


def inference(source: Source) -> Figure | None:
    """Milliseconds of each iteration."""
    found = source.part(tracking_name(source.plant, "learning", source.seed))
    if found is None:
        return None
    timed = found["inference"]
    shown_ms = np.array(timed["shown_ms"])
    figure, axes = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
    axes.plot(
        np.arange(len(shown_ms)) * timed["shown_every"], shown_ms, color=BLUE, linewidth=0.7, label="one iteration"
    )
    axes.axhline(20.0, color=RED, linestyle="--", linewidth=1.2, label="the paper's bound: 20 ms")
    axes.axhline(timed["max_ms"], color=AMBER, linestyle=":", linewidth=1.2, label=f"greatest {timed['max_ms']:.3f} ms")
    axes.set_yscale("log")
    axes.set(xlabel="iteration", ylabel="time, ms", ylim=(0.5 * shown_ms.min(), 60.0))
    axes.legend(fontsize=8, loc="center right")
    axes.grid(**GRID)
    return figure


def baselines(source: Source) -> Figure | None:
    """Settled error of every pilot."""
    flown = {pilot: _errors_cm(source, pilot) for pilot in PILOTS}
    errors = {pilot: float(np.median(each)) for pilot, each in flown.items() if each}
    if not errors:
        return None
    figure, axes = plt.subplots(figsize=(8.0, 3.4), layout="constrained")
    places = np.arange(len(errors))
    colours = [GREEN if pilot == "learning" else RED if pilot == "none" else GREY for pilot in errors]
    axes.barh(places, list(errors.values()), color=colours, height=0.7)
    for place, (pilot, value) in enumerate(errors.items()):
        axes.plot(flown[pilot], [place] * len(flown[pilot]), "o", color="black", markersize=3)
        beside = (max(flown[pilot]), place)
        axes.annotate(f"{value:.2f}", beside, xytext=(6, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(places, [PILOTS[pilot] for pilot in errors], fontsize=8)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set(xlabel="settled rms error, cm", xlim=(0.5 * min(errors.values()), 1.8 * max(errors.values())))
    axes.grid(axis="x", **GRID)
    return figure


def _errors_cm(source: Source, pilot: str) -> list[float]:
    """Settled errors of a pilot's flights, one a seed."""
    seeds = (source.seed, source.seed + 1, source.seed + 2)
    found = [source.part(tracking_name(source.plant, pilot, seed)) for seed in seeds]
    return [100.0 * part["rmse_settled_m"] for part in found if part is not None]


def inputs(source: Source) -> Figure | None:
    """Error of prediction over displacement, for each set of inputs, in each world."""
    found = {world: source.part(inputs_name(source.plant, world)) for world in ("paper", "air", "ground")}
    studies = {world: part["rows"] for world, part in found.items() if part is not None}
    if not studies:
        return None
    figure, panels = plt.subplots(1, len(studies), figsize=(4.0 * max(len(studies), 1.3), 3.4), layout="constrained")
    titles = {"paper": "the paper's mass and force", "air": "drag, lift, wind", "ground": "ground effect"}
    for axes, (world, rows) in zip(np.atleast_1d(panels), studies.items(), strict=True):
        _errors(axes, rows)
        axes.set_title(titles[world], fontsize=10)
    return figure


def _errors(axes: Axes, rows: list[dict[str, Any]]) -> None:
    far = sorted({row["displacement_m"] for row in rows})
    for name, colour, mark in (("q'", GREEN, "o-"), ("q", RED, "s-"), ("q' and nearness of the ground", BLUE, "^-")):
        errors = {row["displacement_m"]: row["error_mps2"] for row in rows if row["inputs"] == name}
        if errors:
            axes.plot(far, [errors[d] for d in far], mark, color=colour, markersize=4, label=name)
    sizes = {row["displacement_m"]: row["residual_mps2"] for row in rows}
    axes.plot(far, [sizes[d] for d in far], ":", color=GREY, label="the residual itself")
    axes.set_yscale("log")
    axes.set(xlabel="path displaced by, m", ylabel="rms error of prediction, m/s²")
    axes.legend(fontsize=8)
    axes.grid(**GRID)
