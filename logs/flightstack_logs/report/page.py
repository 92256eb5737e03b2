"""A flight as one HTML file: no network, no clock, the same bytes for the same flight."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from importlib import resources
from pathlib import Path

from flightstack_logs.report import barrier, learning, recorded, words
from flightstack_logs.report.charts import PATH_POINTS, panels, path_payload
from flightstack_logs.report.flight import FlightReport
from flightstack_logs.report.histogram import lateness_svg
from flightstack_logs.report.panel import POINTS, Panel

EVENTS_SHOWN = 500
EVENTS_OPEN = 40
"""Rows of the tables of events and settings before the rest is folded away."""
_MISSING = '<p class="missing">not recorded</p>'
_ROLE_WORDS = {"command": "reference", "measured": "estimate", "truth": "truth"}


def write_report(flight: FlightReport, path: Path | str) -> Path:
    """Write the report of `flight` to `path` (its folder must exist) and return the path."""
    path = Path(path)
    path.write_text(render_report(flight), encoding="utf-8")
    return path


def render_report(flight: FlightReport) -> str:
    """The whole page: headline, key figures, path in space, signals over time, events, timing, settings."""
    flight = learning.with_measured_honesty(words.with_measured_figures(flight))
    drawn = panels(flight)
    error = drawn[0]
    figures, lacking = words.figures(flight), ""
    if flight.recorded is not None:
        drawn = (*drawn, *recorded.panels(flight.recorded))
        figures, lacking = recorded.figures(flight, flight.recorded), recorded.missing(drawn)
        drawn = tuple(replace(panel, third=panel.third or panel.key == "motors") for panel in drawn if panel.curves)
    learned = learning.panels(flight, error)
    filtered = barrier.panels(flight)
    path = path_payload(flight)
    state, verdict = words.verdict(flight)
    data = {
        "phases": [[phase.name, phase.start_s, phase.end_s] for phase in flight.phases],
        "events": [[event.t_s, event.severity, event.text] for event in flight.events[:EVENTS_SHOWN]],
        "panels": [panel.payload() for panel in (*drawn, *learned, *filtered) if panel.curves],
        "path": path,
    }
    return fill(
        asset("page.html"),
        {
            "title": escape(f"{flight.outcome.scenario}: flight report"),
            "style": asset("vendor/uPlot.min.css") + asset("page.css"),
            "state": state,
            "verdict": verdict,
            "headline": escape(words.headline(flight)),
            "subtitle": _subtitle(flight, lacking),
            "figures": figures_html(figures),
            "checks": _checks(flight),
            "contents": _contents(bool(learned), bool(filtered)),
            "path": _path(flight, path),
            "phases": _phases(flight),
            "tracking": "".join(panel_html(panel) for panel in drawn if _is_beside(panel)),
            "learning": _learning(flight, learned),
            "barrier": _barrier(flight, filtered),
            "panels": "".join(panel_html(panel) for panel in drawn if not _is_beside(panel)),
            "events": _events(flight),
            "timing": _timing(flight),
            "settings": _settings(flight),
            "zero": "log" if flight.recorded is not None else "take-off",
            "display": _display(drawn),
            "data": safe_json(data),
            "library": asset("vendor/uPlot.iife.min.js"),
            "script": asset("charts.js") + asset("path3d.js"),
        },
    )


def safe_json(data: object) -> str:
    """JSON that cannot end the script element it stands in, whatever its strings hold."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"), sort_keys=True)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def asset(name: str) -> str:
    """Text of a file that belongs to the page."""
    return resources.files("flightstack_logs.report").joinpath(name).read_text(encoding="utf-8")


def fill(template: str, parts: dict[str, str]) -> str:
    """The template with its marks (`put NAME` in a comment) replaced."""
    # One pass: what is put in is never searched for marks again.
    return re.sub(r"<!--\s*put (\w+)\s*-->|/\* put (\w+) \*/", lambda m: parts[m.group(1) or m.group(2)], template)


