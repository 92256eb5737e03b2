"""The page's section on the barrier: h over time, the path among the regions, what was changed, and every margin."""

from __future__ import annotations

from dataclasses import replace
from html import escape

import numpy as np

from flightstack.barrier.records import AXES, MARGINS, AxisCertificate, Certificate
from flightstack.types import F64
from flightstack_logs.report import signals
from flightstack_logs.report.flight import Barrier, FilterOutcome, FlightReport, Outcome, ReportSamples
from flightstack_logs.report.histogram import histogram_svg
from flightstack_logs.report.panel import Curve, Mark, Panel, PanelLine, Span, known
from flightstack_logs.report.phase_plane import Outline, Plane, boundary, ellipse, parted, plane_svg
from flightstack_logs.report.words import KeyFigure, count, judged_span, microseconds, percent
from flightstack_logs.topics import FILTER_STATUS

POINTS = 2000
PATH_POINTS = 1500
CHANGES_SHOWN = 400
_ENGAGED, _FALLBACK = 2.0, 4.0
_STATUS_ROLES = ("stage-none", "stage-none", "stage-used", "stage-frozen", "hit", "hit", "hit")


def panels(flight: FlightReport) -> tuple[Panel, ...]:
    """The section's panels; none where nothing filtered."""
    barrier = flight.barrier
    if barrier is None:
        return ()
    marks = tuple(
        Mark(event.t_s, _mark(event.text))
        for event in flight.events
        if event.kind == "filter" and (event.severity == "warning" or "certificate" in event.text)
    )
    drawn = (
        replace(_h(flight, barrier), marks=marks),
        _margin(barrier),
        *(replace(_acceleration(barrier, axis), third=True) for axis in range(3)),
    )
    return tuple(replace(panel, points=POINTS) for panel in drawn)


def _mark(text: str) -> str:
    """`filter: fallback: infeasible (h ...)` -> infeasible; `filter: certificate 2: north ...` -> certificate 2."""
    words = text.partition("(")[0].removeprefix("filter: ").removeprefix("fallback: ")
    return words.partition(":")[0].strip()


def _h(flight: FlightReport, barrier: Barrier) -> Panel:
    if barrier.site:
        clear = known(("of the way out", "learned", barrier.h))
        return Panel(
            "barrier-h", "Clearance of the way out, with all of its tube", "m", 3, tuple(clear),
            (PanelLine(0.0, "forbidden"),), tuple(signals.intervals(barrier.intervened)), note=_note(barrier),
            strip=_strip(barrier.status), cut=(-1.0, 5.0),
        )  # fmt: skip
    curves = (
        *known(("of the measured state", "measured", barrier.h_state)),
        *known(("of the predicted state, as filtered", "learned", barrier.h)),
        *known((f"of the scenario's region, {_state_of(flight)}", "truth", region_h(barrier))),
    )
    return Panel(
        "barrier-h", "Barrier value h", "1 in the middle, 0 on the boundary", 3, curves, (PanelLine(0.0, "boundary"),),
        tuple(signals.intervals(barrier.intervened)), note=_note(barrier), strip=_strip(barrier.status),
        cut=_scale([curve.samples for curve in curves]),
    )  # fmt: skip


def _scale(shown: list[ReportSamples]) -> tuple[float, float]:
    """From somewhat below the boundary, or the least h while any was positive, to 1: on the ground h is far below."""
    least = -0.2
    for signal in shown:
        values = signal.values[:, 0]
        inside = np.flatnonzero(values >= 0.0)
        if len(inside):
            least = min(least, float(np.nanmin(values[inside[0] : inside[-1] + 1])))
    return max(least, -1.0), 1.05


def _note(barrier: Barrier) -> str:
    return "red bands: command changed" if (barrier.intervened.values > 0.5).any() else "no command was changed"


def _state_of(flight: FlightReport) -> str:
    return "truth" if flight.truth_ned_m is not None else "estimate"


def region_h(barrier: Barrier) -> ReportSamples | None:
    """(n, 1) h of the scenario's region at the state, thinned for display."""
    if barrier.region is None or barrier.state is None:
        return None
    shown = signals.thin(barrier.state, 2 * POINTS)
    return ReportSamples(shown.t_s, barrier.region.values(shown.values[:, :3], shown.values[:, 3:])[:, None])


