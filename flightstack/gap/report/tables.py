"""The page's parts that are not charts over time: effects, where, regimes, identifiability, data quality."""

from __future__ import annotations

import math
from html import escape

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap.records import SIGNALS, ChannelResidual, Estimate, IdentifiedEffect, Offset
from flightstack.gap.report import words
from flightstack.gap.report.record import GapReport, LogQuality, RegimeRow

MISSING = '<p class="missing">nothing</p>'
_SHORT = ("force x", "force y", "force z", "turn x", "turn y", "turn z")
LEVELS = {"shown": "shown", "weak": "weak", "hidden": "hidden"}


def effects(report: GapReport) -> str:
    """Each named effect: its parameters with intervals, the evidence, what it can't be told from."""
    parts = [_effect(found) for found in report.found]
    rest = report.unexplained
    if rest.significant:
        depends = " and ".join(rest.depends_on) or "nothing that was looked at"
        depends += f" ({rest.shown})" if rest.shown else ""
        parts.append(
            '<div class="effect"><h3>Something that no effect of the table explains</h3>'
            f'<p class="twin"><b>{words.left_over(rest, report.gap)}</b>; it depends on {escape(depends)}. '
            "Nothing was put into the model for it.</p></div>"
        )
    if not parts:
        part = words.compared(report.gap, only=words.compared_only(report))
        where = f" in {part}, all that was compared" if part else ""
        untold = f"; {escape(report.untold)}" if report.untold else ""
        return f'<p class="missing">Nothing: model and measurement agree within the noise{where}{untold}.</p>'
    if report.takes:
        parts.append(f'<p class="note">The companion takes {escape(", ".join(report.takes))} into its model.</p>')
    if report.learner:
        names = ", ".join(words.effect(name) for name in report.learner)
        no_term = f"The companion's model has no term for {escape(names)}"
        parts.append(f'<p class="note">{no_term}: in flight its learner takes that.</p>')
    return "".join(parts)


def _effect(found: IdentifiedEffect) -> str:
    rows = "".join(_parameter(found, name, value) for name, value in found.parameters.items())
    twin = ""
    if found.indistinguishable_from:
        names = ", ".join(words.effect(name) for name in found.indistinguishable_from)
        fly = f" To tell them apart: {found.manoeuvre}." if found.manoeuvre else ""
        twin = f'<p class="twin"><b>Can\'t be told from {escape(names)} in these logs.</b>{escape(fly)}</p>'
    name = words.effect(found.name)
    chance = "below 1e-99" if found.p_value < 1e-99 else f"{found.p_value:.2g}"
    return (
        f'<div class="effect" data-effect="{escape(found.name)}"><h3>{escape(name[0].upper() + name[1:])}</h3>'
        f'<table class="parameters">{rows}</table>{twin}'
        f'<p class="evidence">ΔBIC {words.number(found.delta_bic)}, {words.held_out(found)}, '
        f"by chance {chance}</p></div>"
    )


def _parameter(found: IdentifiedEffect, name: str, value: Estimate) -> str:
    spec = next((p for p in EFFECTS[found.name].params if p.name == name), None)
    unit = words.unit(spec.unit) if spec is not None else ""
    whole = spec is not None and spec.integer
    width = value.high - value.low
    shown = f"{value.estimate:.0f}" if whole else words.number(value.estimate, width)
    before = "not there" if not math.isfinite(value.before) else words.number(value.before)
    spread = "" if whole else escape(words.interval(value))
    return (
        f'<tr><td class="name">{escape(name)}</td><td class="value">{shown} {escape(unit)}</td>'
        f'<td class="spread">{spread}</td>'
        f'<td class="note">was {before}</td><td class="range">{"" if whole else _range_svg(value)}</td></tr>'
    )


def _range_svg(value: Estimate) -> str:
    """Interval and estimate in blue, the value before in red, on one axis."""
    points = [v for v in (value.before, value.low, value.high, value.estimate) if math.isfinite(v)]
    low, high = min(points), max(points)
    if high <= low:
        return ""

    def x(v: float) -> float:
        return 6.0 + 188.0 * (v - low) / (high - low)

    span = ""
    if math.isfinite(value.low) and math.isfinite(value.high):
        span = f'<line class="span" x1="{x(value.low):.1f}" x2="{x(value.high):.1f}" y1="8" y2="8"/>'
    was = f'<line class="was" x1="{x(value.before):.1f}" x2="{x(value.before):.1f}" y1="2" y2="14"/>'
    return (
        '<svg class="bar" viewBox="0 0 200 16" preserveAspectRatio="none">'
        '<line class="axis" x1="0" x2="200" y1="8" y2="8"/>'
        f'{span}<circle class="at" cx="{x(value.estimate):.1f}" cy="8" r="3.2"/>'
        f"{was if math.isfinite(value.before) else ''}</svg>"
    )


def where(rows: tuple[ChannelResidual, ...]) -> str:
    """Each channel's disagreement, its size over the noise, the regime and the quantity it goes with."""
    if not rows:
        return '<p class="missing">not in these logs</p>'
    most = max(row.rms / row.expected_noise if row.expected_noise > 0.0 else 1.0 for row in rows)
    out = []
    for row in rows:
        ratio = row.rms / row.expected_noise if row.expected_noise > 0.0 else math.nan
        share = 0.0 if not math.isfinite(ratio) else 100.0 * math.log1p(ratio) / math.log1p(most)
        out.append(
            f"<tr><td>{escape(row.signal.replace('_', ' '))}</td><td>{row.rms:.3g} {escape(words.unit(row.unit))}</td>"
            f"<td>{ratio:.1f} × noise</td>"
            f'<td class="share"><span class="meter"><i style="width:{share:.0f}%"></i></span></td>'
            f"<td>{escape(row.worst_regime.replace('_', ' '))}</td><td>{escape(row.correlates_with)}</td></tr>"
        )
    head = "<tr><th>signal</th><th>rms</th><th></th><th></th><th>worst in</th><th>goes with</th></tr>"
    return f'<table class="facts-wide"><thead>{head}</thead><tbody>{"".join(out)}</tbody></table>'


