"""The figures of docs/learning.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.learning_bars import COVERAGE_BAR
from benchmarks.learning_cases import CASES, PILOTS, SCHEDULED
from benchmarks.learning_stats import covered, of, values
from benchmarks.learning_timing import PAPER_S
from flightstack_paper.inputs import WORLDS

_COLOURS = {"learning": "#0b6e4f", "none": "#b3261e", "exact": "#555555", "state-gp": "#b06c00"}
_OTHER = "#3b6ea8"
_GRID: dict[str, Any] = {"alpha": 0.3, "linewidth": 0.6}
_SHOWN_NAMES = {"learning": "with learning", "none": "without learning", "exact": "exact model (the floor)"}
_COMPARED = ("paper-tracking", "rotor-drag", "low-pass", "steady-wind", "px4-sih")


def draw(results: dict[str, Any], folder: Path) -> list[str]:
    """Every figure that the results allow, as PNG files in `folder`; their names."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    for name, make in _FIGURES.items():
        figure = make(results)
        if figure is None:
            continue
        figure.savefig(folder / f"{name}.png", dpi=110, metadata={"Software": None})
        plt.close(figure)
        drawn.append(name)
    return drawn


def tracking(results: dict[str, Any]) -> Figure | None:
    """Error over time with and without the Gaussian process, and with the exact model."""
    traces = results["traces"]
    if "paper-tracking/none" not in traces:
        return None
    figure, axes = plt.subplots(figsize=(8.0, 3.6), layout="constrained")
    for pilot in ("none", "learning", "exact"):
        trace = traces[f"paper-tracking/{pilot}"]
        low, middle, high = (100.0 * np.array(trace[name]) for name in ("least_m", "median_m", "greatest_m"))
        time_s = trace["from_s"] + (np.arange(len(middle)) + 0.5) / 10.0
        axes.fill_between(time_s, low, high, color=_COLOURS[pilot], alpha=0.2, linewidth=0.0)
        style = ":" if pilot == "exact" else "-"
        axes.plot(time_s, middle, style, color=_COLOURS[pilot], linewidth=1.3, label=_SHOWN_NAMES[pilot])
    axes.set_yscale("log")
    axes.set_yticks([0.5, 1, 2, 5, 10, 20, 50], ["0.5", "1", "2", "5", "10", "20", "50"])
    axes.minorticks_off()
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.annotate("take-off, run-up", (0.0, 0.33), xytext=(-4, 0), textcoords="offset points", fontsize=8, ha="right")
    axes.set(xlabel="time on the path, s", ylabel="distance from the reference, cm", ylim=(0.3, 60.0))
    axes.set_xlim(time_s[0], time_s[-1])
    count = len(of(results["flights"], "paper-tracking", "learning"))
    axes.set_title(f"Tracking error on the paper's path: median and range over {count} seeds", fontsize=10)
    axes.legend(loc="center", bbox_to_anchor=(0.5, 0.66), ncols=3, fontsize=9)
    axes.grid(**_GRID)
    return figure


def compared(results: dict[str, Any]) -> Figure | None:
    """Settled error of every pilot in every case: a dot for each seed, a bar for the median."""
    flights = results["flights"]
    cases = [case for case in _COMPARED if of(flights, case, "learning")]
    if not cases:
        return None
    figure, panels = plt.subplots(1, len(cases), figsize=(2.5 * len(cases), 3.6), sharey=True, layout="constrained")
    pilots = [pilot for pilot in PILOTS if pilot not in SCHEDULED]
    for axes, case in zip(np.atleast_1d(panels), cases, strict=True):
        for place, pilot in enumerate(pilots):
            _dots(axes, place, 100.0 * values(of(flights, case, pilot)), _COLOURS.get(pilot, _OTHER))
        axes.set_xscale("log")
        axes.set_xlim(0.7, 100.0)
        axes.set_xticks([1, 10, 100], ["1", "10", "100"])
        axes.set_title(case, fontsize=10)
        axes.set_xlabel("settled rms error, cm")
        axes.grid(axis="x", **_GRID)
        axes.grid(axis="x", which="minor", alpha=0.12, linewidth=0.4)
    first = np.atleast_1d(panels)[0]
    first.set_yticks(range(len(pilots)), [_SHOWN_NAMES.get(pilot, pilot) for pilot in pilots])
    first.invert_yaxis()
    return figure


def _dots(axes: Axes, place: int, centimetres: np.ndarray, colour: str) -> None:
    shown = centimetres[np.isfinite(centimetres)]
    if not len(shown):
        return
    axes.plot(shown, np.full(len(shown), place), "o", color=colour, markersize=4, alpha=0.4, markeredgewidth=0.0)
    middle = float(np.median(shown))
    axes.plot([middle, middle], [place - 0.35, place + 0.35], color=colour, linewidth=2.0)
    right = middle < 25.0
    axes.annotate(
        f"{middle:.1f}" if middle < 9.95 else f"{middle:.0f}",
        (float(shown.max() if right else shown.min()), place),
        xytext=(5 if right else -5, 0),
        textcoords="offset points",
        fontsize=8,
        va="center",
        ha="left" if right else "right",
    )


