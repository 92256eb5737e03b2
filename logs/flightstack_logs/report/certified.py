"""The page of an exploration: initial and final regions, the flown path inside, the cover, growth, and the margins."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

import numpy as np

from flightstack.barrier.records import AXES, AxisCertificate, Certificate
from flightstack.barrier.shapes import Barrier
from flightstack.explore import Round
from flightstack.types import F64
from flightstack_logs.report.page import figures_html
from flightstack_logs.report.phase_plane import boundary
from flightstack_logs.report.plot import Plot, padded
from flightstack_logs.report.still import still_page
from flightstack_logs.report.words import KeyFigure

_PATH_POINTS = 4000
_CELLS_SHOWN = 6000
_ORDER = (2, 0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class ExplorationPage:
    """What the page shows."""

    title: str
    good: bool
    words: str
    """How it ended, one line."""
    figures: tuple[KeyFigure, ...]
    """Label, value, note."""
    certificates: tuple[Certificate, ...]
    """In their order, the last one in force."""
    rounds: tuple[Round, ...]
    path: F64
    """(n, 6) flown position relative to the region's centre and velocity, NED."""
    kernel: tuple[float, float, float] | None
    """Of the vertical axis' viability kernel: limit (m), least and greatest acceleration (m/s^2)."""
    checker: tuple[str, ...]
    """The independent checker's lines."""
    settled: tuple[float, float] | None = None
    """Area (m^2/s) and largest bound (m/s^2) of the certificate that all data gave after landing; None without one."""


def render(exploration: ExplorationPage) -> str:
    """One self-contained HTML page."""
    last = exploration.certificates[-1]
    axes = sorted(last.axes, key=lambda axis: _ORDER.index(axis.axis))
    parts = [
        f'<section class="panel"><h2>{escape(name)}</h2>{body}</section>'
        for axis in axes
        for name, body in (
            (f"Regions and path, {AXES[axis.axis]}", _regions(exploration, axis)),
            (f"Cover of the final region, {AXES[axis.axis]}: {len(axis.cells)} cells", _cover(axis)),
        )
    ]
    area, width = exploration.settled or (None, None)
    parts.append(f'<section class="panel"><h2>Growth</h2>{_growth(exploration, area)}</section>')
    parts.append(f'<section class="panel"><h2>Bound over the region</h2>{_widths(exploration, width)}</section>')
    ledgers = "".join(_ledger(axis) for axis in axes)
    checker = "".join(f"<li>{escape(line)}</li>" for line in exploration.checker)
    rounds = "".join(_round(k, row) for k, row in enumerate(exploration.rounds, 1))
    state, verdict = ("good", "certified") if exploration.good else ("bad", "not certified")
    return still_page(
        exploration.title,
        [exploration.words],
        f'<dl class="figures">{figures_html(exploration.figures)}</dl><main>'
        f'<div class="grid">{"".join(parts)}</div><div class="tables">'
        f'<section class="panel wide"><h2>Margins <span class="unit">m/s²</span></h2>{ledgers}</section>'
        '<section class="panel wide"><details><summary>Each round</summary>'
        f'<table class="rounds">{_ROUNDS_HEAD}{rounds}</table></details>'
        f"<h2>The independent checker</h2><ul>{checker}</ul></section></div></main>",
        state=state,
        verdict=verdict,
        footer="e: distance from the region's centre, v: its rate; north-east-down, so down is positive.",
        css=("flightstack_logs.report", "certified.css"),
    )


_ROUNDS_HEAD = "".join(
    f"<th>{words}</th>" for words in ("Round", "Axis", "Time", "Certificate", "Area", "Bound", "Flown through")
)


def kernel_outline(limit_m: float, u_low_mps2: float, u_high_mps2: float) -> F64:
    """(n, 2) the viability kernel of |e| <= limit: its parabolas."""
    e = np.linspace(-limit_m, limit_m, 121)
    fast = np.sqrt(np.maximum(-2.0 * u_low_mps2 * (limit_m - e), 0.0))
    slow = -np.sqrt(np.maximum(2.0 * u_high_mps2 * (e + limit_m), 0.0))
    return np.concatenate([np.stack([e, fast], axis=1), np.stack([e, slow], axis=1)[::-1]])


def _axis(certificate: Certificate, number: int) -> AxisCertificate | None:
    return next((axis for axis in certificate.axes if axis.axis == number), None)


