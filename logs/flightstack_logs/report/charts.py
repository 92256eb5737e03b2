"""The page's panels: which signals of a flight are drawn together, in which unit and role."""

from __future__ import annotations

import math

import numpy as np

from flightstack_logs.report import signals
from flightstack_logs.report.flight import FlightReport, ReportRegion, ReportSamples
from flightstack_logs.report.panel import Curve, Panel, PanelLine, components, known

PATH_POINTS = 2000
"""Display points of a curve in space."""


def panels(flight: FlightReport) -> tuple[Panel, ...]:
    """Every panel over time, in the order of the page."""
    return (
        *_tracking(flight),
        _thrust(flight),
        _motors(flight),
        *_rates(flight),
        _tilt(flight),
        *_estimate_error(flight),
    )


def length_unit(signal: ReportSamples) -> tuple[str, float, int]:
    """Unit, factor from metres and decimals in which the signal reads best."""
    largest = float(np.nanmax(np.abs(signal.values))) if np.isfinite(signal.values).any() else 0.0
    return ("cm", 100.0, 1) if largest < 1.0 else ("m", 1.0, 3)


def tracking_error(flight: FlightReport) -> ReportSamples | None:
    """(n, 3) flown minus reference, north, east, down, metres, where both are known."""
    if flight.reference_ned_m is None or flight.flown_ned_m is None:
        return None
    error = signals.difference(flight.flown_ned_m, flight.reference_ned_m)
    known = np.isfinite(error.values).all(axis=1)
    return ReportSamples(error.t_s[known], error.values[known]) if known.any() else None


def _tracking(flight: FlightReport) -> tuple[Panel, Panel]:
    error = tracking_error(flight)
    of = "truth" if flight.truth_ned_m is not None else "estimate"
    keys = ("error-distance", "Tracking error, 3-D distance"), ("error-axes", "Tracking error by axis")
    if error is None:
        return (Panel(*keys[0], "m", 3, ()), Panel(*keys[1], "m", 3, ()))
    unit, factor, decimals = length_unit(error)
    scaled = ReportSamples(error.t_s, error.values * factor)
    rmse = flight.outcome.rmse_m
    rmse_line = (
        () if rmse is None else (PanelLine(rmse * factor, f"rmse {rmse * factor:.{decimals}f} {unit}", "muted"),)
    )
    return (
        Panel(
            *keys[0],
            unit,
            decimals,
            known((f"distance of the {of} from the reference", of if of == "truth" else "measured", _norm(scaled))),
            lines=rmse_line,
            floor=0.0,
        ),
        Panel(*keys[1], unit, decimals, components(scaled, ("north", "east", "down"))),
    )


def _norm(signal: ReportSamples | None) -> ReportSamples | None:
    return None if signal is None else signals.norm(signal)


def _thrust(flight: FlightReport) -> Panel:
    curves = (
        *(
            Curve(label, role, signal)
            for label, role, signal in (
                ("commanded", "command", flight.thrust_command_n),
                ("feed-forward part", "one", flight.thrust_feedforward_n),
                ("delivered (truth)", "truth", flight.thrust_truth_n),
            )
            if signal is not None
        ),
    )
    lines: tuple[PanelLine, ...] = ()
    if flight.thrust_limits_n is not None:
        low, high = flight.thrust_limits_n
        lines = (PanelLine(low, f"least {low:.1f} N"), PanelLine(high, f"limit {high:.1f} N"))
    spans = () if flight.thrust_saturated is None else tuple(signals.intervals(flight.thrust_saturated))
    note = "red bands: command cut to its limit" if spans else ""
    return Panel("thrust", "Total thrust", "N", 2, curves, lines, spans if curves else (), floor=0.0, note=note)


def motor_saturation(motors: ReportSamples) -> ReportSamples:
    """(n, 1), 1 where any motor command is at 0 or 1."""
    with np.errstate(invalid="ignore"):
        at_limit = ((motors.values >= 0.999) | (motors.values <= 0.001)).any(axis=1, keepdims=True)
    return ReportSamples(motors.t_s, np.asarray(at_limit, dtype=np.float64))


