"""The barrier filter of a flight, seen from outside: how long its steps take, what it kept to, and whether it held.

h of the judged region is the scenario's (`Region.value`) where the flight keeps to a region of its scenario, and the
certificate's (`certified_values`) where it was given a certificate: the least h over its axes at plain position and
velocity, of the certificate that was in force at the tick.  Neither is the filter's own word.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from flightstack.barrier.certifier_config import Elsewhere
from flightstack.barrier.falsify import Witness, marked, prepare
from flightstack.barrier.growing import GrowthState
from flightstack.barrier.lateness import carried_off
from flightstack.barrier.provenance import Trail
from flightstack.barrier.records import Certificate
from flightstack.barrier.shapes import values_at
from flightstack.cli.column import Column
from flightstack.cli.result import NO_BARRIER, NO_QP, percentiles
from flightstack.governor import GovernorLimits
from flightstack.learning.learner import LearnerState
from flightstack.model import Model
from flightstack.region import Region
from flightstack.rows import F_ENDED_BY, F_INTERVENED, F_PREMISE, F_STATUS
from flightstack.seams import Certifier, SafetyFilter
from flightstack.types import F64, I64, Command, Filtered, FlatOutput, Learned, Measurement
from flightstack_logs.report.histogram import counts, edges_us

ENGAGE_H = 0.05
ENGAGE_US = 500_000
"""The region counts once h has been at least ENGAGE_H for so long."""
AS_PUBLISHED = "as-published"
"""Mode of a certificate that is one ellipsoid over all axes."""
ENGAGED = SOLVED = 2.0
"""From this status on the filter has solved its problem."""
FALLBACKS = (4.0, 5.0)
"""Statuses of a problem without a solution: infeasible, not solved within the budget."""


_GAP_S = 0.1
"""Between two ticks: in a longer one somebody else flew."""


class SiteSummary(Protocol):
    """The score of a site."""

    def summary(self) -> dict[str, Any]:
        """What the JSON's `barrier` gains."""
        ...


