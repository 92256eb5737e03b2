"""A flight's result: what was measured, as `flightstack.flight/1` (docs: the contract's section 2.1)."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flightstack.cli.column import Column
from flightstack.cli.estimate_score import NO_ESTIMATE
from flightstack.cli.verdict import HELD, LEFT, OFF, spans_words
from flightstack.scenario import Check
from flightstack.types import F64, Tuple3
from flightstack_logs.topics import RESULT, Attachment

MEASURED = ("wall_time_s", "realtime_factor", "gp.step_us", "qp.solve_us", "qp.histogram", "loop.lateness_us",
            "loop.stalls")  # fmt: skip
"""Fields of fly's JSON that a clock gives, and what lies below them."""
_PLACES = ("log", "report")

Place = F64 | Tuple3


def relative(position_ned_m: Place, start_ned_m: Place) -> Tuple3:
    """A position seen from where the flight began."""
    north, east, down = position_ned_m if isinstance(position_ned_m, tuple) else position_ned_m.tolist()
    start_n, start_e, start_d = start_ned_m if isinstance(start_ned_m, tuple) else start_ned_m.tolist()
    return north - start_n, east - start_e, down - start_d


_AT_ONCE = 8_192
"""Positions; as objects they take twenty times as much."""


def distances_m(ones_ned_m: F64, others_ned_m: F64) -> F64:
    """(n,) between positions (n, 3), rounded as `math.dist` does."""
    found = Column()
    for k in range(0, len(ones_ned_m), _AT_ONCE):
        piece = slice(k, k + _AT_ONCE)
        found.extend(map(math.dist, ones_ned_m[piece].tolist(), others_ned_m[piece].tolist()))
    return found.table()


