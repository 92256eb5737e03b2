"""From a flight's log (and its result, where there is one) to what the report shows.

Nothing is taken for granted: a topic, a column, an attachment that is missing leaves its part of the report empty.
Positions become relative to where each signal was when the take-off began, because the scenario's coordinates are
relative to the place of arming: so does the result's tracking error.  The estimate's error is taken before that shift.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from flightstack.barrier.file import parse_certificate
from flightstack.barrier.records import Certificate
from flightstack.calibration import BOUND_SIGMAS, true_residual_frd_mps2
from flightstack.model import Model
from flightstack.scenario import Scenario, parse_scenario
from flightstack.types import F64, InputError
from flightstack.vehicle import parse_vehicle
from flightstack_logs.info import PARAMETERS, parameters
from flightstack_logs.reader import Log
from flightstack_logs.report import signals
from flightstack_logs.report.flight import (
    Barrier,
    FlightReport,
    Learning,
    Outcome,
    Phase,
    ReportRegion,
    ReportSamples,
    Timing,
    samples,
)
from flightstack_logs.report.log_source import LogSource, events_of, recorded_of
from flightstack_logs.report.result import kept_result, outcome_from_result, timing_from_result
from flightstack_logs.topics import CERTIFICATE, FINAL_CERTIFICATE, SITE_OUTLINES

_PHASE_OF = {"land": "landing", "done": "landing"}
_NOT_FLOWN = {"connect", "landed"}
_PWM_LOW_US, _PWM_SPAN_US = 1000.0, 1000.0
_ROTORS = 4


def from_log(log: Log, result: Mapping[str, object] | None = None) -> FlightReport:
    """The report of a log and the flight's `flightstack.flight/1` object, given or kept in the log.

    Without either the figures are computed.
    """
    result = kept_result(log) if result is None else result
    source = LogSource(log, _zero_us(log))
    phases = _phases(source)
    timing = _timing(source, result)
    report = FlightReport(
        outcome=_outcome(log, result, timing),
        phases=phases,
        events=events_of(source),
        thrust_command_n=source.signal("/command", "thrust_n"),
        thrust_feedforward_n=source.signal("/control", "thrust_ff_n"),
        thrust_truth_n=_total(source.signal("/truth", "rotor_thrust_n")),
        thrust_saturated=source.signal("/tick", "thrust_saturated"),
        rate_command_frd_radps=source.signal("/command", "rate_frd_radps"),
        rate_measured_frd_radps=source.first(("/vehicle/attitude", "rate_frd_radps"), ("/tick", "rate_frd_radps")),
        rate_truth_frd_radps=source.signal("/truth", "rate_frd_radps"),
        estimate_q_ned_frd=source.first(("/vehicle/attitude", "q_ned_frd"), ("/tick", "q_ned_frd")),
        truth_q_ned_frd=source.signal("/truth", "q_ned_frd"),
        motors=_motors(source),
        timing=timing,
        settings=_settings(log),
        recorded=recorded_of(source) if result is None else None,
    )
    model = _model(log)
    report = replace(report, learning=_learning(source, model))
    report = _with_limits(_with_positions(report, source), log, model)
    return replace(report, barrier=_barrier(source))


def _zero_us(log: Log) -> int:
    """When the take-off began; in a log without one, the first command, else the first message."""
    events = log.tables.get("/events")
    if events is not None and {"name", "text"} <= events.columns.keys():
        begun = np.flatnonzero((events["name"] == "phase") & (events["text"] == "takeoff"))
        if begun.size:
            return int(events.t_us[begun[0]])
    command = log.tables.get("/command")
    return int(command.t_us[0]) if command is not None and len(command) else log.span_us[0]


def _phases(source: LogSource) -> tuple[Phase, ...]:
    table = source.table("/events")
    if table is None or not {"name", "text"} <= table.columns.keys():
        return ()
    end_s = float(source.seconds(np.array(source.log.span_us[1])))
    marks = [
        (float(source.seconds(t_us)), _PHASE_OF.get(str(text), str(text)))
        for t_us, name, text in zip(table.t_us, table["name"], table["text"], strict=True)
        if name == "phase"
    ]
    phases: list[Phase] = []
    for (start, name), (end, _) in pairwise([*marks, (end_s, "")]):
        if phases and phases[-1].name == name:
            phases[-1] = replace(phases[-1], end_s=end)
        elif name not in _NOT_FLOWN:
            phases.append(Phase(name, start, end))
    return tuple(phases)


def _total(signal: ReportSamples | None) -> ReportSamples | None:
    return None if signal is None else ReportSamples(signal.t_s, signal.values.sum(axis=1, keepdims=True))


def _motors(source: LogSource) -> ReportSamples | None:
    """Normalised commands: as the stack knew them, else out of the pulse widths, else the true rotors' state."""
    known = source.signal("/tick", "motor_command")
    pulses = source.signal("/vehicle/motors", "pwm_us")
    if pulses is not None:
        values = (pulses.values[:, :_ROTORS] - _PWM_LOW_US) / _PWM_SPAN_US
        pulses = ReportSamples(pulses.t_s, np.clip(values, 0.0, 1.0))
    return pulses or known or source.signal("/truth", "motor_u")


