"""The HTML report of a flight: one self-contained page that opens from disk.

`from_log(log, result)` gathers what a log holds, `write_report(flight, path)` writes the page.
"""

from __future__ import annotations

from flightstack_logs.report.flight import (
    Barrier,
    CheckResult,
    FlightEvent,
    FlightReport,
    Learning,
    Outcome,
    Phase,
    ReportRegion,
    ReportSamples,
    Timing,
    samples,
)
from flightstack_logs.report.log_input import from_log
from flightstack_logs.report.page import render_report, write_report
from flightstack_logs.report.result import outcome_from_result, timing_from_result

__all__ = [
    "Barrier",
    "CheckResult",
    "FlightEvent",
    "FlightReport",
    "Learning",
    "Outcome",
    "Phase",
    "ReportRegion",
    "ReportSamples",
    "Timing",
    "from_log",
    "outcome_from_result",
    "render_report",
    "samples",
    "timing_from_result",
    "write_report",
]
