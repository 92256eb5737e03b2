"""`flightstack certify`: Algorithm 1 in flight, and what came of it.

From the region that is certified before take-off: hover, learn, certify, fly where the certificate is limited most,
and so on until it grows no more (`flightstack.explore`); everything through the barrier filter, over MAVLink/UDP.
The certificate in force at the end is written to a file, and the independent checker has the last word on it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from flightstack.barrier.certifier_config import CertifierConfig
from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.barrier.file import certificate_to_json
from flightstack.barrier.growing import VERTICAL, GrowingCertifier, GrowthState
from flightstack.barrier.initial import require_authority
from flightstack.barrier.published import NOT_ROBUST
from flightstack.barrier.records import Certificate
from flightstack.barrier.settle import settled, worst_area
from flightstack.certificate_check import check
from flightstack.cli import files
from flightstack.cli.barrier_score import WatchedCertifier
from flightstack.cli.certified import DOWN, CertifiedFigures, figures_of
from flightstack.cli.certified_page import page_of
from flightstack.cli.compiled import CERTIFY, compiled_first
from flightstack.cli.flight import FlyOptions, Setup, fly_setup, prepare
from flightstack.cli.protection import governor_for
from flightstack.cli.result import FlightResult
from flightstack.cli.sensors import error_statistics
from flightstack.explore import FALSIFIED, ExploreConfig, Explorer, ExploreState
from flightstack.learning.learner import LearnerState, Learnt
from flightstack.learning.stored import vehicle_hash
from flightstack.mission import Mission
from flightstack.stack import Stack
from flightstack.trajectory import hover
from flightstack.types import InputError, TickRecord
from flightstack.vehicle import Vehicle
from flightstack_logs.writer import Recorder
from flightstack_sim.grade import load_grade

TIME_LIMIT_S = 300.0
"""Of the exploration; it mostly ends by its own rule."""
CERTIFICATE = "certificate.json"
EXPLORE_S = "explore_s"
"""Setting of the log: how long may be explored, by the explorer's own rules."""


class ExplorationPlanner:
    """Hands the explorer's legs to the mission; lands when it is done."""

    def __init__(self, explorer: Explorer, certifier: WatchedCertifier) -> None:
        self.state: ExploreState | None = None
        self.from_us = self.to_us = -1
        """The exploration's first and last tick."""
        self._explorer, self._certifier = explorer, certifier

    def step(self, mission: Mission, t_s: float, record: TickRecord) -> Mission:
        """From the track's beginning on: hover at the region's centre, then leg after leg."""
        if t_s < mission.track_start_s:
            return mission
        reference = mission.reference(t_s)
        if self.state is None:
            self.state, self.from_us = self._explorer.init(t_s, reference.pos_ned_m), record.t_us
        self.to_us = record.t_us
        adopted = self._certifier.adopted
        self.state, leg = self._explorer.step(self.state, t_s, adopted[-1] if adopted else None, reference)
        if leg is not None:
            return mission.then(t_s, leg)
        if not self.state.ended:
            return mission
        self._certifier.look_away()
        return mission.stop(t_s)


