"""What a flight's report shows: one frozen object that knows nothing of files, topics or HTML.

Everything but the outcome may be missing (`None` or empty): its panel then says "not recorded".  All times are seconds
on one axis whose zero is the start of the take-off; frames are NED and FRD, quaternions scalar first, body to world.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flightstack.barrier.records import Certificate
from flightstack.calibration import Conformal
from flightstack.region import Region as SafeRegion
from flightstack.types import F64, Tuple3


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """A signal over time: `t_s` (n,) ascending seconds, `values` (n, k); NaN marks what is unknown."""

    t_s: F64
    values: F64

    def __post_init__(self) -> None:
        if self.t_s.ndim != 1 or self.values.ndim != 2 or len(self.t_s) != len(self.values):
            raise ValueError(f"Samples needs t_s (n,) and values (n, k); got {self.t_s.shape} and {self.values.shape}")


@dataclass(frozen=True, slots=True)
class Phase:
    """A named part of the flight: takeoff, approach, track, landing."""

    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class FlightEvent:
    """Something that happened: a mode change, arming, a text of the autopilot."""

    t_s: float
    kind: str
    text: str
    severity: str = "info"
    """info, warning or error."""


@dataclass(frozen=True, slots=True)
class Region:
    """Where the vehicle has to stay: a box or an ellipsoid with axes along north, east and down."""

    shape: str
    """box or ellipsoid."""
    centre_ned_m: Tuple3
    half_ned_m: Tuple3


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """How punctual a real-time loop was; `lateness_us` (n,) is the wake-up after each deadline."""

    rate_hz: float | None
    p50_us: float | None
    p99_us: float | None
    max_us: float | None
    missed: int | None
    lateness_us: F64 | None = None


@dataclass(frozen=True, slots=True)
class CheckResult:
    """A check of the scenario and whether it held."""

    words: str
    value: float | None
    passed: bool


@dataclass(frozen=True, slots=True, eq=False)
class Learning:
    """What the learner said, tick by tick, and what was so; residual specific forces in body axes, m/s^2."""

    residual_frd_mps2: Samples
    """(n, 3) expected."""
    bound_frd_mps2: Samples
    """(n, 3) half the width of what it stands for: three standard deviations."""
    stage: Samples
    """(n, 1) 0..4, as `flightstack.calibration.STAGES`."""
    target_frd_mps2: Samples | None = None
    """(n, 3) as measured; NaN at ticks without a sample."""
    truth_frd_mps2: Samples | None = None
    """(n, 3) the true one, in the air."""
    thrust_gain: Samples | None = None
    """(n, 1) delivered over believed thrust per mass."""
    thrust_gain_bound: Samples | None = None
    """(n, 1) three of its standard deviations."""
    confidence: Samples | None = None
    """(n, 1) share of the prior's variance that the data have removed."""


@dataclass(frozen=True, slots=True, eq=False)
class Barrier:
    """What the barrier filter said, tick by tick, and what it kept to; axes are north, east, down."""

    h: Samples
    """(n, 1) least barrier value of the predicted state."""
    status: Samples
    """(n, 1) 0..6, as `logs.topics.FILTER_STATUS`."""
    intervened: Samples
    """(n, 1) 1 where the command was changed."""
    h_state: Samples | None = None
    """(n, 1) at the measured position and velocity."""
    margins_ned_ps: Samples | None = None
    """(n, 3) of the barrier condition at its best command."""
    wanted_acc_ned_mps2: Samples | None = None
    """(n, 3)."""
    safe_acc_ned_mps2: Samples | None = None
    """(n, 3)."""
    low_ned_mps2: Samples | None = None
    """(n, 3) least that the barriers allow."""
    high_ned_mps2: Samples | None = None
    state: Samples | None = None
    """(n, 6) position relative to the start and velocity: the true ones where they are known."""
    region: SafeRegion | None = None
    """The scenario's."""
    certificates: tuple[Certificate, ...] = ()
    """The one that the flight began with and the last one, where the log has them."""
    site: tuple[F64, ...] = ()
    """(n, 2) lines of the site, north and east from the start: the one to stay in, then those to keep out of."""


