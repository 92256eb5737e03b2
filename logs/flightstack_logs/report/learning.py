"""The page's section on learning: what the learner expected, what was measured, what was true, and how far it is right.

One band, line and colour for what was learned in every panel; sudden changes that the learner noticed stand as lines.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from flightstack.calibration import BOUND_SIGMAS, STAGES, conformal_check, coverage
from flightstack.types import F64
from flightstack_logs.report import signals
from flightstack_logs.report.flight import FlightReport, LearnerOutcome, Learning, ReportSamples
from flightstack_logs.report.panel import Curve, Mark, Panel, PanelLine, Span, known
from flightstack_logs.report.words import KeyFigure, count, judged_span, microseconds, share

POINTS = 2000
"""Display points of a curve: the panels take a third of the page's width."""
_STAGE_ROLES = ("stage-none", "stage-none", "stage-valid", "stage-used", "stage-frozen")
_LEARNED = STAGES.index("valid")
"""From this stage on the learner has learned something."""
_AXES = (("x", "forward"), ("y", "right"), ("z", "down"))
_BOUND = f"±{BOUND_SIGMAS:.0f}σ"
MEAN_S = 0.2
"""Measurements are drawn as means over so long: a single sample's noise would hide all else."""


def with_measured_honesty(flight: FlightReport) -> FlightReport:
    """The same flight; coverage and held-out check that its result doesn't state are computed from its signals."""
    learning, said = flight.learning, flight.outcome.learner or LearnerOutcome(enabled=True)
    if learning is None or said.coverage is not None or said.conformal is not None:
        return flight
    expected = learning.residual_frd_mps2
    start, end = judged_span(flight)
    span = (expected.t_s >= start) & (expected.t_s <= end)

    def judged(signal: ReportSamples | None) -> F64:
        known = None if signal is None else signals.resample(signal, expected.t_s)
        return (np.full_like(expected.values, np.nan) if known is None else known)[span]

    mean, sigma = expected.values[span], judged(learning.bound_frd_mps2) / BOUND_SIGMAS
    seen = coverage(judged(learning.truth_frd_mps2), mean, sigma)
    outcome = replace(
        said,
        coverage=seen.share,
        coverage_axes=seen.axes,
        coverage_simultaneous=seen.simultaneous,
        conformal=conformal_check(judged(learning.target_frd_mps2), mean, sigma),
    )
    return replace(flight, outcome=replace(flight.outcome, learner=outcome))


def panels(flight: FlightReport, error: Panel) -> tuple[Panel, ...]:
    """The section's panels, the one of the tracking error among them; none where nothing learned."""
    learning = flight.learning
    if learning is None:
        return ()
    learning = replace(learning, truth_frd_mps2=_while_learning(flight, learning))
    marks = tuple(
        Mark(event.t_s, "change") for event in flight.events if event.kind == "learner" and event.severity == "warning"
    )
    drawn = (
        *(_residual(learning, axis) for axis in range(3)),
        *(_surprise(learning, axis) for axis in range(3)),
        _gain(learning),
        _stage(learning),
        replace(error, key="learning-error", title="Tracking error meanwhile"),
    )
    return tuple(replace(panel, marks=marks, third=True, points=POINTS) for panel in drawn)


def _while_learning(flight: FlightReport, learning: Learning) -> ReportSamples | None:
    """The true residual as long as the learner ran and the scenario was flown."""
    truth, ran = learning.truth_frd_mps2, learning.residual_frd_mps2.t_s
    if truth is None:
        return None
    _, end = judged_span(flight)
    kept = (truth.t_s >= ran[0]) & (truth.t_s <= min(ran[-1], end))
    return ReportSamples(truth.t_s[kept], truth.values[kept]) if kept.any() else None


def _band(middle: ReportSamples, half: ReportSamples | None) -> tuple[Curve, ...]:
    """The bound round a signal: its upper and lower edge."""
    if half is None:
        return ()
    reach = signals.resample(half, middle.t_s)
    upper, lower = (ReportSamples(middle.t_s, middle.values + sign * reach) for sign in (1.0, -1.0))
    return Curve(_BOUND, "learned", upper, edge="upper"), Curve(_BOUND, "learned", lower, edge="lower")


def _measured(learning: Learning) -> ReportSamples | None:
    """(n, 3) the measured residual without most of its noise."""
    target = learning.target_frd_mps2
    return None if target is None else signals.mean_over(target, MEAN_S)


def _residual(learning: Learning, axis: int) -> Panel:
    """What was expected, measured and true."""
    name, direction = _AXES[axis]
    expected = signals.column(learning.residual_frd_mps2, axis)
    curves = (
        *_band(expected, signals.column(learning.bound_frd_mps2, axis)),
        *known(("measured", "measured", signals.column(_measured(learning), axis))),
        *known(("truth", "truth", signals.column(learning.truth_frd_mps2, axis))),
        Curve("expected", "learned", expected),
    )
    return Panel(f"residual-{name}", f"Residual along {name}, {direction}", "m/s²", 2, curves)