def _is_beside(panel: Panel) -> bool:
    """Whether it stands beside the path."""
    return panel.key.startswith("error-") or panel.key in recorded.BESIDE


def _subtitle(flight: FlightReport, lacking: str) -> str:
    outcome = flight.outcome
    parts = [
        f"{name} {value}"
        for name, value in (("plant", outcome.plant), ("controller", outcome.controller), ("seed", outcome.seed))
        if value is not None
    ]
    if outcome.lockstep is not None:
        parts.append("lockstep" if outcome.lockstep else "real time")
    if lacking:
        parts.append(lacking)
    return escape(" · ".join(parts))


def _contents(learned: bool, filtered: bool) -> str:
    """Links to the page's parts."""
    parts = [("path", "Path"), ("signals", "Signals"), ("record", "Events, settings")]
    parts[1:1] = [("learning", "Learning")] * learned + [("barrier", "Barrier")] * filtered
    return "".join(f'<a href="#{place}">{words}</a>' for place, words in parts)


def _learning(flight: FlightReport, learned: tuple[Panel, ...]) -> str:
    if not learned:
        return ""
    figures = f'<dl class="figures">{figures_html(learning.figures(flight))}</dl>'
    grid = "".join(panel_html(panel) for panel in learned)
    return (
        f'<details class="part" id="learning" open><summary>Learning</summary>{figures}'
        f'<div class="grid">{grid}</div></details>'
    )


def _barrier(flight: FlightReport, filtered: tuple[Panel, ...]) -> str:
    if not filtered:
        return ""
    figures = f'<dl class="figures">{figures_html(barrier.figures(flight))}</dl>'
    grid = "".join(panel_html(panel) for panel in filtered)
    return (
        f'<details class="part" id="barrier" open><summary>Barrier</summary>{figures}<div class="grid">{grid}</div>'
        f"{barrier.planes_html(flight)}{barrier.tables_html(flight)}</details>"
    )


def figures_html(figures: Sequence[words.KeyFigure]) -> str:
    """Key figures as items of a description list."""
    return "".join(
        f'<div class="figure {figure.state}"><dt>{escape(figure.label)}</dt><dd>{escape(figure.value)}</dd>'
        f"<p>{escape(figure.note)}</p></div>"
        for figure in figures
    )


def _checks(flight: FlightReport) -> str:
    rows = "".join(
        f'<li class="{"good" if check.passed else "bad"}">{escape(check.words)}'
        f"{'' if check.value is None else f': measured {check.value:.4g}'}</li>"
        for check in flight.outcome.checks
    )
    return f'<ul class="checks">{rows}</ul>' if rows else ""


def panel_html(panel: Panel) -> str:
    """A chart over time as a section; the script draws it from the page's data."""
    note = f' <span class="note">{escape(panel.note)}</span>' if panel.note else ""
    body = f'<div class="chart" data-panel="{panel.key}"></div>' if panel.curves else _MISSING
    return (
        f'<section class="panel{" third" if panel.third else ""}" id="{panel.key}"><h2>{escape(panel.title)} '
        f'<span class="unit">{escape(panel.unit)}</span>{note}</h2>{body}</section>'
    )


def _path(flight: FlightReport, path: dict[str, object] | None) -> str:
    if path is None:
        return _MISSING
    tracks = path["tracks"]
    assert isinstance(tracks, list)
    keys = "".join(f'<span class="key {t["role"]}"><i></i>{_ROLE_WORDS[t["role"]]}</span>' for t in tracks)
    if flight.region is not None:
        keys += f'<span class="key region"><i></i>safe region ({escape(flight.region.shape)})</span>'
    buttons = "".join(
        f'<button type="button" data-view="{view}">{label}</button>'
        for view, label in (("default", "Reset"), ("top", "Top"), ("south", "From south"), ("west", "From west"))
    )
    missing = (
        ""
        if flight.truth_ned_m is not None or flight.recorded is not None
        else '<p class="note">truth: not recorded</p>'
    )
    return (
        f'<div class="keys">{keys}<span class="buttons">{buttons}</span></div>{missing}'
        '<div class="view"><canvas id="path3d" tabindex="0" role="img" '
        'aria-label="Path in space: north, east and up in metres"></canvas></div>'
        '<p class="hint">Drag to turn, wheel to zoom, double-click to reset. Grey: shadow on the ground.</p>'
    )