@dataclass(slots=True)
class CertifyResult:
    """Everything `certify --json` says."""

    flight: FlightResult
    state: ExploreState | None
    figures: CertifiedFigures | None
    """None where nothing was certified."""
    certificate: str | None
    """Path of the file; None where there is none to rely on."""
    wall_time_s: float
    as_published: bool
    verdict: list[str] = field(default_factory=list)
    """What the independent checker said."""
    report: str | None = None
    adopted: list[Certificate] = field(default_factory=list)
    """Every certificate in its order, the settled one last."""
    span_us: tuple[int, int] = (-1, -1)
    """The exploration's first and last tick."""

    @property
    def passed(self) -> bool:
        """A certificate came out of a flight that kept inside it."""
        return not self.failure()

    @property
    def words(self) -> str:
        """How the exploration ended, and what the certificate is not."""
        ended = "the exploration did not begin"
        if self.state is not None:
            ended = self.state.ended or f"its time was up, after {1e-6 * (self.span_us[1] - self.span_us[0]):.0f} s"
        return f"{ended}; {NOT_ROBUST}" if self.as_published else ended

    def failure(self) -> str:
        """Why there is nothing to rely on, one line; empty where there is."""
        if not self.flight.completed:
            return self.flight.failure()
        if self.flight.left_region:
            return self.flight.left_region
        if self.state is None or self.state.failed:
            return self.words
        if self.certificate is None:
            return f"no certificate came out: {'; '.join(self.verdict) or self.words}"
        return self.flight.log_problem

    def as_json(self) -> dict[str, Any]:
        """The `flightstack.certify/1` object."""
        flight = self.flight
        return {
            "schema": "flightstack.certify/1",
            "mode": "as-published" if self.as_published else "sound",
            "plant": flight.plant,
            **(CertifiedFigures.nothing() if self.figures is None else self.figures.as_json()),
            "rounds": 0 if self.state is None else len(self.state.rounds),
            "exits": flight.barrier["violations"],
            "infeasible": flight.qp["infeasible"],
            "wall_time_s": self.wall_time_s,
            "certificate": self.certificate,
            "completed": flight.completed,
            "passed": self.passed,
            "reason": self.failure() or self.words,
            "flight_time_s": flight.flight_time_s,
            "checker": self.verdict,
            "growth": [] if self.state is None else [_round(row) for row in self.state.rounds],
            "log": flight.log,
            "report": self.report,
        }


def _round(row: Any) -> dict[str, Any]:
    return {
        "axis": row.axis, "time_s": row.t_s, "version": row.version, "area_m2ps": row.area_m2ps,
        "width_mps2": row.width_mps2, "target": row.target, "limit": row.limit,
    }  # fmt: skip


def prepare_certify(
    options: FlyOptions, certifier: CertifierConfig = VERTICAL, on_read: Callable[[], None] = lambda: None
) -> Setup:
    """The flight that explores the scenario's region; InputError where it can't be, or must not be flown.

    The vertical axis alone is certified, as the paper does, unless `certifier` says otherwise.  `on_read`: see
    `prepare`.
    """
    return explored(prepare(options, on_read), options, certifier)


def explored(setup: Setup, options: FlyOptions, config: CertifierConfig = VERTICAL) -> Setup:
    """The same of a flight that is prepared."""
    prepared = setup.flight
    scenario = prepared.scenario
    if scenario.region is None or scenario.knowledge is None:
        raise InputError(
            f"scenario {scenario.name}: to certify it needs a [region] and a [knowledge] of the vehicle before take-off"
        )
    require_authority(scenario.knowledge, prepared.stack.model, scenario.limits, f"scenario {scenario.name}: knowledge")
    if prepared.protection.watched is None:
        raise InputError(f"scenario {scenario.name}: {prepared.protection.words}")
    hovering = replace(
        scenario,
        trajectory=hover(scenario.region.centre_ned_m),
        duration_s=options.duration_s or TIME_LIMIT_S,
        checks=(),
    )
    # The flight is judged by the certificate in force, not by the region that it began with.
    protection, stack = replace(prepared.protection, region=None), prepared.stack
    if not options.as_published:
        governor = governor_for(prepared.believed, stack.model, stack.limits, options.grade(scenario))
        sensors = options.grade(scenario)
        estimate = estimate_bounds(error_statistics(load_grade(sensors)))
        config = replace(config, governor=governor, sensors=sensors, estimate=estimate)
        certifier = GrowingCertifier(
            stack.model, stack.limits, scenario.region, initial=scenario.knowledge, certifier=config
        )
        watched = WatchedCertifier(certifier, _stamp(prepared.believed))
        watched.trail = prepared.protection.watched.trail
        protection = replace(protection, certifier=watched)
        stack = Stack(
            stack.model, stack.limits, controller=stack.controller, learner=stack.learner, certifier=watched,
            safety_filter=stack.filter, governor=stack.governor,
        )  # fmt: skip
    return replace(setup, flight=replace(prepared, scenario=hovering, protection=protection, stack=stack))


def _stamp(believed: Vehicle) -> dict[str, object]:
    return {"vehicle": believed.name, "vehicle_hash": vehicle_hash(believed)}