@dataclass(frozen=True, slots=True)
class FilterOutcome:
    """What the result says of the filter (its `barrier`, `qp` and `region`); `None` where it is not said."""

    min_h_truth: float | None = None
    min_h_estimate: float | None = None
    engaged_s: float | None = None
    infeasible: int | None = None
    solve_p50_us: float | None = None
    solve_p99_us: float | None = None
    solve_edges_us: tuple[float, ...] = ()
    """Edges of the histogram's bins, one more than there are bins."""
    solve_counts: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class LearnerOutcome:
    """What the result says of the learner (its `gp`); `None` where it is not said."""

    enabled: bool
    points: int | None = None
    fed: int | None = None
    step_p50_us: float | None = None
    step_p99_us: float | None = None
    coverage: float | None = None
    """Share of ticks and axes in which the true residual lay within three sigma."""
    coverage_axes: tuple[float | None, ...] = ()
    coverage_simultaneous: float | None = None
    conformal: Conformal | None = None
    thrust_gain: float | None = None
    changes: int | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """The flight's result (`flightstack.flight/1`) as the report needs it; `None` where it is not said."""

    scenario: str = "flight"
    completed: bool | None = None
    reason: str = ""
    seed: int | None = None
    plant: str | None = None
    controller: str | None = None
    flight_time_s: float | None = None
    realtime_factor: float | None = None
    tracking_of: str | None = None
    rmse_m: float | None = None
    max_m: float | None = None
    rmse_settled_m: float | None = None
    barrier_enabled: bool | None = None
    barrier_min_h: float | None = None
    barrier_violations: int | None = None
    barrier_interventions: int | None = None
    learner: LearnerOutcome | None = None
    filter: FilterOutcome = FilterOutcome()
    lockstep: bool | None = None
    """True where the simulator's clock was the clock, so that lateness has no meaning."""
    checks: tuple[CheckResult, ...] = ()
    passed: bool | None = None
    """The flight's own verdict on all of it."""
    protection: str = ""
    """held, left, none or off; empty where it is not said."""
    protection_words: str = ""
    disagreement_mps: tuple[float, ...] = ()
    """d(position)/dt less velocity of the estimate, rms north, east, down."""
    control_rmse_settled_m: float | None = None
    """Of the estimated position from the reference."""


@dataclass(frozen=True, slots=True, eq=False)
class FlightReport:
    """Everything the page shows.  Shapes (n, k) are those of `Samples.values`."""

    outcome: Outcome
    phases: tuple[Phase, ...] = ()
    events: tuple[FlightEvent, ...] = ()
    region: Region | None = None
    reference_ned_m: Samples | None = None
    """(n, 3) the scenario's reference, not the nominal that chases the vehicle; positions are relative to the start."""
    estimate_ned_m: Samples | None = None
    """(n, 3)."""
    truth_ned_m: Samples | None = None
    """(n, 3)."""
    estimate_error_ned_m: Samples | None = None
    """(n, 3) estimate minus truth."""
    estimate_q_ned_frd: Samples | None = None
    """(n, 4)."""
    truth_q_ned_frd: Samples | None = None
    """(n, 4)."""
    thrust_command_n: Samples | None = None
    """(n, 1) total thrust."""
    thrust_feedforward_n: Samples | None = None
    """(n, 1)."""
    thrust_truth_n: Samples | None = None
    """(n, 1) sum of what the rotors really delivered."""
    thrust_saturated: Samples | None = None
    """(n, 1), 1 where the command was cut to its limit."""
    thrust_limits_n: tuple[float, float] | None = None
    rate_command_frd_radps: Samples | None = None
    """(n, 3)."""
    rate_measured_frd_radps: Samples | None = None
    """(n, 3)."""
    rate_truth_frd_radps: Samples | None = None
    """(n, 3)."""
    rate_limit_frd_radps: Tuple3 | None = None
    motors: Samples | None = None
    """(n, 4) normalised commands, 0..1."""
    learning: Learning | None = None
    barrier: Barrier | None = None
    timing: Timing | None = None
    settings: tuple[tuple[str, str], ...] = ()
    """Name and value: vehicle, scenario, seed, versions, git commit."""

    @property
    def flown_ned_m(self) -> Samples | None:
        """What tracking is judged by: the truth where there is one, else the estimate."""
        return self.truth_ned_m if self.truth_ned_m is not None else self.estimate_ned_m

    def phase(self, name: str) -> Phase | None:
        """The phase of that name, or None."""
        return next((phase for phase in self.phases if phase.name == name), None)


def outcome_from_result(result: Mapping[str, object] | None) -> Outcome:
    """The result's JSON object as an `Outcome`; whatever is missing or of the wrong kind is unknown, never an error."""
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
    barrier, qp, region = (_part(result, name) for name in ("barrier", "qp", "region"))
    solve, histogram = _part(qp, "solve_us"), _part(qp, "histogram")
    edges, counts = (_numbers(histogram.get(key)) for key in ("edges_us", "counts"))
    if len(edges) != len(counts) + 1 or not any(counts) or min(counts) < 0.0 or edges[-1] < 10.0:
        edges = counts = ()
    return FilterOutcome(
        min_h_truth=_number(barrier.get("min_h_truth")),
        min_h_estimate=_number(barrier.get("min_h_estimate")),
        engaged_s=_number(region.get("engaged_s")),
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


def samples(t_s: object, values: object) -> Samples | None:
    """Samples of array-likes, ascending in time; (n,) values become (n, 1); None where nothing finite is in them."""
    t = np.asarray(t_s, dtype=np.float64).reshape(-1)
    v = np.asarray(values, dtype=np.float64)
    if t.size == 0 or v.shape[:1] != t.shape or v.ndim > 2:
        return None
    v = v.reshape(len(t), -1)
    good = np.isfinite(t)
    t, v = t[good], np.where(np.isfinite(v[good]), v[good], np.nan)
    if not np.isfinite(v).any():
        return None
    if (np.diff(t) < 0.0).any():
        order = np.argsort(t, kind="stable")
        t, v = t[order], v[order]
    return Samples(t, v)


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