def _phases(flight: FlightReport) -> str:
    if not flight.phases and flight.recorded is not None:
        return ""
    if not flight.phases:
        return '<span class="note">phases: not recorded</span>'
    return "".join(
        f'<button type="button" class="phase" data-phase="{escape(phase.name)}" data-start="{phase.start_s:.3f}" '
        f'data-end="{phase.end_s:.3f}" title="Show this phase only"><i></i>{escape(phase.name)} '
        f"{phase.start_s:.1f}–{phase.end_s:.1f} s</button>"
        for phase in flight.phases
    )


def _signed(value: float) -> str:
    return f"{value:.2f}".replace("-", "−")


def _events(flight: FlightReport) -> str:
    if not flight.events:
        return _MISSING
    rows = [
        f'<tr class="{escape(event.severity)}" data-time="{event.t_s:.3f}"><td>{_signed(event.t_s)} s</td>'
        f"<td>{escape(event.kind)}</td><td>{escape(event.text)}</td></tr>"
        for event in flight.events[:EVENTS_SHOWN]
    ]
    rest = len(flight.events) - EVENTS_SHOWN
    more = f'<p class="note">{rest} more are in the log.</p>' if rest > 0 else ""
    head = "<thead><tr><th>Time</th><th>Kind</th><th>What happened</th></tr></thead>"
    first, later = "".join(rows[:EVENTS_OPEN]), "".join(rows[EVENTS_OPEN:])
    table = f'<table class="events">{head}<tbody>{{}}</tbody></table>'
    folded = f"<details><summary>{len(rows) - EVENTS_OPEN} more</summary>{table.format(later)}</details>"
    return f"{table.format(first)}{folded if later else ''}{more}"


def _timing(flight: FlightReport) -> str:
    if flight.recorded is not None and flight.timing is None:
        return ""
    body = _timing_facts(flight)
    return f'<section class="panel" id="timing"><h2>Timing of the control loop</h2>{body}</section>'


def _timing_facts(flight: FlightReport) -> str:
    timing = flight.timing
    if timing is None:
        if flight.outcome.lockstep:
            return '<p class="missing">Lockstep: the simulator\'s clock was the clock, so no tick was ever late.</p>'
        return _MISSING
    facts = (
        ("Late, p50", words.microseconds(timing.p50_us)),
        ("Late, p99", words.microseconds(timing.p99_us)),
        ("Late, at most", words.microseconds(timing.max_us)),
        ("Deadlines missed", "–" if timing.missed is None else str(timing.missed)),
        ("Loop rate", "–" if timing.rate_hz is None else f"{timing.rate_hz:g} Hz"),
    )
    rows = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in facts)
    period = None if not timing.rate_hz else 1e6 / timing.rate_hz
    image = "" if timing.lateness_us is None else lateness_svg(timing.lateness_us, period)
    return f'{image}<table class="facts">{rows}</table>'


def _settings(flight: FlightReport) -> str:
    if not flight.settings:
        return _MISSING
    rows = [f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in flight.settings]
    table = f'<table class="facts">{"".join(rows[:EVENTS_OPEN])}</table>'
    if len(rows) <= EVENTS_OPEN:
        return table
    more = f'<table class="facts">{"".join(rows[EVENTS_OPEN:])}</table>'
    return f"{table}<details><summary>{len(rows) - EVENTS_OPEN} more</summary>{more}</details>"


def _display(drawn: tuple[Panel, ...]) -> str:
    most = max((panel.recorded for panel in drawn), default=0)
    if most <= POINTS:
        return "Charts show every recorded sample. "
    return (
        f"Charts show {POINTS} of up to {most} samples a curve: the least and the greatest of every interval, so that "
        f"no peak is lost; the path in space shows {PATH_POINTS} points. The log has every sample. "
    )
