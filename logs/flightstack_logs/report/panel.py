"""The page's charts over time: curves, bands and marks of one panel, and how they travel to the script.

Roles carry the colours (`page.css`): `command` what was wanted, `measured` what the vehicle reported, `truth` what
really was, `learned`, `limit`, and `one`..`four` for components.  The page's script draws what it is told and decides
nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from flightstack.types import F64
from flightstack_logs.report import signals
from flightstack_logs.report.flight import ReportSamples

POINTS = 4000
"""Display points of a curve over time; the log holds every sample."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One line (n, 1) of a panel."""

    label: str
    role: str
    samples: ReportSamples
    wide: bool = False
    edge: str = ""
    """upper or lower: of a band, an upper edge directly before its lower one; only the upper one's label is shown."""


@dataclass(frozen=True, slots=True)
class PanelLine:
    """A horizontal line with a name: a limit, or a level to compare with."""

    value: float
    label: str
    role: str = "limit"


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of time with a word for it."""

    start_s: float
    end_s: float
    label: str
    role: str


@dataclass(frozen=True, slots=True)
class Mark:
    """A moment with a word for it: a vertical line."""

    t_s: float
    label: str


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A chart over time.  Without curves it says "not recorded"."""

    key: str
    title: str
    unit: str
    decimals: int
    curves: tuple[Curve, ...]
    lines: tuple[PanelLine, ...] = ()
    shaded_s: tuple[tuple[float, float], ...] = ()
    """Spans in which the vehicle was at a limit."""
    floor: float | None = None
    """The scale starts here (distances and motor commands at 0)."""
    note: str = ""
    third: bool = False
    """Whether it takes a third of the page's width instead of half."""
    points: int = field(default=POINTS)
    strip: tuple[Span, ...] = ()
    """What was the case when, written along the bottom."""
    marks: tuple[Mark, ...] = ()
    scale: tuple[float, ...] = ()
    """Values that the scale holds besides those of the curves; bands hold none."""
    cut: tuple[float, float] | None = None
    """The scale goes from here to there, whatever lies beyond."""

    @property
    def recorded(self) -> int:
        """Samples behind the densest curve."""
        return max((len(curve.samples.t_s) for curve in self.curves), default=0)

    def payload(self) -> dict[str, object]:
        """What the script draws; all curves share one time column."""
        whole = _join(self.curves)
        joined = signals.decimate(whole, self.points)
        thinned = joined is not whole
        return {
            "key": self.key,
            "unit": self.unit,
            "decimals": self.decimals,
            "floor": self.floor,
            "lines": [{"value": line.value, "label": line.label, "role": line.role} for line in self.lines],
            "shaded": [list(span) for span in self.shaded_s],
            "strip": [[span.start_s, span.end_s, span.label, span.role] for span in self.strip],
            "marks": [[mark.t_s, mark.label] for mark in self.marks],
            "scale": list(self.scale),
            "cut": self.cut,
            "t": signals.encode(joined.t_s),
            "curves": [
                {
                    "label": curve.label,
                    "role": curve.role,
                    "wide": curve.wide,
                    "edge": curve.edge,
                    "y": signals.encode(_outwards(joined.values[:, column], curve.edge, thinned)),
                }
                for column, curve in enumerate(self.curves)
            ],
        }


def _join(curves: Sequence[Curve]) -> ReportSamples:
    """All curves on the times of the densest one."""
    base = max(curves, key=lambda curve: len(curve.samples.t_s)).samples
    columns = []
    for curve in curves:
        same = curve.samples.t_s is base.t_s or np.array_equal(curve.samples.t_s, base.t_s)
        # A slow signal is a line between its samples; it must not vanish between them.
        gap = max(signals.MAX_GAP_S, 3.0 * _period(curve.samples))
        columns.append(curve.samples.values if same else signals.resample(curve.samples, base.t_s, gap))
    return ReportSamples(base.t_s, np.concatenate(columns, axis=1))


def _outwards(values: F64, edge: str, thinned: bool) -> F64:
    """A band's edge after `decimate`, which makes two rows of an interval: both become the one that widens the band."""
    if not edge or not thinned:
        return values
    extreme = np.fmax if edge == "upper" else np.fmin
    return np.repeat(extreme(values[::2], values[1::2]), 2)


def _period(signal: ReportSamples) -> float:
    return float(np.median(np.diff(signal.t_s))) if len(signal.t_s) > 1 else 0.0


def known(*candidates: tuple[str, str, ReportSamples | None]) -> tuple[Curve, ...]:
    """Curves of those signals (label, role, signal) that were recorded; the estimate is drawn wide, below the truth."""
    return tuple(
        Curve(label, role, signal, wide=role == "measured") for label, role, signal in candidates if signal is not None
    )


def components(signal: ReportSamples | None, labels: Sequence[str]) -> tuple[Curve, ...]:
    """One curve for each column of a signal."""
    if signal is None:
        return ()
    roles = ("one", "two", "three", "four")
    return tuple(
        Curve(label, roles[i], ReportSamples(signal.t_s, signal.values[:, i : i + 1])) for i, label in enumerate(labels)
    )
