"""The figures: each of the paper's by its number, then our own; one PNG a figure and plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Results = Mapping[str, dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of the report."""

    file: str
    title: str
    caption: str


@dataclass(frozen=True, slots=True)
class Source:
    """What a figure is drawn from."""

    results: Results
    plant: str
    seed: int

    def part(self, name: str) -> dict[str, Any] | None:
        """A part's result; None where it failed."""
        found = self.results.get(name)
        return None if found is None or "failed" in found else found


Maker = Callable[[Source], "Canvas | None"]


@dataclass(frozen=True, slots=True)
class FigureEntry:
    """A figure of the table below."""

    file: str
    title: str
    caption: str
    module: str
    """Of this package; its function `make` draws."""
    make: str
    each_plant: bool = True


FIGURES = (
    FigureEntry("fig1-example1", "Fig. 1. Safe regions of Example 1",
        "Dashed red: the Lyapunov function's region as printed; solid green: the barrier's. Ours, strictly invariant "
        "by exact proof, in blue; grey: motions from our boundary.", "plain", "example1", False),
    FigureEntry("fig2-growth", "Fig. 2. Incremental learning of the barrier certificate",
        "The paper draws a sketch; these are the regions certified in flight, from the first (green) to the last "
        "(red); right their area.",
        "barrier", "growth"),
    FigureEntry("fig3-frames", "Fig. 3. Coordinate frames",
        "World (north, east, down), intermediate (turned by yaw) and body frame (forward, right, down) at roll 20, "
        "pitch 15 and yaw 40 degrees.", "plain", "frames", False),
    FigureEntry("fig4-wind-field", "Fig. 4. The quadrotor in the unknown wind field",
        "The true vehicle at five moments of the flight that learns, twice as large; dashed: the desired trajectory; "
        "grey: flown without learning; arrows: the constant force of 0.1 g.", "tracking", "wind_field"),
    FigureEntry("fig5-tracking-error", "Fig. 5. Tracking error without and with the Gaussian process",
        "Distance of the true position from the desired trajectory, rms over each tenth of a second. Left without, "
        "right with; another scale.", "tracking", "error"),
    FigureEntry("fig6-inference-time", "Fig. 6. Recursive GP inference time per iteration",
        "300 points, 9 inputs, 6 outputs, over the states of the flown track; the paper stays below 20 ms (red line). "
        "Single spikes: every 5,000 iterations the whole inverse is computed anew.",
        "tracking", "inference", False),
    FigureEntry("fig7-adaptive-sampling", "Fig. 7. Adaptive sampling of the state space",
        "Solid green: the present region, dashed red: the next. Green crosses: samples inside the present region, "
        "red stars: in the next alone; circles: where each one's condition holds. Left the paper's h: black cells "
        "stay open, those at the tips at any depth. Right the strict form with a cross term, which closes. "
        "Dense where little margin is left: only the thrust beyond weight brakes a descent, gravity brakes a climb.",
        "barrier", "sampling"),
    FigureEntry("fig8-regions", "Fig. 8. Initial and final barrier certificates",
        "Left as published, right sound: solid green the first region, dashed red the last, dotted the viability "
        "kernel at the certified braking; blue the flown path, red stars the states flown through to learn.",
        "barrier", "regions"),
    FigureEntry("figa-baselines", "A. The tracking flight with the baselines",
        "Settled rms error of every controller on the same flight: a dot for each seed, a bar to the median.",
        "tracking", "baselines"),
    FigureEntry("figb-inputs", "B. Inputs with position (q) and without (q')",
        "Error of prediction on the learned path, displaced: where forces don't depend on position, it misleads.",
        "tracking", "inputs"),
    FigureEntry("figc-sampled-filter", "C. The published filter, sampled",
        "Exact model, mu = 0.6, pushed down for ever: without a cross term the vehicle creeps out of |e| <= 0.6 m.",
        "barrier", "sampled", False),
    FigureEntry("figd-area", "D. The price of honesty in area",
        "Area of the final region as published and sound, and of the viability kernels that bound it: with every "
        "margin, and with none.", "barrier", "areas"),
)  # fmt: skip


def draw(results: Results, plants: tuple[str, ...], seed: int, folder: Path) -> list[Figure]:
    """Draw all that the results allow into `folder`; the figures in their order."""
    import matplotlib as mpl

    mpl.use("Agg")
    from importlib import import_module

    drawn = []
    for row in FIGURES:
        make: Maker = getattr(import_module(f"{__name__}.{row.module}"), row.make)
        for plant in plants if row.each_plant else plants[:1]:
            canvas = make(Source(results, plant, seed))
            if canvas is None:
                continue
            behind = "" if plant == plants[0] else f"-{plant}"
            file = f"{row.file}{behind}.png"
            _save(canvas, folder / file)
            title = row.title if not behind else f"{row.title} ({plant} plant)"
            drawn.append(Figure(file, title, row.caption))
    return drawn


def _save(canvas: Canvas, path: Path) -> None:
    import matplotlib.pyplot as plt

    from flightstack.types import InputError

    try:
        canvas.savefig(path, dpi=110, metadata={"Software": None})
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; choose another folder with --out") from None
    plt.close(canvas)
