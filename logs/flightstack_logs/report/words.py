"""The page's sentences and key figures: what happened, in words and numbers with units."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from flightstack_logs.report import signals
from flightstack_logs.report.charts import motor_saturation, tracking_error
from flightstack_logs.report.flight import FlightReport


@dataclass(frozen=True, slots=True)
class KeyFigure:
    """One key figure: `state` is good, bad, off or plain."""

    label: str
    value: str
    note: str = ""
    state: str = "plain"


def length(metres: float | None) -> str:
    """A length as people say it: centimetres below a metre."""
    if metres is None:
        return "–"
    return f"{100.0 * metres:.1f} cm" if abs(metres) < 1.0 else f"{metres:.2f} m"


def seconds(value: float) -> str:
    """A duration: seconds, from two minutes on minutes and seconds."""
    if value < 120.0:
        return f"{value:.1f} s"
    return f"{int(value // 60)} min {value % 60:.0f} s"


def percent(share: float) -> str:
    """A share of 1 in per cent; small ones keep a decimal."""
    if 0.0 < share < 0.001:
        return "< 0.1 %"
    return f"{100.0 * share:.1f} %" if 0.0 < share < 0.1 else f"{100.0 * share:.0f} %"


def microseconds(value: float | None) -> str:
    """A time-span in the unit that reads best."""
    if value is None:
        return "–"
    return f"{value:.0f} µs" if abs(value) < 1000.0 else f"{value / 1000.0:.2f} ms"


def judged_span(flight: FlightReport) -> tuple[float, float]:
    """From the end of take-off to the command to land, as far as the phases say it; else everything."""
    takeoff, landing = flight.phase("takeoff"), flight.phase("landing")
    start = takeoff.end_s if takeoff is not None else -math.inf
    end = landing.start_s if landing is not None else math.inf
    if landing is None and flight.phase("track") is not None:
        end = max(phase.end_s for phase in flight.phases)
    return start, end


def with_measured_figures(flight: FlightReport) -> FlightReport:
    """The same flight; tracking figures that its result doesn't state are computed from its signals."""
    outcome = flight.outcome
    error = tracking_error(flight)
    if error is None or outcome.rmse_m is not None:
        return flight
    distance = signals.norm(error)
    start, end = judged_span(flight)
    start, end = max(start, float(distance.t_s[0])), min(end, float(distance.t_s[-1]))
    judged = signals.within(distance, start, end)
    if not np.isfinite(judged).any():
        return flight
    outcome = replace(
        outcome,
        tracking_of="truth" if flight.truth_ned_m is not None else "estimate",
        rmse_m=signals.rms(judged),
        max_m=float(np.nanmax(judged)),
        rmse_settled_m=signals.rms(signals.within(distance, 0.5 * (start + end), end)),
        flight_time_s=end - start if outcome.flight_time_s is None else outcome.flight_time_s,
    )
    return replace(flight, outcome=outcome)


def verdict(flight: FlightReport) -> tuple[str, str]:
    """(state, words): good only where the flight passed and, if it asked for protection, was protected."""
    outcome = flight.outcome
    completed = outcome.completed
    if outcome_left(flight):
        return "bad", "Left its region"
    if completed is None:
        return "plain", "Recorded"
    if not completed:
        return "bad", "Failed"
    if outcome.protection == "none":
        return "bad", "Not protected"
    if not all(check.passed for check in outcome.checks):
        return "bad", "Check failed"
    return ("bad", "Failed") if outcome.passed is False else ("good", "Completed")


def outcome_left(flight: FlightReport) -> bool:
    """Whether a filter flew and the region was left all the same."""
    outcome = flight.outcome
    return outcome.protection == "left" or bool(outcome.barrier_enabled and outcome.barrier_violations)


def headline(flight: FlightReport) -> str:
    """What happened, in one sentence."""
    outcome = flight.outcome
    name = outcome.scenario
    time = "" if outcome.flight_time_s is None else seconds(outcome.flight_time_s)
    if outcome.completed is False:
        after = " before take-off" if outcome.flight_time_s == 0.0 else f" after {time}" if time else ""
        why = f": {outcome.reason.rstrip('.')}" if outcome.reason else ""
        error = "" if outcome.rmse_m is None else f" Tracking error {length(outcome.rmse_m)} rms."
        return f"{name} failed{after}{why}.{error}"
    done = "completed" if outcome.completed else "recorded"
    parts = [f"{name} {done}"]
    if time:
        parts.append(f"{time} flown")
    if outcome.rmse_m is not None:
        worst = "" if outcome.max_m is None else f" (at most {length(outcome.max_m)})"
        parts.append(f"tracking error {length(outcome.rmse_m)} rms{worst}")
    if outcome.protection not in ("", "off"):
        parts.append(outcome.protection_words)
    return ", ".join(parts) + "."