def _strip(status: ReportSamples) -> tuple[Span, ...]:
    """What the filter did when: passing and changing are one, and what is too short to be seen is as the one before."""
    values = np.where(status.values[:, 0] == 3.0, _ENGAGED, status.values[:, 0])
    least_s = (float(status.t_s[-1]) - float(status.t_s[0])) / 500.0
    spans: list[Span] = []
    starts = np.flatnonzero(np.diff(values, prepend=np.nan))
    for start, end in zip(starts, [*starts[1:], len(values) - 1], strict=True):
        kind, from_s, to_s = int(values[start]), float(status.t_s[start]), float(status.t_s[end])
        word, role = "engaged" if kind == _ENGAGED else FILTER_STATUS[kind], _STATUS_ROLES[kind]
        if spans and (spans[-1].label == word or (to_s - from_s < least_s and kind < _FALLBACK)):
            spans[-1] = replace(spans[-1], end_s=to_s)
        else:
            spans.append(Span(from_s, to_s, word, role))
    return tuple(spans)


def _margin(barrier: Barrier) -> Panel:
    margins = barrier.margins_ned_ps
    names = [] if margins is None else [axis for axis in range(3) if np.isfinite(margins.values[:, axis]).any()]
    roles = ("one", "two", "three")
    curves = tuple(Curve(AXES[axis], roles[axis], signals.column(margins, axis)) for axis in names if margins)
    return Panel(
        "barrier-margin", "Margin of the best command", "1/s", 2, curves, (PanelLine(0.0, "infeasible below"),)
    )


def _acceleration(barrier: Barrier, axis: int) -> Panel:
    """What was wanted, what was sent, and what the barriers allowed."""
    low, high = (signals.column(part, axis) for part in (barrier.low_ned_mps2, barrier.high_ned_mps2))
    band: tuple[Curve, ...] = ()
    if low is not None and high is not None and np.isfinite(low.values).any() and np.isfinite(high.values).any():
        band = (Curve("allowed", "region", high, edge="upper"), Curve("allowed", "region", low, edge="lower"))
    wanted, sent = (signals.column(part, axis) for part in (barrier.wanted_acc_ned_mps2, barrier.safe_acc_ned_mps2))
    curves = (
        *band,
        *(() if wanted is None else (Curve("wanted", "measured", wanted, wide=True),)),
        *known(("sent", "two", sent)),
    )
    name = AXES[axis]
    finite = tuple(curve for curve in curves if np.isfinite(curve.samples.values).any())
    return Panel(f"barrier-{name}", f"Acceleration {name}", "m/s²", 2, finite, scale=_band_scale(finite))


def _band_scale(curves: tuple[Curve, ...]) -> tuple[float, ...]:
    """Values that show the band's edges where they lie within 2.5 times what was wanted or sent."""
    edges = [c.samples.values for c in curves if c.edge]
    inner = [c.samples.values for c in curves if not c.edge]
    if not edges or not inner:
        return ()
    most = 2.5 * max(float(np.nanmax(np.abs(values))) for values in inner)
    return float(np.clip(np.nanmax(edges[0]), -most, most)), float(np.clip(np.nanmin(edges[1]), -most, most))


_PLANES = ("Position and velocity, each axis", "The site, from above")


def planes(flight: FlightReport) -> tuple[Plane, ...]:
    """The path in each axis' plane, with the scenario's region and the certified ones."""
    barrier = flight.barrier
    if barrier is None or barrier.state is None:
        return ()
    takeoff, end = flight.phase("takeoff"), judged_span(flight)[1]
    start = takeoff.start_s if takeoff is not None else float(barrier.state.t_s[0])
    state = barrier.state
    flown = (state.t_s >= start) & (state.t_s <= end)
    if not flown.any():
        return ()
    state = ReportSamples(state.t_s[flown], state.values[flown])
    shown = signals.thin(state, PATH_POINTS)
    engaged = _held(barrier.status, shown.t_s) >= _ENGAGED
    changes = _changes(barrier, state)
    if barrier.site:
        return (_map(barrier, shown, engaged, changes),)
    return tuple(
        Plane(
            AXES[axis],
            parted(shown.values[:, [axis, axis + 3]], ~engaged),
            parted(shown.values[:, [axis, axis + 3]], engaged),
            changes[:, [axis, axis + 3]],
            _outlines(barrier, axis),
        )
        for axis in range(3)
    )