class TimedFilter:
    """A filter whose steps are timed; the core has no clock, and nothing of this goes into the log."""

    def __init__(self, safety_filter: SafetyFilter) -> None:
        self.enabled = safety_filter.enabled
        self.solve_ns = Column()
        """Wall time of each step that solved its problem, since the last `init`."""
        self._filter = safety_filter

    def init(self, origin_ned_m: F64) -> object:
        """The filter's own; the steps before it (warming up) are forgotten."""
        self.solve_ns = Column()
        return self._filter.init(origin_ned_m)

    def governed(self, state: object) -> GovernorLimits | None:
        """The filter's own."""
        return self._filter.governed(state)

    def in_force(self, state: object) -> F64 | None:
        """The filter's own."""
        return self._filter.in_force(state)

    def bend(self, state: object, setpoint: FlatOutput) -> FlatOutput:
        """The filter's own."""
        return self._filter.bend(state, setpoint)

    def adopt(self, state: object, certificate: Certificate) -> object:
        """The filter's own."""
        return self._filter.adopt(state, certificate)

    def step(
        self, state: object, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[object, Command, Filtered]:
        """The filter's own, timed."""
        began = time.perf_counter_ns()
        after = self._filter.step(state, measurement, command, sent, learned)
        took = time.perf_counter_ns() - began
        if after[2].row.item(F_STATUS) >= SOLVED:
            self.solve_ns.append(took)
        return after


class GivenCertificate:
    """A certifier that gives one certificate at the first tick, and watches whether it holds once the filter engages.

    Where it does not (another vehicle, another load or wind than it was learned with), there is no other: it says so.
    """

    enabled = True

    def __init__(self, certificate: Certificate, model: Model) -> None:
        self.certificate, self.model = certificate, model
        prepare()

    def init(self) -> Witness | None:
        """Not given yet."""
        return None

    def step(
        self, state: object, learner: object, measurement: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[object, Certificate | None]:
        """The certificate, and, if need be, its end."""
        if not isinstance(state, Witness):
            return (state, None) if state else (Witness(), self.certificate)
        if not filtered.status >= ENGAGED:
            return state, None
        reason, _ = state.observe(self.certificate, self.model, measurement, learned)
        if not reason:
            return state, None
        return True, marked(self.certificate, reason, hand_over=True, version=self.certificate.version + 1)


class WatchedCertifier:
    """A certifier whose certificates are kept, for the score and the log.

    `stamp` is added to what they rest on: the vehicle that they are for, which the core does not know.  `elsewhere` is
    where it has the work done, if it does not do that itself.
    """

    def __init__(
        self, certifier: Certifier, stamp: Mapping[str, object] | None = None, elsewhere: Elsewhere | None = None
    ) -> None:
        self.enabled, self.elsewhere = certifier.enabled, elsewhere
        self._stamp = dict(stamp or {})
        self.adopted: list[Certificate] = []
        """Since the last `init`, in their order."""
        self.trail = Trail()
        """Of the flight's ticks: what a certificate made in flight names as its log."""
        self.seen: tuple[object, object, Learned] | None = None
        """The certifier's state, the learner's and what it said, as of the last tick; None where none was."""
        self._seeing = True
        self._certifier = certifier
        self.contradicted: Callable[[], str] = lambda: ""
        """What the vehicle says against what certificates count on, in words; empty where nothing."""
        self.hindrance = ""
        """What of that was found; from then on nothing is certified, and what was is handed over."""

    def init(self) -> object:
        """The certifier's own; certificates before it (warming up) are forgotten."""
        self.adopted, self.seen, self._seeing, self.hindrance = [], None, True, ""
        self.trail.begin()
        return self._certifier.init()

    def step(
        self, state: object, learner: object, measurement: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[object, Certificate | None]:
        """The certifier's own, for as long as nothing contradicts what it counts on."""
        self.hindrance = self.hindrance or self.contradicted()
        if self.hindrance:
            return state, self._handed_over()
        after, certificate = self._certifier.step(state, learner, measurement, learned, filtered)
        if self._seeing:
            self.seen = after, learner, learned
        if certificate is not None:
            certificate = self.stamped(certificate)
            self.adopted.append(certificate)
        return after, certificate

    def _handed_over(self) -> Certificate | None:
        """The certificate in force, marked once as one that holds no more; None where there is none."""
        held = self.adopted[-1] if self.adopted else None
        if held is None or "falsified" in held.knowledge:
            return None
        ended = marked(held, self.hindrance, hand_over=True, version=held.version + 1)
        self.adopted.append(ended)
        return ended

    def look_away(self) -> None:
        """From now on `seen` stays as it is: a landing, in which others give the commands, contradicts every bound."""
        if self.seen is not None and self._seeing:
            state, learner, learned = self.seen
            if isinstance(state, GrowthState):
                state = replace(state, inner=copy(state.inner))
            if isinstance(learner, LearnerState):
                learner = learner.evidence()
            self.seen, self._seeing = (state, learner, learned), False

    def stamped(self, certificate: Certificate) -> Certificate:
        """The same, made for the vehicle of `stamp` and in this flight, where its points are of this flight."""
        premises, stamped = certificate.premises, {**certificate.knowledge, **self._stamp}
        if premises is not None:
            premises = replace(premises, vehicle_hash=str(stamped.get("vehicle_hash", "")))
        provenance = certificate.provenance
        if provenance is None and "sha256" in stamped:
            provenance = self.trail.provenance()
        return replace(certificate, knowledge=stamped, premises=premises, provenance=provenance)


def certified_values(certificate: Certificate, states: F64) -> F64:
    """(n,) h at positions relative to the start and velocities (n, 6): the least over the certificate's axes.

    As published its axes are the terms of one ellipsoid, h = 1 - sum (1 - h_i).
    """
    values = [
        values_at(axis.barrier.rows, states[:, axis.axis :: 3] - [certificate.centre_ned_m[axis.axis], 0.0])
        for axis in certificate.axes
    ]
    if certificate.mode == AS_PUBLISHED:
        return np.asarray(1.0 - sum(1.0 - value for value in values))
    return np.asarray(np.min(values, axis=0))


@dataclass(slots=True)
class RegionScore:
    """h of the judged region, tick by tick from take-off to the command to land."""

    region: Region | None
    """The scenario's; None: that of the certificate in force."""
    certifier: WatchedCertifier | None = None

    @property
    def of(self) -> str | None:
        """Which region is judged: scenario, certificate or none."""
        if self.region is not None:
            return "scenario"
        return "certificate" if self.certifier is not None else None

    def summary(self, t_us: F64, in_force: I64, states: F64, true_states: F64 | None) -> dict[str, Any]:
        """Which region, from when on it counts (s after take-off), the least h then, ticks outside.

        Of n ticks: how many certificates had come, position relative to the start and velocity (n, 6), as estimated
        and as they were.  Null where it is not known: without a truth, and where h never was what it begins to count
        from.
        """
        found: dict[str, Any] = {"of": self.of, "engaged_s": None, "min_h_truth": None, "min_h_estimate": None}
        found["violations"] = found["left_s"] = None
        if self.of is None:
            return found
        start = engaged_from(t_us, estimated := self._values(in_force, states))
        if start is None:
            return found
        since_s = (t_us[start:] - t_us[0]) * 1e-6
        found["engaged_s"] = float(since_s[0])
        found["min_h_estimate"] = _least(estimated[start:])
        if true_states is not None:
            true = self._values(in_force, true_states)[start:]
            outside = np.flatnonzero(true < 0.0)
            found["min_h_truth"], found["violations"] = _least(true), len(outside)
            found["left_s"] = float(since_s[outside[0]]) if len(outside) else None
        return found

    def _values(self, in_force: I64, states: F64) -> F64:
        if self.region is not None:
            return self.region.values(states[:, :3], states[:, 3:])
        found = np.full(len(states), math.nan)
        for number, certificate in enumerate(self.certifier.adopted if self.certifier is not None else (), start=1):
            found[in_force == number] = certified_values(certificate, states[in_force == number])
        return found


def engaged_from(t_us: Sequence[float] | F64, h: F64) -> int | None:
    """The first tick at whose end h has been at least ENGAGE_H for ENGAGE_US; None where it never was."""
    since: float | None = None
    for i, (now_us, value) in enumerate(zip(t_us, h.tolist(), strict=True)):
        if not value >= ENGAGE_H:
            since = None
        elif since is None:
            since = now_us
        if since is not None and now_us - since >= ENGAGE_US:
            return i
    return None


def _least(values: F64) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.min()) if known.size else None


@dataclass(slots=True)
class FilterScore:
    """What the filter did, tick by tick from take-off to the command to land."""

    acting: int = 0
    """Ticks in which it was engaged, its fallbacks included."""
    interventions: int = 0
    infeasible: int = 0
    governed: int = 0
    """Engaged ticks in which the governor of rate commands changed the command."""
    premises_broken: int = 0
    """Engaged ticks in which a premise did not hold: as measured, or, of the estimate, by the truth."""
    spans: list[tuple[float, float]] = field(default_factory=list)
    """From when to when (s after take-off) the command was one that the certificate allows."""
    _ticks: int = 0
    _solved: int = 0
    _protecting: bool = False

    def add(self, flight_s: float, filtered: Filtered, *, climbing: bool, governed: bool = False) -> None:
        """One tick, `flight_s` after take-off began."""
        said = filtered.row.item
        status = said(F_STATUS)
        acting = status >= SOLVED
        self.acting += acting
        self.governed += governed and acting
        self.interventions += said(F_INTERVENED) == 1.0
        self.infeasible += status in FALLBACKS
        protecting = acting and status < FALLBACKS[0] and not said(F_ENDED_BY) > 0.0
        if not climbing:
            self._ticks += 1
            self._solved += protecting
        if protecting and self._protecting and flight_s - self.spans[-1][1] <= _GAP_S:
            self.spans[-1] = (self.spans[-1][0], flight_s)
        elif protecting:
            self.spans.append((flight_s, flight_s))
        self._protecting = protecting

    def judge(self, certificate: Certificate, premises: I64, off: F64 | None) -> None:
        """The premises at n ticks under a certificate, as `premises_of` each; `off` (n, 6): truth less estimate,
        position and velocity, None where unknown."""
        if certificate.premises is None:
            return
        strayed = off is not None and (np.abs(off) > np.concatenate(carried_off(certificate))).any(axis=1)
        self.premises_broken += int(np.count_nonzero((premises > 0) & (strayed | (premises > 1))))

    @property
    def engaged_share(self) -> float | None:
        """Share of the ticks after the climb in which it protected; None without one."""
        return self._solved / self._ticks if self._ticks else None


def premises_of(filtered: Filtered) -> int:
    """0: the filter was not engaged, 1: it was, 2: and a premise was broken as measured."""
    row = filtered.row
    return (1 + (row.item(F_PREMISE) > 0.0)) if row.item(F_STATUS) >= SOLVED else 0


def barrier_summary(
    enabled: bool, region: dict[str, Any], score: FilterScore, site: SiteSummary | None = None
) -> dict[str, Any]:
    """The JSON's `barrier`; all null where no filter flew."""
    if not enabled:
        return dict(NO_BARRIER)
    names = ("min_h_truth", "min_h_estimate", "violations")
    return {
        "enabled": True,
        **{name: region[name] for name in names},
        "interventions": score.interventions,
        "protected": [{"from_s": from_s, "to_s": to_s} for from_s, to_s in score.spans],
        "engaged_share": score.engaged_share,
        "governor_share": score.governed / score.acting if score.acting else None,
        "premises_broken": score.premises_broken,
        **({} if site is None else site.summary()),
    }


def qp_summary(safety_filter: SafetyFilter, infeasible: int) -> dict[str, Any]:
    """The JSON's `qp`; `histogram` has the lower edges and the counts of its bins, for the report."""
    if not safety_filter.enabled:
        return dict(NO_QP)
    solve_us = [ns * 1e-3 for ns in safety_filter.solve_ns] if isinstance(safety_filter, TimedFilter) else []
    edges = edges_us(np.array(solve_us or [0.0]))
    histogram = {"edges_us": edges.tolist(), "counts": counts(np.array(solve_us), edges)} if solve_us else None
    return {"solve_us": percentiles(solve_us), "infeasible": infeasible, "histogram": histogram}
