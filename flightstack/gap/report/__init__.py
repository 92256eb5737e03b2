"""The report of a gap analysis: one HTML page that opens from disk."""

from __future__ import annotations

from flightstack.gap.report.page import render_report, write_report
from flightstack.gap.report.record import GapReport, LogQuality, RegimeRow, Shown, Step, Trace

__all__ = ["GapReport", "LogQuality", "RegimeRow", "Shown", "Step", "Trace", "render_report", "write_report"]
