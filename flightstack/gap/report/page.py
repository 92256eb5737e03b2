"""The page of a gap analysis: one self-contained HTML file, the same bytes for the same result."""

from __future__ import annotations

from html import escape
from importlib import resources
from pathlib import Path

import numpy as np

from flightstack.gap.decisions import MOSTLY
from flightstack.gap.records import SIGNALS
from flightstack.gap.report import tables, words
from flightstack.gap.report.record import GapReport, Trace
from flightstack.gap.report.waterfall import waterfall_svg
from flightstack.types import F64
from flightstack_logs.report.flight import ReportSamples
from flightstack_logs.report.page import asset, figures_html, fill, panel_html, safe_json
from flightstack_logs.report.panel import Curve, Panel, PanelLine, Span
from flightstack_logs.report.words import KeyFigure

_UNITS = ("m/s²", "m/s²", "m/s²", "rad/s²", "rad/s²", "rad/s²")
POINTS = 2500
"""Display points of a curve over time."""


def write_report(report: GapReport, path: Path) -> Path:
    """Write the page to `path`, whole or not at all, and return the path."""
    part = path.with_name(path.name + ".part")
    part.write_text(render_report(report), encoding="utf-8")
    part.replace(path)
    return path


def render_report(report: GapReport) -> str:
    """The whole page."""
    only = words.compared_only(report)
    state, verdict = words.verdict(report.found, report.gap, report.unexplained, only=only, untold=report.untold)
    drawn = panels(report.traces)
    data = {"phases": [], "events": [], "panels": [panel.payload() for panel in drawn], "path": None}
    own = resources.files("flightstack.gap.report")
    template = own.joinpath("page.html").read_text(encoding="utf-8")
    style = asset("vendor/uPlot.min.css") + asset("page.css") + own.joinpath("page.css").read_text(encoding="utf-8")
    noise = report.traces[0].noise if report.traces else None
    return fill(
        template,
        {
            "title": escape(f"{report.vehicle}: simulation against measurement"),
            "style": style,
            "state": state,
            "verdict": verdict,
            "headline": escape(words.headline(report)),
            "subtitle": escape(f"{report.vehicle} · {', '.join(log.name for log in report.logs)}"),
            "figures": figures_html(_figures(report)),
            "effects": tables.effects(report),
            "waterfall": _waterfall(report),
            "where": tables.where(report.where),
            "regimes": tables.regimes(report.regimes, noise),
            "trace": escape(_trace_words(report.traces)),
            "panels": "".join(panel_html(panel) for panel in drawn) or '<p class="missing">not in these logs</p>',
            "shown": tables.shown(report),
            "rejected": tables.rejected(report),
            "checks": tables.checks(report),
            "quality": tables.quality(report.logs),
            "data": safe_json(data),
            "library": asset("vendor/uPlot.iife.min.js"),
            "script": asset("charts.js"),
        },
    )


def _figures(report: GapReport) -> tuple[KeyFigure, ...]:
    gap = report.gap
    closed = "–" if gap.closed is None else words.percent(gap.closed)
    none = "no gap there" if words.is_elsewhere(gap, report.unexplained) else "no gap to close"
    why = "of the gap over the noise" if gap.closed is not None else none
    state = "plain" if gap.closed is None else "good" if gap.closed >= MOSTLY else "bad"

    def figure(label: str, name: str, unit: str, note: str = "") -> KeyFigure:
        before, after = getattr(gap.before, name), getattr(gap.after, name)
        floor = getattr(gap.noise_floor, name)
        value = "–" if before is None else f"{before:.2g} → {'–' if after is None else f'{after:.2g}'} {unit}"
        return KeyFigure(label, value, note or ("" if floor is None else f"noise {floor:.2g} {unit}"))

    return (
        KeyFigure("Closed, held out", closed, why, state),
        figure("Force, one step", "one_step_mps2", "m/s²"),
        figure("Turning, one step", "one_step_radps2", "rad/s²"),
        figure("Path after 1 s alone", "rollout_1s_m", "m", words.ratio(gap.before, gap.after)),
        KeyFigure("Effects named", str(len(report.found)), "of 26 looked at"),
        KeyFigure("Left over", _share_left(report), _left(report)),
    )


def _share_left(report: GapReport) -> str:
    rest = report.unexplained
    return "something" if rest.significant and report.gap.closed is None else words.percent(rest.fraction)


def _left(report: GapReport) -> str:
    rest = report.unexplained
    if not rest.significant:
        return "but for a level force that is not told" if report.untold else "nothing significant"
    if words.is_elsewhere(report.gap, rest) and not report.found:
        return "in the part that was learned from"
    return f"depends on {', '.join(rest.depends_on)}" if rest.depends_on else "on nothing that these logs show"


def _waterfall(report: GapReport) -> str:
    floor = report.gap.noise_floor
    drawn = [
        waterfall_svg(report.steps, floor.one_step_mps2, "one_step_mps2", "m/s²", "Specific force"),
        waterfall_svg(report.steps, floor.one_step_radps2, "one_step_radps2", "rad/s²", "Angular acceleration"),
        waterfall_svg(report.steps, floor.rollout_1s_m, "rollout_1s_m", "m", "Path after 1 s simulated alone"),
    ]
    return "".join(drawn) or '<p class="missing">not in these logs</p>'


def _trace_words(traces: tuple[Trace, ...]) -> str:
    if not traces:
        return ""
    more = f" (1 of {len(traces)} logs)" if len(traces) > 1 else ""
    return f"{traces[0].name}{more}: measured, and simulated at the measured states before and after"


def panels(traces: tuple[Trace, ...]) -> tuple[Panel, ...]:
    """Measured and simulated of each channel that was measured, of the first trace."""
    if not traces:
        return ()
    trace = traces[0]
    drawn = []
    for column, signal in enumerate(SIGNALS):
        if not np.isfinite(trace.measured[:, column]).any():
            continue
        drawn.append(_panel(trace, column, signal))
    return tuple(drawn)


def _panel(trace: Trace, column: int, signal: str) -> Panel:
    def curve(label: str, role: str, values: F64, *, wide: bool = False) -> Curve:
        return Curve(label, role, ReportSamples(trace.t_s, values[:, column : column + 1]), wide=wide)

    before, after = (_rms(trace.measured[:, column] - x[:, column]) for x in (trace.before, trace.after))
    unit = _UNITS[column]
    quantity, _, axis = signal.rpartition("_")
    spans = [Span(start, end, "held out", "stage-used") for start, end in trace.held_out_s]
    finite = [x[np.isfinite(x[:, column]), column] for x in (trace.measured, trace.before, trace.after)]
    reached = [np.percentile(x, (0.05, 99.95)) for x in finite if len(x)]  # each for itself: all are to be seen
    low, high = float(np.min(reached)), float(np.max(reached))
    room = 0.15 * (high - low) or 1.0
    return Panel(
        f"trace-{signal.replace('_', '-')}",
        f"{quantity.replace('_', ' ').capitalize()} {axis}",
        unit,
        2,
        (
            curve("measured", "measured", trace.measured, wide=True),
            curve("simulated before", "before", trace.before),
            curve("simulated after", "after", trace.after),
        ),
        lines=() if column != 2 else (PanelLine(-9.80665, "hover", "muted"),),
        note=f"off by {before:.2g} → {after:.2g} {unit} rms, noise {trace.noise[column]:.2g}",
        points=POINTS,
        strip=tuple(spans),
        cut=(low - room, high + room),
    )


def _rms(values: F64) -> float:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good**2))) if len(good) else 0.0