def _regions(exploration: ExplorationPage, last: AxisCertificate) -> str:
    number = last.axis
    shapes = [axis.barrier for each in exploration.certificates if (axis := _axis(each, number)) is not None]
    lines = [boundary(shape) for shape in _thinned(shapes)]
    kernel = None if exploration.kernel is None or number != 2 else kernel_outline(*exploration.kernel)
    path = exploration.path[:: max(1, len(exploration.path) // _PATH_POINTS)][:, [number, 3 + number]]
    every = np.concatenate([*lines, path, *([] if kernel is None else [kernel])])
    plot = Plot(
        padded(every[:, 0]), padded(every[:, 1]), ("e (m)", "v (m/s)"),
        f"Regions of {AXES[number]} and the flown path",
    )  # fmt: skip
    plot.line(path, "flown")
    for line in lines[1:-1]:
        plot.line(line, "between", closed=True)
    if kernel is not None:
        plot.line(kernel, "kernel", closed=True)
    plot.line(lines[0], "first", closed=True)
    plot.line(lines[-1], "last", closed=True)
    targets = [row.target for row in exploration.rounds if row.axis == number and row.target is not None]
    plot.marks(np.array(targets).reshape(-1, 2), "target", [f"target {k}" for k in range(1, len(targets) + 1)])
    names = [("first", "first region"), ("between", "in between"), ("last", "final region"), ("flown", "flown (truth)")]
    names += [("target", "target")] * bool(targets) + [("kernel", "viability kernel")] * (kernel is not None)
    keys = "".join(f'<span class="key {role}"><i></i>{words}</span>' for role, words in names)
    return f'<div class="keys">{keys}</div>{plot.svg()}'


def _thinned(shapes: list[Barrier], most: int = 24) -> list[Barrier]:
    """First and last, and evenly what lies between."""
    if len(shapes) <= most:
        return shapes
    return [shapes[round(k)] for k in np.linspace(0, len(shapes) - 1, most)]


def _cover(axis: AxisCertificate) -> str:
    cells = axis.cells
    if len(cells) == 0:
        return '<p class="missing">No cells: nothing covers this region.</p>'
    shown = cells[:: max(1, len(cells) // _CELLS_SHOWN)]
    line = boundary(axis.barrier)
    every = np.concatenate([line, cells[:, [0, 2]], cells[:, [1, 3]]])
    plot = Plot(padded(every[:, 0]), padded(every[:, 1]), ("e (m)", "v (m/s)"), f"Cells of {AXES[axis.axis]}")
    margin = shown[:, -1]
    share = 0.15 + 0.75 * np.clip(margin / max(float(margin.max()), 1e-9), 0.0, 1.0)
    plot.boxes(shown[:, :4], share, "cell")
    plot.line(line, "last", closed=True)
    least = f"least margin {float(cells[:, -1].min()):.3g} 1/s"
    return f'{plot.svg()}<p class="hint">Darker: more margin, up to {float(margin.max()):.2f} 1/s; {least}.</p>'


def _growth(exploration: ExplorationPage, settled: float | None) -> str:
    return _steps(exploration, "area_m2ps", "certified area (m²/s)", settled)


def _widths(exploration: ExplorationPage, settled: float | None) -> str:
    return _steps(exploration, "width_mps2", "largest bound (m/s²)", settled)


def _steps(exploration: ExplorationPage, name: str, label: str, settled: float | None) -> str:
    """A mark a round, and one more for what the whole flight's data gave after landing."""
    rows = [(row.t_s, float(getattr(row, name))) for row in exploration.rounds if row.axis == _first_axis(exploration)]
    if not rows:
        return '<p class="missing">no round was flown</p>'
    names, hint = [f"round {k}: {v:.3f}" for k, (_, v) in enumerate(rows, 1)], ""
    if settled is not None:
        rows.append((rows[-1][0] + max(rows[-1][0] - rows[0][0], 10.0) / 20.0, settled))
        names.append(f"after landing: {settled:.3f}")
        hint = f'<p class="hint">The last mark: from all data of the flight, after landing ({settled:.3f}).</p>'
    points = np.array(rows)
    plot = Plot(padded(points[:, 0]), padded(np.append(points[:, 1], 0.0)), ("time (s)", label), label, height=260.0)
    plot.line(points, "steps")
    plot.marks(points, "target", names)
    return plot.svg() + hint


def _first_axis(exploration: ExplorationPage) -> int:
    return exploration.rounds[0].axis if exploration.rounds else 2


def _ledger(axis: AxisCertificate) -> str:
    lines = [(each.name.replace("_", " "), each.mps2, each.because) for each in axis.margins]
    lines.append(("together", sum(each.mps2 for each in axis.margins), ""))
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{mps2:.3f}</td><td>{escape(because)}</td></tr>"
        for name, mps2, because in lines
    )
    return f'<h3>{AXES[axis.axis]}</h3><table class="facts">{rows}</table>'


def _round(number: int, row: Round) -> str:
    target = "–" if row.target is None else f"e {row.target[0]:.2f} m, v {row.target[1]:.2f} m/s"
    return (
        f"<tr><td>{number}</td><td>{AXES[row.axis]}</td><td>{row.t_s:.1f} s</td><td>{row.version}</td>"
        f"<td>{row.area_m2ps:.3f}</td><td>{row.width_mps2:.3f}</td><td>{target}</td></tr>"
    )