def drop(results: dict[str, Any]) -> Figure | None:
    """The payload's fall: what was expected with its bound, what was true, and the distance from the reference."""
    flown = [r for r in of(results["flights"], "payload-drop", "learning") if r.get("change", {}).get("shown")]
    if not flown:
        return None
    shown = {name: np.array(column) for name, column in flown[0]["change"]["shown"].items()}
    time_s, mean, bound = shown["time_s"], shown["expected_mps2"], shown["bound_mps2"]
    figure, (above, below) = plt.subplots(2, 1, figsize=(8.0, 4.6), sharex=True, layout="constrained")
    above.fill_between(time_s, mean - bound, mean + bound, color=_COLOURS["learning"], alpha=0.2, linewidth=0.0)
    above.plot(time_s, mean, color=_COLOURS["learning"], linewidth=1.3, label="expected, with its 3-sigma bound")
    above.plot(time_s, shown["true_mps2"], color="black", linewidth=0.8, label="true")
    above.set_ylabel("residual along body z, m/s²")
    above.legend(fontsize=9)
    told = flown[0]["change"]["noticed_s"]
    if told is not None:
        above.set_title(f"0.3 kg fall off at 0 s; noticed after {1000.0 * told:.0f} ms", fontsize=10)
    below.plot(time_s, 100.0 * shown["distance_m"], color=_COLOURS["learning"], linewidth=1.3)
    below.set(xlabel="time since the payload fell, s", ylabel="distance from\nthe reference, cm", ylim=(0.0, None))
    for axes in (above, below):
        axes.axvline(0.0, color="black", linestyle=":", linewidth=0.8)
        axes.grid(**_GRID)
    below.set_xlim(time_s[0], time_s[-1])
    return figure


def coverage(results: dict[str, Any]) -> Figure | None:
    """Share of ticks within three sigma, each case and axis."""
    learning = [r for r in results["flights"] if r["pilot"] == "learning"]
    found = {case: seen for case in CASES if (seen := covered(r for r in learning if r["case"] == case)) is not None}
    if not found:
        return None
    figure, axes = plt.subplots(figsize=(8.0, 0.6 + 0.34 * len(found)), layout="constrained")
    axes.axvspan(*COVERAGE_BAR, color=_COLOURS["learning"], alpha=0.12, linewidth=0.0, label="0.990 to 0.9995")
    for mark, axis in zip("o^s", range(3), strict=True):
        shares = [seen.axes[axis] for seen in found.values()]
        axes.plot(shares, range(len(found)), mark, color=_OTHER, markersize=5, alpha=0.8, label=f"body {'xyz'[axis]}")
    every = [seen.simultaneous for seen in found.values()]
    axes.plot(every, range(len(found)), "x", color="black", markersize=6, label="all three at once")
    axes.set_yticks(range(len(found)), list(found))
    axes.invert_yaxis()
    axes.set_xlabel("share of ticks in which the true residual lies within 3 sigma")
    axes.grid(**_GRID)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=5, fontsize=8)
    return figure


def inputs(results: dict[str, Any]) -> Figure | None:
    """Error of prediction over displacement, for each set of inputs."""
    rows = results["inputs"]
    worlds = [world for world in WORLDS if any(row["world"] == world for row in rows)]
    if not worlds:
        return None
    figure, panels = plt.subplots(1, len(worlds), figsize=(4.2 * len(worlds), 3.7), layout="constrained")
    styles = {"q'": ("o-", _COLOURS["learning"]), "q": ("s-", _COLOURS["none"])}
    for axes, world in zip(np.atleast_1d(panels), worlds, strict=True):
        here = [row for row in rows if row["world"] == world]
        for name in dict.fromkeys(row["inputs"] for row in here):
            far = sorted({row["displacement_m"] for row in here})
            errors = [[r["error_mps2"] for r in here if r["inputs"] == name and r["displacement_m"] == d] for d in far]
            style, colour = styles.get(name, ("^-", _OTHER))
            axes.plot(far, [np.median(e) for e in errors], style, color=colour, markersize=4, label=name)
        sizes = [np.median([row["residual_mps2"] for row in here if row["displacement_m"] == d]) for d in far]
        axes.plot(far, sizes, ":", color="black", linewidth=1.0, label="the residual itself")
        axes.set_yscale("log")
        axes.set_yticks([0.03, 0.1, 0.3, 1.0, 3.0], ["0.03", "0.1", "0.3", "1", "3"])
        axes.minorticks_off()
        axes.set(xlabel="path displaced after training by, m", ylabel="rms error of prediction, m/s²", ylim=(0.02, 4.0))
        axes.set_title({"air": "drag, lift and wind", "ground": "ground effect, path raised"}[world], fontsize=10)
        axes.grid(**_GRID)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def iteration(results: dict[str, Any]) -> Figure | None:
    """Time of an iteration over the number of points."""
    rows = results["timing"]
    if not rows:
        return None
    figure, axes = plt.subplots(figsize=(5.5, 3.4), layout="constrained")
    points = [row["points"] for row in rows]
    axes.plot(points, [row["p50_us"] for row in rows], "o-", color=_COLOURS["learning"], label="median")
    axes.plot(points, [row["p99_us"] for row in rows], "^--", color=_COLOURS["learning"], alpha=0.6, label="99 %")
    axes.axhline(1e6 * PAPER_S, color="black", linestyle=":", label="the paper: below 20 ms")
    axes.set_yscale("log")
    axes.set_yticks([1, 10, 100, 1000, 10_000], ["1", "10", "100", "1,000", "10,000"])
    axes.set(xlabel="points held", ylabel="one iteration, µs", xlim=(0.0, None), ylim=(1.0, 5e4))
    axes.legend(fontsize=9, loc="center", bbox_to_anchor=(0.5, 0.66))
    axes.grid(**_GRID)
    return figure


_FIGURES = {
    "tracking": tracking,
    "compared": compared,
    "payload-drop": drop,
    "coverage": coverage,
    "inputs": inputs,
    "iteration": iteration,
}