def _map(barrier: Barrier, shown: ReportSamples, engaged: np.ndarray, changes: F64) -> Plane:
    """The path in the site, from above; engaged (n,): whether the filter was."""
    above = [1, 0]
    outlines = tuple(Outline("region" if i == 0 else "before", line[:, above]) for i, line in enumerate(barrier.site))
    path = shown.values[:, above]
    return Plane("site", parted(path, ~engaged), parted(path, engaged), changes[:, above], outlines, is_map=True)


def _held(signal: ReportSamples, t_s: F64) -> F64:
    """(m,) the last value at each time; that of the first sample before it."""
    at = np.clip(np.searchsorted(signal.t_s, t_s, side="right") - 1, 0, len(signal.t_s) - 1)
    return np.asarray(signal.values[at, 0])


def _changes(barrier: Barrier, state: ReportSamples) -> F64:
    """(m, 6) states at which the command was changed, at most CHANGES_SHOWN of them."""
    changed = np.flatnonzero(_held(barrier.intervened, state.t_s) > 0.5)
    if len(changed) > CHANGES_SHOWN:
        changed = changed[np.linspace(0, len(changed) - 1, CHANGES_SHOWN).astype(np.intp)]
    return state.values[changed]


def _outlines(barrier: Barrier, axis: int) -> tuple[Outline, ...]:
    found = []
    roles = ("certified",) if len(barrier.certificates) == 1 else ("before", "certified")
    for role, certificate in zip(roles, barrier.certificates, strict=False):
        of = next((part for part in certificate.axes if part.axis == axis), None)
        if of is not None:
            found.append(Outline(role, boundary(of.barrier, certificate.centre_ned_m[axis])))
    region = barrier.region
    if region is not None:
        line = ellipse(region.centre_ned_m[axis], region.semi_axes_m[axis], region.semi_axes_mps[axis])
        found.append(Outline("region", line))
    return tuple(found)


def figures(flight: FlightReport) -> tuple[KeyFigure, ...]:
    """The section's key figures; only what is known."""
    outcome, filtered = flight.outcome, flight.outcome.filter
    violations = outcome.barrier_violations
    stated = [
        KeyFigure("Least h, truth", _h_words(filtered.min_h_truth), _outside(violations), _kept(outcome)),
        KeyFigure("Least h, estimate", _h_words(filtered.min_h_estimate)),
        _engaged(filtered),
        KeyFigure("Interventions", count(outcome.barrier_interventions), "ticks with a changed command"),
        KeyFigure("Infeasible", count(filtered.infeasible), "ticks without a solution", _state(filtered.infeasible)),
        KeyFigure("One step", microseconds(filtered.solve_p50_us), f"p99 {microseconds(filtered.solve_p99_us)}"),
    ]
    certificates = flight.barrier.certificates if flight.barrier is not None else ()
    if certificates:
        last = certificates[-1]
        sets = " · ".join(f"{AXES[axis.axis]} {axis.barrier.area_m2ps:.2f}" for axis in last.axes)
        stated.append(KeyFigure("Certified area", f"version {last.version}", f"{sets} m²/s"))
    return tuple(figure for figure in stated if figure.value != "–")


def _engaged(filtered: FilterOutcome) -> KeyFigure:
    if filtered.protected_from_s is None:
        return KeyFigure("Engaged", "–")
    share = filtered.engaged_share
    after = "" if share is None else f"; {percent(share)} of the ticks after the climb"
    return KeyFigure("Engaged", f"{filtered.protected_from_s:.1f} s", f"after take-off began{after}")


def _h_words(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}".replace("-", "−")


def _outside(violations: int | None) -> str:
    return "" if violations is None else f"{violations} ticks outside"


def _kept(outcome: Outcome) -> str:
    """Good only where something was certified and never left."""
    return "plain" if outcome.protection == "none" else _state(outcome.barrier_violations)


def _state(bad: int | None) -> str:
    return "plain" if bad is None else "bad" if bad else "good"


def planes_html(flight: FlightReport) -> str:
    """The planes side by side, with their legend."""
    images = "".join(f'<div class="third">{plane_svg(plane)}</div>' for plane in planes(flight))
    barrier = flight.barrier
    if not images or barrier is None:
        return ""
    keys = [("truth", f"path, {_state_of(flight)}, engaged"), ("idle", "not engaged"), ("changed", "command changed")]
    if barrier.certificates:
        keys.append(("certified", "certified"))
    if len(barrier.certificates) > 1:
        keys.append(("before", "certified at first"))
    if barrier.site:
        keys += [("region", "the site"), ("before", "kept out of")]
    if barrier.region is not None:
        keys.append(("region", "the scenario's region"))
    legend = "".join(f'<span class="key {role}"><i></i>{escape(text)}</span>' for role, text in keys)
    return (
        f'<section class="panel" id="barrier-planes"><h2>{_PLANES[bool(barrier.site)]}</h2>'
        f'<div class="keys">{legend}</div><div class="grid">{images}</div></section>'
    )