def certify(
    options: FlyOptions,
    *,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None] = lambda share, phase: None,
    config: ExploreConfig | None = None,
) -> CertifyResult:
    """Explore, certify, write the files; InputError before anything moves, else a result."""
    setup = prepare_certify(options, on_read=compiled_first(on_progress, options.site, options.plant, CERTIFY))
    if config is None:
        told = setup.flight.with_more({EXPLORE_S: f"{setup.flight.scenario.duration_s:.12g}"})
        setup = replace(setup, flight=told)
    certifier = setup.flight.protection.watched
    assert certifier is not None
    began = time.perf_counter()
    out = options.out or files.new_run_folder("certify", options.seed)
    planner = ExplorationPlanner(Explorer(config), certifier)
    adopted: list[Certificate] = []

    def settle_in(log: Recorder, t_us: int) -> None:
        """While the log is open: it holds the certificate that comes out."""
        adopted.extend(certifier.adopted)
        if adopted and planner.state is not None and not planner.state.failed:
            on_progress(1.0, "settling")
            adopted.extend(settle(certifier, adopted[-1]))
        held = unfalsified(adopted)
        if held is not None:
            log.certificate(t_us, held)

    flight = fly_setup(
        setup, replace(options, out=out), planner=planner, stop_requested=stop_requested, on_progress=on_progress,
        at_end=settle_in,
    )  # fmt: skip
    _put_aside(flight, out / "flight.html")
    kept = flight.completed and not flight.left_region and planner.state is not None and not planner.state.failed
    (out / CERTIFICATE).unlink(missing_ok=True)  # of an earlier run: a run that failed leaves none
    path, verdict = write_certificate(adopted if kept else [], out / CERTIFICATE)
    figures = figures_of(adopted, setup) if adopted else None
    result = CertifyResult(flight, planner.state, figures, path, 0.0, options.as_published, verdict)
    result.adopted, result.span_us = adopted, (planner.from_us, planner.to_us)
    result.wall_time_s = time.perf_counter() - began
    if adopted:
        region = setup.flight.scenario.region
        limit_m = 0.0 if region is None else region.semi_axes_m[DOWN]
        _write_report(result, lambda: page_of(result, limit_m), out / "report.html")
    return result


def settle(certifier: WatchedCertifier, last: Certificate) -> list[Certificate]:
    """What the exploration has learned, designed with all the time it takes: larger on the worst slice, or nothing.

    As published there is nothing to settle, and after a bound was falsified nothing to rely on.
    """
    assert certifier.seen is not None
    state, learner, learned = certifier.seen
    alone = last.axes[0] if len(last.axes) == 1 else None
    if alone is None or not isinstance(state, GrowthState) or not isinstance(learner, LearnerState | Learnt):
        return []
    found = settled(
        GrowingCertifier.settled(state.certifier),
        learner,
        learned,
        alone.axis,
        version=last.version + 1,
        widen_mps2=state.inner.widen_mps2,
    )
    if found is None or worst_area(found.axes[0]) <= worst_area(alone):
        return []
    return [certifier.stamped(found)]


def unfalsified(adopted: list[Certificate]) -> Certificate | None:
    """The last certificate that no observation has falsified."""
    held = [certificate for certificate in adopted if not certificate.knowledge.get(FALSIFIED)]
    return held[-1] if held else None


def write_certificate(adopted: list[Certificate], path: Path) -> tuple[str | None, list[str]]:
    """The file of the last certificate that no observation has falsified, once the checker has accepted it.

    Its path and the checker's lines; no path where there is no such certificate.  What the checker refuses is kept
    beside it under another name, for whoever wants to know why.
    """
    held = unfalsified(adopted)
    if held is None:
        return None, []
    text = certificate_to_json(held)
    verdict = check(text)
    published = held.mode != "sound"  # nothing covers it: for the record only, and it says so itself
    target = path if verdict.valid or published else path.with_name("refused.json")
    files.write_text(target, text)
    return (str(path) if verdict.valid or published else None), list(verdict.lines)


def _put_aside(flight: FlightResult, path: Path) -> None:
    """The flight's own page beside the exploration's."""
    if flight.report is not None:
        flight.report = str(Path(flight.report).replace(path))


def _write_report(result: CertifyResult, page: Callable[[], str], path: Path) -> None:
    """The page of the exploration; `result.report` says where, or the flight's `report_problem` why not."""
    try:
        files.write_text(path, page())
        result.report = str(path)
    except (InputError, OSError) as error:
        result.flight.report_problem = f"no report: {error}"