def _with_positions(report: FlightReport, source: LogSource) -> FlightReport:
    """The report with its positions, relative to the start; the reference only while it is to be followed."""
    reference = source.signal("/setpoint", "pos_ned_m")
    estimate = source.first(("/vehicle/local_position", "pos_ned_m"), ("/tick", "pos_ned_m"))
    truth = source.signal("/truth", "pos_ned_m")
    error = None
    if estimate is not None and truth is not None:
        error = signals.difference(estimate, truth)
    start = _at_zero(reference)
    if start is None:
        start = _at_zero(estimate)
    landing = report.phase("landing")
    if reference is not None:
        kept = reference.t_s >= 0.0
        if landing is not None:
            kept &= reference.t_s <= landing.start_s
        reference = samples(reference.t_s[kept], reference.values[kept])
    return replace(
        report,
        reference_ned_m=_shifted(reference, start),
        estimate_ned_m=_shifted(estimate, start),
        truth_ned_m=_shifted(truth, _at_zero(truth)),
        estimate_error_ned_m=error,
    )


def _at_zero(signal: ReportSamples | None) -> F64 | None:
    """The signal's first known row from t = 0 on; of one that ended before, the last."""
    if signal is None:
        return None
    known = np.flatnonzero(np.isfinite(signal.values).all(axis=1))
    if not known.size:
        return None
    later = known[signal.t_s[known] >= 0.0]
    return np.asarray(signal.values[later[0] if later.size else known[-1]])


def _shifted(signal: ReportSamples | None, origin: F64 | None) -> ReportSamples | None:
    return signal if signal is None or origin is None else ReportSamples(signal.t_s, signal.values - origin)


def _scenario(log: Log) -> Scenario | None:
    text = log.attachment("scenario.toml")
    try:
        return None if text is None else parse_scenario(text.decode("utf-8", errors="replace"), "scenario.toml")
    except (InputError, ValueError, KeyError, TypeError):
        return None  # a log of another version; the rest of the report stands


def _model(log: Log) -> Model | None:
    text = log.attachment("vehicle.toml")
    try:
        vehicle = None if text is None else parse_vehicle(text.decode("utf-8", errors="replace"), "vehicle.toml")
        return None if vehicle is None else Model.from_vehicle(vehicle)
    except (InputError, ValueError, KeyError, TypeError):
        return None


def _learning(source: LogSource, model: Model | None) -> Learning | None:
    """What the learner said, and by the truth and the model what it should have said."""
    names = ("residual_frd_mps2", "sigma_frd_mps2", "stage")
    residual, sigma, stage = (source.signal("/learner", name) for name in names)
    if residual is None or sigma is None or stage is None:
        return None
    return Learning(
        residual_frd_mps2=residual,
        bound_frd_mps2=signals.scaled(sigma, BOUND_SIGMAS),
        stage=stage,
        target_frd_mps2=source.signal("/learner", "target_frd_mps2"),
        truth_frd_mps2=_true_residual(source, model),
        thrust_gain=source.signal("/learner", "thrust_gain"),
        thrust_gain_bound=signals.scaled(source.signal("/learner", "thrust_gain_sigma"), BOUND_SIGMAS),
        confidence=source.signal("/learner", "confidence"),
    )


def _true_residual(source: LogSource, model: Model | None) -> ReportSamples | None:
    table = source.table("/truth")
    parts = ("specific_force_frd_mps2", "motor_u", "vel_ned_mps", "q_ned_frd")
    if model is None or table is None or not {*parts, "on_ground"} <= table.columns.keys():
        return None
    residual = true_residual_frd_mps2(model, *(np.asarray(table[part], dtype=np.float64) for part in parts))
    residual[np.asarray(table["on_ground"], dtype=bool)] = np.nan  # there the ground carries
    return samples(source.seconds(table.t_us), residual)