def _motors(flight: FlightReport) -> Panel:
    motors = flight.motors
    labels = () if motors is None else tuple(f"motor {i + 1}" for i in range(min(4, motors.values.shape[1])))
    return Panel(
        "motors",
        "Motor commands",
        "of full scale",
        3,
        components(motors, labels),
        lines=(PanelLine(1.0, "full"),),
        floor=0.0,
    )


def _rates(flight: FlightReport) -> tuple[Panel, ...]:
    out = []
    degrees = 180.0 / math.pi
    for axis, name in enumerate(("Roll", "Pitch", "Yaw")):
        curves = known(
            ("commanded", "command", signals.scaled(signals.column(flight.rate_command_frd_radps, axis), degrees)),
            ("measured", "measured", signals.scaled(signals.column(flight.rate_measured_frd_radps, axis), degrees)),
            ("truth", "truth", signals.scaled(signals.column(flight.rate_truth_frd_radps, axis), degrees)),
        )
        lines: tuple[PanelLine, ...] = ()
        note = ""
        if flight.rate_limit_frd_radps is not None and curves:
            limit = flight.rate_limit_frd_radps[axis] * degrees
            largest = max(float(np.nanmax(np.abs(curve.samples.values))) for curve in curves)
            if largest > 0.5 * limit:
                lines = (PanelLine(-limit, f"limit {-limit:.0f} °/s"), PanelLine(limit, f"limit {limit:.0f} °/s"))
            else:
                note = f"limit ±{limit:.0f} °/s is off the scale"
        out.append(Panel(f"rate-{name.lower()}", f"{name} rate", "°/s", 1, curves, lines, note=note, third=True))
    return tuple(out)


def _tilt(flight: FlightReport) -> Panel:
    estimate, truth = flight.estimate_q_ned_frd, flight.truth_q_ned_frd
    curves = known(
        ("estimate", "measured", None if estimate is None else signals.tilt_deg(estimate)),
        ("truth", "truth", None if truth is None else signals.tilt_deg(truth)),
    )
    return Panel("tilt", "Tilt from the vertical", "°", 1, curves, floor=0.0, third=True)


def _estimate_error(flight: FlightReport) -> tuple[Panel, Panel]:
    position: tuple[Curve, ...] = ()
    unit, decimals = "m", 3
    error = flight.estimate_error_ned_m
    if error is not None and np.isfinite(error.values).any():
        unit, factor, decimals = length_unit(error)
        position = components(signals.scaled(error, factor), ("north", "east", "down"))
    attitude: tuple[Curve, ...] = ()
    if flight.estimate_q_ned_frd is not None and flight.truth_q_ned_frd is not None:
        angle = signals.rotation_between_deg(flight.estimate_q_ned_frd, flight.truth_q_ned_frd)
        attitude = known(("angle between estimate and truth", "truth", angle))
    return (
        Panel("estimate-position", "Estimate against truth, position", unit, decimals, position, third=True),
        Panel("estimate-attitude", "Estimate against truth, attitude", "°", 2, attitude, floor=0.0, third=True),
    )


def path_payload(flight: FlightReport) -> dict[str, object] | None:
    """The view in space: tracks in north, east, up; None where no position was recorded."""
    tracks = []
    for label, role, signal in (
        ("reference", "command", flight.reference_ned_m),
        ("estimate", "measured", flight.estimate_ned_m),
        ("truth", "truth", flight.truth_ned_m),
    ):
        if signal is None:
            continue
        known = np.isfinite(signal.values).all(axis=1)
        shown = signals.thin(ReportSamples(signal.t_s[known], signal.values[known]), PATH_POINTS)
        north, east, down = shown.values.T
        tracks.append(
            {
                "label": label,
                "role": role,
                "t": signals.encode(shown.t_s),
                "n": signals.encode(north),
                "e": signals.encode(east),
                "u": signals.encode(-down),
            }
        )
    if not tracks:
        return None
    return {"tracks": tracks, "region": None if flight.region is None else _region(flight.region)}


def _region(region: ReportRegion) -> dict[str, object]:
    north, east, down = region.centre_ned_m
    return {"shape": region.shape, "centre": [north, east, -down], "half": list(region.half_ned_m)}