def tracking_summary(of: str, distance_m: F64) -> dict[str, Any]:
    """The JSON's `tracking`: distance (n,) from the scenario's reference while it is tracked; null figures where
    nothing was tracked."""
    if not len(distance_m):
        return {"of": of} | dict.fromkeys(("rmse_m", "max_m", "rmse_settled_m"))
    settled = distance_m[len(distance_m) // 2 :]
    return {
        "of": of,
        "rmse_m": float(np.sqrt(np.mean(distance_m**2))),
        "max_m": float(distance_m.max()),
        "rmse_settled_m": float(np.sqrt(np.mean(settled**2))),
    }


_STALLS_KEPT = 20


@dataclass(slots=True)
class LoopTiming:
    """What is known of a real-time loop's punctuality: the time between two ticks."""

    rate_hz: int
    lateness_us: Column = field(default_factory=Column)
    """Time between two ticks beyond the period, each."""
    missed: int = 0
    stalls: list[dict[str, Any]] = field(default_factory=list)
    """The longest ones: seconds between two ticks, and what kept the later one."""
    dead_man: dict[str, Any] | None = None
    """None: there can be none, simulator and companion being one process."""
    is_ahead: bool = False
    """The loop ran with real-time priority."""

    def tick(self, between_us: int, period_us: int) -> float:
        """Count a tick so long after the one before; how late it was, microseconds."""
        late_us = float(max(0, between_us - period_us))
        self.lateness_us.append(late_us)
        self.missed += int(late_us // period_us)
        return late_us

    def stall(self, between_us: int, words: str) -> None:
        """Remember a long one."""
        self.stalls.append({"s": 1e-6 * between_us, "cause": words})
        self.stalls.sort(key=lambda stall: -float(stall["s"]))
        del self.stalls[_STALLS_KEPT:]

    def summary(self) -> dict[str, Any]:
        """The JSON's `loop`."""
        return {
            "rate_hz": self.rate_hz, "lateness_us": percentiles(self.lateness_us), "missed": self.missed,
            "stalls": self.stalls, "dead_man": self.dead_man, "real_time_priority": self.is_ahead,
        }  # fmt: skip


def percentiles(values: Collection[float] | Column) -> dict[str, float | None]:
    """p50, p99 and maximum; null where there is nothing."""
    if not len(values):
        return dict.fromkeys(("p50", "p99", "max"))
    array = np.array(list(values), dtype=np.float64)
    return {"p50": float(np.percentile(array, 50)), "p99": float(np.percentile(array, 99)), "max": float(array.max())}


_NO_TIMES = percentiles(())
NO_LOOP: dict[str, Any] = {"rate_hz": None, "lateness_us": _NO_TIMES, "missed": None}
NO_BARRIER: dict[str, Any] = {"enabled": False} | dict.fromkeys(
    ("min_h_truth", "min_h_estimate", "violations", "interventions", "protected", "engaged_share", "governor_share",
     "premises_broken")
)  # fmt: skip
"""`protected`: from when to when (s after take-off) the filter kept to a certificate; `engaged_share`: its share of the
ticks from the end of the climb to the command to land; `governor_share`: of the engaged ticks, those in which the
governor of rate commands changed the command; `premises_broken`: engaged ticks in which one did not hold."""
NO_GP: dict[str, Any] = {
    "enabled": False, "points": None, "fed": None, "step_us": _NO_TIMES, **dict.fromkeys(
        ("coverage_3sigma", "coverage_3sigma_axes", "coverage_simultaneous", "conformal", "thrust_gain",
         "thrust_gain_sigma", "latency_s", "refused", "changes")
    ),
}  # fmt: skip
"""Every field of a learner, null; `conformal` is quantile_sigma, coverage_heldout, alpha."""
NO_QP: dict[str, Any] = {"solve_us": _NO_TIMES, "infeasible": None, "histogram": None}
NO_LINK: dict[str, Any] = {"round_trip_us": _NO_TIMES} | dict.fromkeys(
    ("command_latency_s", "received", "lost", "dropped", "signed")
)
"""The MAVLink link: TIMESYNC round trips by the local clock, how old the commands are that the motors follow (null: not
evident), messages, and how many were dropped for which reason."""
NO_REGION: dict[str, Any] = dict.fromkeys(
    ("of", "engaged_s", "min_h_truth", "min_h_estimate", "violations", "left_s", "filtered_ticks")
)
"""How the region was kept to, with a filter or without: `of` is scenario, certificate or null; times since take-off;
`filtered_ticks`: in so many the filter was engaged itself, under a certificate."""
_FIELDS = (
    "scenario", "seed", "log", "report", "completed", "passed", "protection", "protection_words", "reason", "flown",
    "flight_time_s", "wall_time_s", "realtime_factor", "plant", "controller", "tracking", "barrier", "gp", "qp",
    "region", "loop", "link", "estimator", "checks", "checklist", "parameters_set", "estimate", "contradictions",
)  # fmt: skip
"""Of `flightstack.flight/1`, in its order."""


@dataclass(slots=True)
class FlightResult:
    """Everything `fly --json` and `offboard --json` say."""

    scenario: str
    seed: int | None
    log: str | None
    completed: bool | None
    """None where nothing was to be flown (a dry run)."""
    reason: str
    flight_time_s: float
    """From take-off to disarmed, by the vehicle's clock."""
    wall_time_s: float
    """Of the whole run, connecting and checking included; the report is not."""
    clock_time_s: float
    """The same span by the vehicle's clock: simulated or, on a real vehicle, elapsed time."""
    plant: str | None
    controller: str
    tracking: dict[str, Any]
    gp: dict[str, Any]
    loop: dict[str, Any]
    barrier: dict[str, Any] = field(default_factory=lambda: dict(NO_BARRIER))
    qp: dict[str, Any] = field(default_factory=lambda: dict(NO_QP))
    region: dict[str, Any] = field(default_factory=lambda: dict(NO_REGION))
    link: dict[str, Any] = field(default_factory=lambda: dict(NO_LINK))
    estimator: dict[str, Any] = field(default_factory=lambda: dict(NO_ESTIMATE))
    flown: dict[str, Any] = field(default_factory=dict)
    """Heights and speed by which it counts as flown (`verdict.Flown`)."""
    protection: str = OFF
    """held, left, none or off (`verdict.protection_of`)."""
    unprotected_because: str = ""
    """Why nothing could be certified, or no longer; empty: nothing is known to be in the way."""
    filter_words: str = ""
    """What the barrier filter was, or why there was none."""
    unprotected_ok: bool = False
    """A flight that was not protected, or left, passes all the same."""
    report: str | None = None
    log_problem: str = ""
    """Why the log is not whole, one line; empty where it is."""
    report_problem: str = ""
    """Why there is no page though one was asked for, one line."""
    checks: list[dict[str, Any]] = field(default_factory=list)
    link_too_slow: bool = False
    """Refused before take-off: the certificate that was given does not hold for so slow a link."""
    contradictions: list[str] = field(default_factory=list)
    """What the vehicle said against its file, one line each: the file is refused."""
    estimate: dict[str, Any] | None = None
    """Error of the autopilot's own estimate on the globe, where the truth is known; None elsewhere."""
    parameters_set: list[dict[str, Any]] = field(default_factory=list)
    """What was set for the flight: name, before, set, restored."""
    checklist: list[dict[str, Any]] = field(default_factory=list)
    """Of a dry run: check, ok, said."""

    @property
    def passed(self) -> bool:
        """Not left undone, protected where that was asked for, the log whole, its page made and every check kept."""
        kept = self.completed is not False and not (self.unprotected or self.log_problem or self.report_problem)
        return kept and all(check["passed"] for check in self.checks) and all(check["ok"] for check in self.checklist)

    @property
    def unprotected(self) -> str:
        """Why protection that was asked for, and is not waived, does not count as held, one line; else empty."""
        if self.unprotected_ok or self.completed is None or self.protection in (HELD, OFF):
            return ""
        if self.protection == LEFT:
            return self.left_region
        if self.unprotected_because:
            return f"not protected: {self.unprotected_because}"
        return f"not protected: nothing was certified in time ({self.filter_words})"

    @property
    def left_region(self) -> str:
        """Where a filter flew and the region was left all the same: that, one line; else empty."""
        if self.protection != LEFT:
            return ""
        if exits := self.barrier.get("exits"):
            return f"left its site: the vehicle was outside in {exits} ticks"
        violations = self.barrier["violations"]
        if not violations:
            return f"left its region: h of the estimate fell to {self.barrier['min_h_estimate']:.3f}"
        left_s = self.region["left_s"]
        when = "" if left_s is None else f", first {left_s:.2f} s after take-off"
        least = f"least {self.barrier['min_h_truth']:.3f}"
        return f"left its region: h of the true state was below 0 in {violations} ticks ({least}){when}"

    def failure(self) -> str:
        """Why it did not pass, one line; empty where it did."""
        if self.completed is False:
            return self.reason or "the flight did not complete"
        if self.checklist and not self.checklist[-1]["ok"]:
            return str(self.checklist[-1]["said"])
        if self.unprotected:
            return self.unprotected
        return self.log_problem or self.report_problem or self._failed_checks()

    def _failed_checks(self) -> str:
        failed = [check for check in self.checks if not check["passed"]]
        return "; ".join(f"check failed: {check['words']} ({check['metric']} = {check['value']})" for check in failed)

    def miss_checks(self) -> None:
        """A flight as its scenario is written that failed one of its checks did not fly what was asked."""
        missed = self._failed_checks()
        if self.completed and missed:
            self.completed, self.reason = False, missed

    @property
    def why(self) -> str:
        """What went wrong in flight: why it does not count as flown, that it was not protected or left."""
        return "; ".join(part for part in (self.reason, self.unprotected or self.left_region) if part)

    @property
    def protection_words(self) -> str:
        """The protection in words: protected from t1 to t2, not protected, left, or off and why."""
        if self.protection == OFF:
            return self.filter_words if self.filter_words.startswith(OFF) else OFF
        told = spans_words([(span["from_s"], span["to_s"]) for span in self.barrier["protected"] or ()])
        return f"left ({told})" if self.protection == LEFT else told

    def attachment(self) -> Attachment:
        """What a log keeps of the result, so that its page can be made again: all but times and places of files."""
        text = json.dumps(steady(self.as_json()), indent=1) + "\n"
        return Attachment(RESULT, "application/json", text.encode())

    def as_json(self) -> dict[str, Any]:
        """The `flightstack.flight/1` object."""
        told = {name: getattr(self, name) for name in _FIELDS} | {"reason": self.why}
        return {"schema": "flightstack.flight/1", **told, "log_complete": not self.log_problem}

    @property
    def realtime_factor(self) -> float | None:
        """How much faster than the vehicle's clock it was; None where it took no time."""
        return self.clock_time_s / self.wall_time_s if self.wall_time_s > 0 else None


def is_measured(name: str) -> bool:
    """Whether a field, with dots, is what a clock gave, or lies below one."""
    return any(name == each or name.startswith(f"{each}.") for each in MEASURED)


def steady(result: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The result's object without what another run of the same flight changes: measured times, places of files."""
    return {
        key: steady(value, f"{prefix}{key}.") if isinstance(value, Mapping) else value
        for key, value in result.items()
        if not is_measured(f"{prefix}{key}") and f"{prefix}{key}" not in _PLACES
    }


def judge(check: Check, result: dict[str, Any]) -> dict[str, Any]:
    """One check of a scenario, held against a flight's JSON; a figure that is missing fails it."""
    value: Any = result
    for key in check.metric.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    known = isinstance(value, int | float)
    passed = known and (check.below is None or value < check.below) and (check.above is None or value > check.above)
    return {"words": check.words, "metric": check.metric, "value": value if known else None, "passed": bool(passed)}