def _barrier(source: LogSource) -> Barrier | None:
    """What the filter said, and the state that it kept inside the regions."""
    h, status, changed = (source.signal("/filter", name) for name in ("h", "status", "intervened"))
    if status is None or changed is None:
        return None
    if h is None:  # nothing was ever certified
        h = ReportSamples(status.t_s, np.full_like(status.values, np.nan))
    scenario = _scenario(source.log)
    judged_by_scenario = scenario is not None and "certificate" not in source.log.metadata.get("settings", {})
    return Barrier(
        h=h,
        status=status,
        intervened=changed,
        h_state=source.signal("/filter", "h_state"),
        margins_ned_ps=source.signal("/filter", "margins_ned_ps"),
        wanted_acc_ned_mps2=source.signal("/filter", "wanted_acc_ned_mps2"),
        safe_acc_ned_mps2=source.signal("/filter", "safe_acc_ned_mps2"),
        low_ned_mps2=source.signal("/filter", "low_ned_mps2"),
        high_ned_mps2=source.signal("/filter", "high_ned_mps2"),
        state=_state(source),
        region=scenario.region if scenario is not None and judged_by_scenario else None,
        certificates=_certificates(source.log),
        site=_site(source.log),
    )


def _state(source: LogSource) -> ReportSamples | None:
    """(n, 6) position relative to the start and velocity: the true ones, or else the estimated ones."""
    for topic in ("/truth", "/tick"):
        position, velocity = source.signal(topic, "pos_ned_m"), source.signal(topic, "vel_ned_mps")
        if position is not None and velocity is not None:
            start = _at_zero(position)
            shifted = position.values if start is None else position.values - start
            return ReportSamples(
                position.t_s, np.concatenate([shifted, signals.resample(velocity, position.t_s)], axis=1)
            )
    return None


def _site(log: Log) -> tuple[F64, ...]:
    """The lines of the site; none where the log has no site, or one that can't be read."""
    data = log.attachment(SITE_OUTLINES)
    try:
        lines = [] if data is None else json.loads(data)["lines"]
        return tuple(np.array(line, dtype=np.float64).reshape(-1, 2) for line in lines)
    except (ValueError, KeyError, TypeError):
        return ()


def _certificates(log: Log) -> tuple[Certificate, ...]:
    """The certificate that the flight began with and the last one; those that can't be read are left out."""
    found: list[Certificate] = []
    for name in (CERTIFICATE, FINAL_CERTIFICATE):
        data = log.attachment(name)
        try:
            if data is not None:
                found.append(parse_certificate(data.decode("utf-8", errors="replace"), name))
        except InputError:
            continue
    same = len(found) == 2 and found[0].version == found[1].version
    return tuple(found[1:] if same else found)


def _with_limits(report: FlightReport, log: Log, model: Model | None) -> FlightReport:
    """The report with the limits and the region that the log's own scenario and vehicle files give."""
    scenario = _scenario(log)
    if scenario is None:
        return report
    given = scenario.region
    region = None
    if given is not None:
        region = ReportRegion(
            "ellipsoid" if given.kind == "ellipsoid" else "box", given.centre_ned_m, given.semi_axes_m
        )
    thrust = None if model is None else model.thrust_range_n(scenario.limits)
    return replace(report, region=region, thrust_limits_n=thrust, rate_limit_frd_radps=scenario.limits.rate_max_radps)


def _timing(source: LogSource, result: Mapping[str, object] | None) -> Timing | None:
    stated = timing_from_result(result)
    lateness = source.signal("/timing", "lateness_us")
    if lateness is None:
        return stated
    late = lateness.values[np.isfinite(lateness.values)]
    if stated is not None:
        return replace(stated, lateness_us=late)
    missed = source.signal("/timing", "missed")
    p50, p99 = np.percentile(late, [50.0, 99.0])
    total = None if missed is None else int(np.nanmax(missed.values))
    return Timing(None, float(p50), float(p99), float(late.max()), total, late)


def _outcome(log: Log, result: Mapping[str, object] | None, timing: Timing | None) -> Outcome:
    """What the result says; where it is silent, the log's settings."""
    outcome = outcome_from_result(result)
    settings = log.metadata.get("settings", {})
    name = log.path.name if log.kind != "mcap" else "flight"
    pace = settings.get("pace")
    seed = settings.get("seed", "")
    lockstep = outcome.lockstep
    if timing is not None:
        lockstep = False
    elif lockstep is None and pace is not None:
        lockstep = pace == "lockstep"
    return replace(
        outcome,
        scenario=outcome.scenario if outcome.scenario != "flight" else settings.get("scenario", name),
        seed=outcome.seed if outcome.seed is not None else int(seed) if seed.isdecimal() else None,
        plant=outcome.plant or settings.get("plant"),
        controller=outcome.controller or settings.get("controller"),
        lockstep=lockstep,
    )


def _settings(log: Log) -> tuple[tuple[str, str], ...]:
    """Settings first, versions next, then whatever else the log's metadata holds; what is wrong with the log leads."""
    names: list[str] = [name for name in ("settings", "versions") if name in log.metadata]
    names += sorted(name for name in log.metadata if name not in (*names, "log", PARAMETERS))
    rows = [("log", f"not whole: {note}") for note in log.notes]
    rows += [(key.replace("_", " "), value) for name in names for key, value in log.metadata[name].items() if value]
    rows += parameters(log)
    return tuple(rows)