def regimes(rows: tuple[RegimeRow, ...], noise: np.ndarray | None) -> str:
    """Regime by channel: rms over the noise before and after, the darker the worse."""
    if not rows or noise is None:
        return '<p class="missing">not in these logs</p>'
    out = []
    for row in rows:
        cells = []
        for before, after, floor in zip(row.before.tolist(), row.after.tolist(), noise.tolist(), strict=True):
            if not (math.isfinite(before) and floor > 0.0):
                cells.append('<td class="none">–</td>')
                continue
            share = min(100.0, 45.0 * math.log10(max(before / floor, 1.0)))
            style = f"background:color-mix(in srgb, var(--before) {share:.0f}%, var(--grid))"
            style += ";color:var(--card)" if share > 55.0 else ""
            left = _times(after / floor) if math.isfinite(after) else "–"
            cells.append(f'<td style="{style}">{_times(before / floor)} → {left}</td>')
        name = escape(row.regime.replace("_", " "))
        out.append(f"<tr><th>{name} <span>{row.seconds:.0f} s</span></th>{''.join(cells)}</tr>")
    head = "".join(f"<th>{name}</th>" for name in _SHORT[: len(SIGNALS)])
    return f'<table class="heat"><thead><tr><th></th>{head}</tr></thead><tbody>{"".join(out)}</tbody></table>'


def _times(ratio: float) -> str:
    return f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.1f}"


def shown(report: GapReport) -> str:
    """The identifiability map."""
    if not report.shown:
        return '<p class="missing">not looked at</p>'
    rows = "".join(
        f'<tr><td>{escape(words.effect(row.effect))}</td><td><span class="level {escape(row.level)}">'
        f"{escape(LEVELS.get(row.level, row.level))}</span></td><td>{escape(row.words)}</td>"
        f"<td>{escape(row.manoeuvre)}</td></tr>"
        for row in report.shown
    )
    head = "<tr><th>effect</th><th></th><th>in these logs</th><th>to see it, fly</th></tr>"
    return f'<table class="plain"><thead>{head}</thead><tbody>{rows}</tbody></table>'


def rejected(report: GapReport) -> str:
    """Candidates that were not named."""
    if not report.rejected:
        return MISSING
    rows = "".join(
        f"<tr><td>{escape(words.effect(row.name))}</td><td>{row.delta_bic:+.1f}</td><td>{escape(row.reason)}</td></tr>"
        for row in report.rejected
    ).replace("-", "−")
    head = "<tr><th>effect</th><th>ΔBIC</th><th>why not</th></tr>"
    return f'<table class="plain"><thead>{head}</thead><tbody>{rows}</tbody></table>'


def checks(report: GapReport) -> str:
    """What else was verified, flight by flight where there are several."""
    if not report.checks:
        return _across(report) or MISSING
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in report.checks)
    return f'<table class="facts">{rows}</table>' + _across(report)


def _across(report: GapReport) -> str:
    """What each of several flights says alone."""
    rows = "".join(
        f"<tr><td>{escape(words.effect(row.effect))} {escape(row.parameter)}</td><td>{escape(log)}</td>"
        f"<td>{words.number(e.estimate, e.high - e.low)} ({words.interval(e)})</td>"
        f"<td>{'the same' if row.same else 'differs: taken back'}</td></tr>"
        for row in report.across
        for log, e in row.flights
    )
    head = "<tr><th>effect</th><th>log</th><th>alone</th><th></th></tr>"
    table = f'<table class="plain"><thead>{head}</thead><tbody>{rows}</tbody></table>'
    return f"<h3>The same in each flight?</h3>{table}" if rows else ""


def quality(logs: tuple[LogQuality, ...]) -> str:
    """Each log: findings, offsets, what was done to read it."""
    return "".join(_log(log) for log in logs) or MISSING


def _log(log: LogQuality) -> str:
    findings = "".join(
        f'<p class="finding"><span class="level {escape(f.level)}">{escape(f.level)}</span> '
        f"<b>{escape(f.name)}</b> {escape(f.text)}</p>"
        for f in log.findings
    )
    offsets = "".join(f'<p class="finding">{escape(_offset(offset))}</p>' for offset in log.offsets)
    notes = "".join(f'<p class="finding note">{escape(note)}</p>' for note in log.notes)
    return f'<h3>{escape(log.name)} <span class="note">{escape(log.kind)}, {log.seconds:.1f} s used</span></h3>' + (
        findings + offsets + notes
    )


def _offset(offset: Offset) -> str:
    name = offset.signal.replace("_", " ")
    if not math.isfinite(offset.offset_s):
        return f"stamps of {name}: no offset can be told"
    low, high = 1e3 * offset.low_s, 1e3 * offset.high_s
    reach = f"{low:+.1f} to {high:+.1f}" if math.isfinite(high - low) else "interval unknown"
    text = f"stamps of {name} are {1e3 * offset.offset_s:+.1f} ms late ({reach})"
    return text.replace("-", "−")