def tables_html(flight: FlightReport) -> str:
    """The ledger of the last certificate and the histogram of solve times."""
    certificates = flight.barrier.certificates if flight.barrier is not None else ()
    parts = []
    if certificates:
        parts.append(_ledger(certificates[-1]))
    filtered = flight.outcome.filter
    if filtered.solve_counts:
        image = histogram_svg(np.array(filtered.solve_edges_us), filtered.solve_counts, "time of one step", "ticks")
        parts.append(
            f'<section class="panel narrow" id="barrier-solve"><h2>Time that the filter takes</h2>{image}</section>'
        )
    return f'<div class="tables">{"".join(parts)}</div>' if parts else ""


def _ledger(certificate: Certificate) -> str:
    """Every margin of every axis in m/s^2, and what it comes from."""
    axes = certificate.axes
    head = "".join(f"<th>{AXES[axis.axis]}</th>" for axis in axes)
    rows = "".join(_ledger_row(name, axes) for name in MARGINS)
    total = "".join(f"<td>{sum(margin.mps2 for margin in axis.margins):.3f}</td>" for axis in axes)
    facts = "".join(f"<tr><th>{name}</th>{cells}</tr>" for name, cells in _facts(axes))
    words = (
        f"mode {escape(certificate.mode)}, version {certificate.version}, chance of failure "
        f"{certificate.delta:g}, {certificate.k_sigma:.2f} sigma"
    )
    title = f'Margins of the certificate <span class="unit">m/s²</span> <span class="note">{words}</span>'
    body = f'{rows}<tr class="total"><th>together</th>{total}</tr>{facts}'
    reasons = "".join(_reasons(name, axes) for name in MARGINS)
    return (
        f'<section class="panel wide" id="barrier-ledger"><h2>{title}</h2><table class="ledger">'
        f"<thead><tr><th>Margin</th>{head}</tr></thead><tbody>{body}</tbody></table>"
        f"<details><summary>What each line comes from</summary>{reasons}</details></section>"
    )


def _ledger_row(name: str, axes: tuple[AxisCertificate, ...]) -> str:
    cells = []
    for axis in axes:
        margin = next((line for line in axis.margins if line.name == name), None)
        cells.append(f"<td>{'–' if margin is None else f'{margin.mps2:.3f}'}</td>")
    return f"<tr><th>{name.replace('_', ' ')}</th>{''.join(cells)}</tr>"


def _reasons(name: str, axes: tuple[AxisCertificate, ...]) -> str:
    """What a line comes from, once where it is the same on all axes."""
    said: dict[str, list[str]] = {}
    for axis in axes:
        for margin in axis.margins:
            if margin.name == name:
                said.setdefault(margin.because, []).append(AXES[axis.axis])
    parts = [
        because if len(names) == len(axes) else f"{', '.join(names)}: {because}" for because, names in said.items()
    ]
    return f'<p class="note"><b>{name.replace("_", " ")}</b>: {escape("; ".join(parts))}</p>' if parts else ""


def _facts(axes: tuple[AxisCertificate, ...]) -> list[tuple[str, str]]:
    """Rows below the ledger: what each axis' condition was set to."""

    def row(values: list[str]) -> str:
        return "".join(f"<td>{value}</td>" for value in values)

    return [
        ("class-K gain", row([f"{axis.setting.gamma_ps:.2f} /s" for axis in axes])),
        ("longest tick", row([f"{1e3 * axis.setting.dt_s:.1f} ms" for axis in axes])),
        ("lag c1", row([f"{1e3 * axis.response.c1_s:.0f} ms" for axis in axes])),
        ("delay", row([f"{1e3 * axis.response.delay_s:.0f} ms" for axis in axes])),
        ("area", row([f"{axis.barrier.area_m2ps:.3f} m²/s" for axis in axes])),
        ("cells", row([str(len(axis.cells)) for axis in axes])),
    ]
