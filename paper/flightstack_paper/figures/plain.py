"""Figures that need no flight: Example 1 and the frames."""

from __future__ import annotations

import math
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from flightstack.frames import quat_from_euler, quat_to_matrix
from flightstack_paper.figures import Source
from flightstack_paper.figures.style import BLUE, GREEN, GREY, GRID, RED, closed

_ROLL, _PITCH, _YAW = (math.radians(angle) for angle in (20.0, 15.0, 40.0))


def example1(source: Source) -> Figure | None:
    """The published regions, our own, and motions from our boundary."""
    found = source.part("example1")
    if found is None:
        return None
    figure, axes = plt.subplots(figsize=(6.4, 5.6), layout="constrained")
    for motion in found["motions"]:
        line = np.array(motion)
        axes.plot(line[:, 0], line[:, 1], color=GREY, linewidth=0.6, alpha=0.7)
    region = found["regions"]
    for name, colour, style, words in (
        ("published_lyapunov", RED, "--", "Lyapunov, as printed"),
        ("lyapunov", BLUE, ":", "Lyapunov, ours"),
        ("published_barrier", GREEN, "-", "barrier, as printed"),
        ("barrier", BLUE, "-.", "barrier, ours"),
    ):
        closed(axes, region[name]["boundary"], colour, style, f"{words}: area {region[name]['area']:.3f}")
    for name in ("published_lyapunov", "published_barrier"):
        x, y = region[name]["least_rate_at"]
        axes.plot([x], [y], "x", color="black", markersize=8)
    axes.plot([], [], "x", color="black", label="here motions leave the printed region")
    axes.set(xlabel="$x_1$", ylabel="$x_2$", aspect="equal")
    axes.grid(**GRID)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, fontsize=8)
    return figure


def frames(source: Source) -> Figure:
    """World, intermediate and body frame, by the rotations that fly."""
    figure = plt.figure(figsize=(6.4, 5.0), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    body = quat_to_matrix(quat_from_euler(_ROLL, _PITCH, _YAW))
    turned = quat_to_matrix(quat_from_euler(0.0, 0.0, _YAW))
    for name, place, matrix, colour in (
        ("w", np.array([-1.6, -1.0, 0.6]), np.eye(3), GREY),
        ("c", np.array([0.6, 0.6, -0.4]), turned, BLUE),
        ("b", np.array([0.6, 0.6, -0.4]), body, RED),
    ):
        for axis, letter in enumerate("xyz"):
            end = place + 0.95 * matrix[:, axis]
            style = "--" if name == "c" else "-"
            axes.plot(*zip(shown(place), shown(end), strict=True), style, color=colour, linewidth=1.8)
            axes.text(*shown(place + 1.1 * matrix[:, axis]), f"${letter}_{name}$", color=colour, fontsize=11)
    quadrotor(
        axes, np.array([0.6, 0.6, -0.4]), body, 0.55 * np.array([[1, 1, 0], [-1, -1, 0], [1, -1, 0], [-1, 1, 0]]), 0.3
    )
    axes.set(xlabel="east", ylabel="north", zlabel="up")
    axes.set_box_aspect((1.0, 1.0, 0.8))
    axes.view_init(elev=28, azim=-62)
    axes.tick_params(labelbottom=False, labelleft=False, labelright=False, labeltop=False)
    return figure


def shown(point: Any) -> tuple[float, float, float]:
    """East, north, up (right-handed, as the plot's axes are) of a point north-east-down."""
    return float(point[1]), float(point[0]), -float(point[2])


def quadrotor(axes: Any, place: Any, body: Any, rotors: Any, radius: float) -> None:
    """Arms and rotor disks, north-east-down; `rotors` (4, 3) in the body."""
    turn = np.linspace(0.0, 2.0 * np.pi, 25)
    disk = radius * np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    for rotor in rotors:
        hub = place + body @ rotor
        axes.plot(*zip(shown(place), shown(hub), strict=True), color="black", linewidth=1.4)
        ring = np.array([shown(hub + body @ point) for point in disk])
        front = GREEN if rotor[0] > 0.0 else "black"
        axes.plot(*ring.T, color=front, linewidth=1.1)
