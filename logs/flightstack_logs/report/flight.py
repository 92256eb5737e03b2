"""What a flight's report shows: one frozen object that knows nothing of files, topics or HTML.

Everything but the outcome may be missing (`None` or empty): its panel then says "not recorded".  All times are seconds
on one axis whose zero is the start of the take-off; frames are NED and FRD, quaternions scalar first, body to world.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from flightstack.types import F64, Tuple3

if TYPE_CHECKING:
    from flightstack.barrier.records import Certificate
    from flightstack.calibration import Conformal
    from flightstack.region import Region as SafeRegion


@dataclass(frozen=True, slots=True, eq=False)
class ReportSamples:
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
class ReportRegion:
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

    residual_frd_mps2: ReportSamples
    """(n, 3) expected."""
    bound_frd_mps2: ReportSamples
    """(n, 3) half the width of what it stands for: three standard deviations."""
    stage: ReportSamples
    """(n, 1) 0..4, as `flightstack.calibration.STAGES`."""
    target_frd_mps2: ReportSamples | None = None
    """(n, 3) as measured; NaN at ticks without a sample."""
    truth_frd_mps2: ReportSamples | None = None
    """(n, 3) the true one, in the air."""
    thrust_gain: ReportSamples | None = None
    """(n, 1) delivered over believed thrust per mass."""
    thrust_gain_bound: ReportSamples | None = None
    """(n, 1) three of its standard deviations."""
    confidence: ReportSamples | None = None
    """(n, 1) share of the prior's variance that the data have removed."""


@dataclass(frozen=True, slots=True, eq=False)
class Barrier:
    """What the barrier filter said, tick by tick, and what it kept to; axes are north, east, down."""

    h: ReportSamples
    """(n, 1) least barrier value of the predicted state."""
    status: ReportSamples
    """(n, 1) 0..6, as `logs.topics.FILTER_STATUS`."""
    intervened: ReportSamples
    """(n, 1) 1 where the command was changed."""
    h_state: ReportSamples | None = None
    """(n, 1) at the measured position and velocity."""
    margins_ned_ps: ReportSamples | None = None
    """(n, 3) of the barrier condition at its best command."""
    wanted_acc_ned_mps2: ReportSamples | None = None
    """(n, 3)."""
    safe_acc_ned_mps2: ReportSamples | None = None
    """(n, 3)."""
    low_ned_mps2: ReportSamples | None = None
    """(n, 3) least that the barriers allow."""
    high_ned_mps2: ReportSamples | None = None
    state: ReportSamples | None = None
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
    protected_from_s: float | None = None
    """After take-off began, the filter kept to a certificate for the first time."""
    engaged_share: float | None = None
    """Of the ticks after the climb, those in which it did."""
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
class Recorded:
    """What the page of somebody else's log shows besides."""

    span_s: float
    vel_ned_mps: ReportSamples | None = None
    """(n, 3)."""
    accel_frd_mps2: ReportSamples | None = None
    """(n, 3) specific force."""
    battery_v: ReportSamples | None = None
    """(n, 1)."""


@dataclass(frozen=True, slots=True, eq=False)
class FlightReport:
    """Everything the page shows.  Shapes (n, k) are those of `Samples.values`."""

    outcome: Outcome
    phases: tuple[Phase, ...] = ()
    events: tuple[FlightEvent, ...] = ()
    region: ReportRegion | None = None
    reference_ned_m: ReportSamples | None = None
    """(n, 3) the scenario's reference, not the nominal that chases the vehicle; positions are relative to the start."""
    estimate_ned_m: ReportSamples | None = None
    """(n, 3)."""
    truth_ned_m: ReportSamples | None = None
    """(n, 3)."""
    estimate_error_ned_m: ReportSamples | None = None
    """(n, 3) estimate minus truth."""
    estimate_q_ned_frd: ReportSamples | None = None
    """(n, 4)."""
    truth_q_ned_frd: ReportSamples | None = None
    """(n, 4)."""
    thrust_command_n: ReportSamples | None = None
    """(n, 1) total thrust."""
    thrust_feedforward_n: ReportSamples | None = None
    """(n, 1)."""
    thrust_truth_n: ReportSamples | None = None
    """(n, 1) sum of what the rotors really delivered."""
    thrust_saturated: ReportSamples | None = None
    """(n, 1), 1 where the command was cut to its limit."""
    thrust_limits_n: tuple[float, float] | None = None
    rate_command_frd_radps: ReportSamples | None = None
    """(n, 3)."""
    rate_measured_frd_radps: ReportSamples | None = None
    """(n, 3)."""
    rate_truth_frd_radps: ReportSamples | None = None
    """(n, 3)."""
    rate_limit_frd_radps: Tuple3 | None = None
    motors: ReportSamples | None = None
    """(n, 4) normalised commands, 0..1."""
    learning: Learning | None = None
    barrier: Barrier | None = None
    timing: Timing | None = None
    recorded: Recorded | None = None
    """Of a log that this project did not write."""
    settings: tuple[tuple[str, str], ...] = ()
    """Name and value: vehicle, scenario, seed, versions, git commit."""

    @property
    def flown_ned_m(self) -> ReportSamples | None:
        """What tracking is judged by: the truth where there is one, else the estimate."""
        return self.truth_ned_m if self.truth_ned_m is not None else self.estimate_ned_m

    def phase(self, name: str) -> Phase | None:
        """The phase of that name, or None."""
        return next((phase for phase in self.phases if phase.name == name), None)


def samples(t_s: object, values: object) -> ReportSamples | None:
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
    return ReportSamples(t, v)
