"""A flight's result, `flightstack.flight/1`, as the report needs it: what is missing or of a wrong kind is unknown."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

from flightstack.calibration import Conformal
from flightstack_logs.report.flight import CheckResult, FilterOutcome, LearnerOutcome, Outcome, Timing
from flightstack_logs.tables import Log
from flightstack_logs.topics import RESULT


def kept_result(log: Log) -> Mapping[str, object] | None:
    """The result that the flight left in its log; None where there is none, or none that can be read."""
    data = log.attachment(RESULT)
    try:
        kept = None if data is None else json.loads(data)
    except (ValueError, RecursionError):
        return None
    return kept if isinstance(kept, dict) else None


def outcome_from_result(result: Mapping[str, object] | None) -> Outcome:
    """The result's JSON object as an `Outcome`; never an error."""
    if result is None:
        return Outcome()
    barrier, loop = _part(result, "barrier"), _part(result, "loop")
    tracking = _part(result, "tracking")
    completed = _flag(result.get("completed"))
    lateness = _part(loop, "lateness_us") if loop else {}
    min_h = _number(barrier.get("min_h_truth"))
    return Outcome(
        scenario=_text(result.get("scenario")) or "flight",
        completed=completed,
        passed=_flag(result.get("passed")),
        protection=_text(result.get("protection")) or "",
        protection_words=_text(result.get("protection_words")) or "",
        reason=""
        if completed and result.get("passed") is not False
        else _text(result.get("reason")) or _text(result.get("failure")) or "",
        seed=_whole(result.get("seed")),
        plant=_text(result.get("plant")),
        controller=_text(result.get("controller")),
        flight_time_s=_number(result.get("flight_time_s")),
        realtime_factor=_number(result.get("realtime_factor")),
        tracking_of=_text(tracking.get("of")),
        rmse_m=_number(tracking.get("rmse_m")),
        max_m=_number(tracking.get("max_m")),
        rmse_settled_m=_number(tracking.get("rmse_settled_m")),
        barrier_enabled=_flag(barrier.get("enabled")),
        barrier_min_h=min_h if min_h is not None else _number(barrier.get("min_h_estimate")),
        barrier_violations=_whole(barrier.get("violations")),
        barrier_interventions=_whole(barrier.get("interventions")),
        learner=_learner(_part(result, "gp")),
        filter=_filter(result),
        lockstep=_number(lateness.get("p50")) is None if loop else None,
        checks=_checks(result.get("checks")),
        disagreement_mps=_numbers(_part(result, "estimator").get("disagreement_rms_mps")),
        control_rmse_settled_m=_number(_part(result, "estimator").get("control_rmse_settled_m")),
    )


def _learner(gp: Mapping[str, object]) -> LearnerOutcome | None:
    enabled = _flag(gp.get("enabled"))
    if enabled is None:
        return None
    step, conformal, axes = _part(gp, "step_us"), _part(gp, "conformal"), gp.get("coverage_3sigma_axes")
    checked = [_number(conformal.get(key)) for key in ("quantile_sigma", "coverage_heldout", "alpha")]
    figures = [value for value in checked if value is not None]
    return LearnerOutcome(
        enabled=enabled,
        points=_whole(gp.get("points")),
        fed=_whole(gp.get("fed")),
        step_p50_us=_number(step.get("p50")),
        step_p99_us=_number(step.get("p99")),
        coverage=_number(gp.get("coverage_3sigma")),
        coverage_axes=tuple(_number(share) for share in axes) if isinstance(axes, list | tuple) else (),
        coverage_simultaneous=_number(gp.get("coverage_simultaneous")),
        conformal=Conformal(*figures) if len(figures) == len(checked) else None,
        thrust_gain=_number(gp.get("thrust_gain")),
        changes=_whole(gp.get("changes")),
    )


def _filter(result: Mapping[str, object]) -> FilterOutcome:
    barrier, qp = (_part(result, name) for name in ("barrier", "qp"))
    spans = barrier.get("protected")
    first = spans[0] if isinstance(spans, list) and spans and isinstance(spans[0], Mapping) else {}
    solve, histogram = _part(qp, "solve_us"), _part(qp, "histogram")
    edges, counts = (_numbers(histogram.get(key)) for key in ("edges_us", "counts"))
    if len(edges) != len(counts) + 1 or not any(counts) or min(counts) < 0.0 or edges[-1] < 10.0:
        edges = counts = ()
    return FilterOutcome(
        min_h_truth=_number(barrier.get("min_h_truth")),
        min_h_estimate=_number(barrier.get("min_h_estimate")),
        protected_from_s=_number(first.get("from_s")),
        engaged_share=_number(barrier.get("engaged_share")),
        infeasible=_whole(qp.get("infeasible")),
        solve_p50_us=_number(solve.get("p50")),
        solve_p99_us=_number(solve.get("p99")),
        solve_edges_us=edges,
        solve_counts=tuple(int(count) for count in counts),
    )


def _numbers(value: object) -> tuple[float, ...]:
    """A list of numbers; empty where it is anything else."""
    found = [_number(item) for item in value] if isinstance(value, list | tuple) else []
    numbers = tuple(item for item in found if item is not None)
    return numbers if len(numbers) == len(found) else ()


def timing_from_result(result: Mapping[str, object] | None) -> Timing | None:
    """The loop's punctuality as the result states it; None in lockstep, where its fields are null."""
    loop = _part(result or {}, "loop")
    lateness = _part(loop, "lateness_us")
    p50, p99, worst = (_number(lateness.get(key)) for key in ("p50", "p99", "max"))
    if p50 is None and p99 is None and worst is None:
        return None
    return Timing(_number(loop.get("rate_hz")), p50, p99, worst, _whole(loop.get("missed")))


def _checks(rows: object) -> tuple[CheckResult, ...]:
    if not isinstance(rows, list | tuple):
        return ()
    return tuple(
        CheckResult(_text(row.get("words")) or _text(row.get("metric")) or "check", _number(row.get("value")), passed)
        for row in rows
        if isinstance(row, Mapping) and (passed := _flag(row.get("passed"))) is not None
    )


def _part(of: Mapping[str, object], key: str) -> Mapping[str, object]:
    part = of.get(key)
    return part if isinstance(part, Mapping) else {}


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def _whole(value: object) -> int | None:
    number = _number(value)
    return None if number is None else int(number)


def _flag(value: object) -> bool | None:
    return value if isinstance(value, bool) else None


def _text(value: object) -> str | None:
    return value if isinstance(value, str) and value else None