def _surprise(learning: Learning, axis: int) -> Panel:
    """How far the truth, or else what was measured, lay from what was expected, once something was learned."""
    name, _ = _AXES[axis]
    of, signal = "truth", learning.truth_frd_mps2
    if signal is None:
        of, signal = "measured", _measured(learning)
    expected, bound = learning.residual_frd_mps2, learning.bound_frd_mps2
    curves: tuple[Curve, ...] = ()
    cut, note = None, ""
    if signal is not None:
        away = signals.resample(signal, expected.t_s) - expected.values
        learned = signals.resample(learning.stage, expected.t_s)[:, 0] >= _LEARNED
        away[~learned] = np.nan
        # Right after a change both are large for a moment; the scale is that of the rest.
        usual = max(_percentile(bound.values[learned, axis]), _percentile(np.abs(away[:, axis])))
        if usual > 0.0:
            cut = (-1.3 * usual, 1.3 * usual)
            note = "peaks are cut" if np.nanmax(np.abs(away[:, axis])) > cut[1] else ""
        level = ReportSamples(expected.t_s, np.zeros((len(expected.t_s), 1)))
        curves = (
            *_band(level, signals.column(bound, axis)),
            Curve(f"{of} − expected", of, ReportSamples(expected.t_s, away[:, axis : axis + 1])),
        )
    return Panel(f"surprise-{name}", f"Prediction error, {name}", "m/s²", 3, curves, cut=cut, note=note)


def _percentile(values: F64) -> float:
    """What 98 % of the finite values stay below; 0 where there are none."""
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, 98.0)) if finite.size else 0.0


def _gain(learning: Learning) -> Panel:
    gain = learning.thrust_gain
    curves: tuple[Curve, ...] = ()
    if gain is not None:
        band = _band(gain, learning.thrust_gain_bound)
        curves = (*band, Curve("thrust gain", "learned", gain))
    lines = (PanelLine(1.0, "as believed", "muted"),)
    return Panel("thrust-gain", "Thrust gain", "delivered over believed", 3, curves, lines)


def _stage(learning: Learning) -> Panel:
    confidence = learning.confidence
    curves = () if confidence is None else (Curve("confidence", "learned", confidence),)
    strip = _strip(learning.stage)
    return Panel(
        "confidence",
        "Confidence and stage",
        "1 where the bound is nothing, 0 from 0.1 g",
        2,
        curves,
        floor=0.0,
        strip=strip,
        scale=(1.0,),
    )


def _strip(stage: ReportSamples) -> tuple[Span, ...]:
    """The stage over time; stages in between that are too short to be seen belong to the one before."""
    values = stage.values[:, 0]
    changes = np.flatnonzero(np.diff(values, prepend=np.nan))
    least_s = (float(stage.t_s[-1]) - float(stage.t_s[0])) / 500.0
    starts: list[tuple[float, float]] = []
    for index, following in pairwise([*changes.tolist(), len(values) - 1]):
        long = float(stage.t_s[following]) - float(stage.t_s[index]) >= least_s
        if (long or not starts) and not (starts and starts[-1][1] == values[index]):
            starts.append((float(stage.t_s[index]), float(values[index])))
    ends = [start for start, _ in starts[1:]] + [float(stage.t_s[-1])]
    return tuple(
        Span(start, end, STAGES[int(value)], _STAGE_ROLES[int(value)])
        for (start, value), end in zip(starts, ends, strict=True)
    )


def figures(flight: FlightReport) -> tuple[KeyFigure, ...]:
    """The section's key figures: how far the learner's word was true, and what it took; only what is known."""
    learner = flight.outcome.learner
    if learner is None:
        return ()
    gain = "–" if learner.thrust_gain is None else f"{learner.thrust_gain:.3f}"
    axes = ", ".join(f"{axis} {_share(value)}" for axis, value in zip("xyz", learner.coverage_axes, strict=False))
    stated = (
        KeyFigure("Truth within 3 sigma", _share(learner.coverage), axes.replace(" %", "")),
        KeyFigure("All three axes at once", _share(learner.coverage_simultaneous), "of the ticks"),
        _conformal(learner),
        KeyFigure("Thrust gain", gain, "delivered over believed"),
        KeyFigure("Points", count(learner.points), f"of {count(learner.fed)} samples"),
        KeyFigure("Sudden changes", count(learner.changes), "noticed"),
        KeyFigure("One step", microseconds(learner.step_p50_us), f"p99 {microseconds(learner.step_p99_us)}"),
    )
    return tuple(figure for figure in stated if figure.value != "–")


def _share(value: float | None) -> str:
    return "–" if value is None else share(value)


def _conformal(learner: LearnerOutcome) -> KeyFigure:
    label, checked = "Held-out check", learner.conformal
    if checked is None:
        return KeyFigure(label, "–")
    within, kept = share(1.0 - checked.alpha), share(checked.coverage_heldout)
    return KeyFigure(label, f"{checked.quantile_sigma:.1f} sigma", f"held {within} of the windows, then {kept}")
