"""The page of a flight that this project did not fly: what its log holds, and nothing that only our logs have."""

from __future__ import annotations

import math

import numpy as np

from flightstack.types import F64
from flightstack_logs.report.charts import motor_saturation
from flightstack_logs.report.flight import FlightReport, Recorded, ReportSamples
from flightstack_logs.report.panel import Panel, components
from flightstack_logs.report.words import KeyFigure, length, percent, seconds

BESIDE = ("velocity", "force")
"""Panels that stand beside the path."""


def panels(recorded: Recorded) -> tuple[Panel, ...]:
    """Velocity, specific force, battery."""
    return (
        Panel("velocity", "Velocity", "m/s", 2, components(recorded.vel_ned_mps, ("north", "east", "down"))),
        Panel("force", "Specific force", "m/s²", 2, components(recorded.accel_frd_mps2, ("x", "y", "z"))),
        Panel("battery", "Battery", "V", 2, components(recorded.battery_v, ("voltage",)), third=True),
    )


def figures(flight: FlightReport, recorded: Recorded) -> tuple[KeyFigure, ...]:
    """The strip of key figures; what the log does not tell is left out."""
    found = [KeyFigure("Recorded", seconds(recorded.span_s))]
    place = _known(flight.estimate_ned_m)
    if place is not None:
        found += [
            KeyFigure("Highest", length(float(-place[:, 2].min())), "above the start"),
            KeyFigure("Farthest", length(float(np.linalg.norm(place[:, :2], axis=1).max())), "from the start, level"),
        ]
    speed = _known(recorded.vel_ned_mps)
    if speed is not None:
        found.append(KeyFigure("Fastest", f"{np.linalg.norm(speed, axis=1).max():.1f} m/s"))
    attitude = _known(flight.estimate_q_ned_frd)
    if attitude is not None:
        up = 1.0 - 2.0 * (attitude[:, 1] ** 2 + attitude[:, 2] ** 2)
        found.append(KeyFigure("Greatest tilt", f"{math.degrees(math.acos(np.clip(up.min(), -1.0, 1.0))):.0f}°"))
    if flight.motors is not None and (flight.motors.values > 0.0).any():
        turning = (flight.motors.values > 0.0).any(axis=1)
        share = float(np.mean(motor_saturation(flight.motors).values[turning]))
        found.append(KeyFigure("A motor at its limit", percent(share), "of the time that motors turn"))
    volts = _known(recorded.battery_v)
    if volts is not None:
        found.append(
            KeyFigure("Battery", f"{volts[-1, 0]:.1f} V", f"at first {volts[0, 0]:.1f}, least {volts.min():.1f}")
        )
    return tuple(found)


def missing(drawn: tuple[Panel, ...]) -> str:
    """What of a flight's page is not in the log, in words."""
    names = [f"{panel.title[0].lower()}{panel.title[1:]}" for panel in drawn if not panel.curves]
    return f"not in this log: {'; '.join(names)}" if names else ""


def _known(signal: ReportSamples | None) -> F64 | None:
    """Rows without a gap; None where there are none."""
    if signal is None:
        return None
    rows = signal.values[np.isfinite(signal.values).all(axis=1)]
    return rows if len(rows) else None