def figures(flight: FlightReport) -> tuple[KeyFigure, ...]:
    """The strip of key figures."""
    outcome = flight.outcome
    of = f"of the {outcome.tracking_of}" if outcome.tracking_of else ""
    return (
        KeyFigure("Tracking error, rms", length(outcome.rmse_m), of),
        KeyFigure("Largest error", length(outcome.max_m), of),
        KeyFigure("Settled error, rms", length(outcome.rmse_settled_m), "second half"),
        *_estimate(flight),
        _saturation(flight),
        _speed(flight),
        _barrier(flight),
        _learner(flight),
    )


def _estimate(flight: FlightReport) -> tuple[KeyFigure, ...]:
    """The estimate's disagreement with itself and the control's own error; nothing where they are unknown."""
    outcome = flight.outcome
    if not outcome.disagreement_mps:
        return ()
    worst = max(outcome.disagreement_mps)
    apart = ", ".join(f"{value:.2f}" for value in outcome.disagreement_mps)
    return (
        KeyFigure("Control error, settled", length(outcome.control_rmse_settled_m), "of the estimate"),
        KeyFigure(
            "Estimate's disagreement",
            f"{worst:.2f} m/s",
            f"d(position)/dt less velocity, rms; N, E, D {apart}; 0.15 is good",
        ),
    )


def _saturation(flight: FlightReport) -> KeyFigure:
    start, end = judged_span(flight)
    motors = ""
    if flight.motors is not None and (flight.motors.values > 0.0).any():  # none ever turned: no limit was met
        at_limit = signals.within(motor_saturation(flight.motors), start, end)
        motors = f"a motor at its limit: {percent(float(np.mean(at_limit)))}" if at_limit.size else ""
    if flight.thrust_saturated is None:
        return KeyFigure("Thrust at its limit", "–", motors or "not recorded")
    rows = signals.within(flight.thrust_saturated, start, end)
    if not rows.size:
        return KeyFigure("Thrust at its limit", "–", motors)
    return KeyFigure("Thrust at its limit", percent(float(np.nanmean(rows))), motors or "of the time judged")


def _speed(flight: FlightReport) -> KeyFigure:
    outcome = flight.outcome
    factor = outcome.realtime_factor
    if outcome.lockstep is False or (flight.timing is not None and outcome.lockstep is None):
        timing = flight.timing
        note = "" if timing is None else f"late {microseconds(timing.p99_us)} p99, missed {count(timing.missed)}"
        return KeyFigure("Speed", "real time", note)
    if factor is None:
        return KeyFigure("Speed", "–", "not recorded")
    return KeyFigure("Speed", f"{factor:.1f} ×", "real time, in lockstep")


def _barrier(flight: FlightReport) -> KeyFigure:
    outcome = flight.outcome
    if outcome.barrier_enabled is None:
        return KeyFigure("Barrier filter", "–", "not recorded")
    if not outcome.barrier_enabled:
        return KeyFigure("Barrier filter", "off", "", "off")
    violations = outcome.barrier_violations
    notes = [] if outcome.barrier_min_h is None else [f"least h {outcome.barrier_min_h:.3f}"]
    notes.append(f"{count(outcome.barrier_interventions)} interventions")
    if not outcome.protection:
        state = "plain" if violations is None else "bad" if violations else "good"
        return KeyFigure("Barrier filter", f"{count(violations)} violations", ", ".join(notes), state)
    notes.insert(0, "violations not known" if violations is None else f"{violations} violations")
    state = {"held": "good", "off": "off"}.get(outcome.protection, "bad")
    return KeyFigure("Protection", outcome.protection_words, ", ".join(notes), state)


def _learner(flight: FlightReport) -> KeyFigure:
    learner = flight.outcome.learner
    if learner is None:
        return KeyFigure("Learner", "–", "not recorded")
    if not learner.enabled:
        return KeyFigure("Learner", "off", "", "off")
    note = "" if learner.coverage is None else f"{share(learner.coverage)} within 3 sigma"
    return KeyFigure("Learner", f"{count(learner.points)} points", note)


def share(value: float) -> str:
    """A share near 1 in per cent, with as many decimals as it takes not to claim a whole that isn't."""
    decimals = 1 if value <= 0.999 or value == 1.0 else 2
    return f"{math.floor(10.0 ** (decimals + 2) * value + 1e-6) / 10.0**decimals:.{decimals}f} %"


def count(value: int | None) -> str:
    """A number, or a dash."""
    return "–" if value is None else str(value)
