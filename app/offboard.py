"""`flightstack offboard`: the companion alone, in real time, against any PX4."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app import files
from app.compiled import ensure_compiled
from app.recorder import LogObserver
from app.result import FlightResult, LoopTiming, TrackingScore, judge
from flightstack.model import Model
from flightstack.scenario import Scenario
from flightstack.stack import Stack
from flightstack.types import TickRecord
from flightstack.vehicle import Vehicle
from flightstack.warmup import warm_up
from logs.threaded import ThreadedLog
from logs.topics import Attachment
from logs.writer import FlightLog, Recorder
from mavlink_bridge import messages
from mavlink_bridge.companion import Companion, CompanionConfig
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link
from mavlink_bridge.pace import Pace, undisturbed
from mavlink_bridge.transport.address import Transport, framing_for, open_address, parse_address
from mavlink_bridge.transport.clock import monotonic_us

PERIOD_US = 4_000
_LEAST_PERIOD_US = 500
_LAST_WORDS_S = 0.3
"""After the end the link stays open for so long, for the last command and its answer."""


@dataclass(frozen=True, slots=True)
class OffboardOptions:
    """What `offboard` was asked for; names as given on the command line."""

    connect: str
    scenario: str = "hover"
    waypoints: str | None = None
    vehicle: str | None = None
    arm: bool = False
    dry_run: bool = False
    heartbeat_timeout_s: float = 10.0
    duration_s: float | None = None
    log: Path | None = None
    out: Path | None = None


class EstimateScore:
    """Tracking scored on the vehicle's own estimate: there is no truth on a real vehicle."""

    def __init__(self, scenario: Scenario) -> None:
        self.score = TrackingScore("estimate")
        self.companion: Companion | None = None
        self._scenario = scenario

    def on_record(self, record: TickRecord) -> None:
        """One tick."""
        companion = self.companion
        if companion is None or companion.mission is None or companion.land_command_us >= 0:
            return
        track_s = (record.t_us - companion.flight_start_us) * 1e-6 - companion.mission.track_start_s
        if 0.0 <= track_s <= self._scenario.duration_s:
            position = record.measurement.pos_ned_m - companion.start_ned_m
            self.score.add(track_s, position, self._scenario.trajectory.at(track_s).pos_ned_m)


def offboard(
    options: OffboardOptions,
    *,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None] = lambda share, phase: None,
) -> FlightResult:
    """Fly a scenario on the vehicle at an address; InputError before anything moves, else a result."""
    scenario, scenario_file = files.load_scenario(options.scenario, options.waypoints)
    if options.duration_s is not None:
        scenario = scenario.with_duration(options.duration_s)
    believed, vehicle_file = files.load_vehicle(options.vehicle)
    stack = Stack(Model.from_vehicle(believed), limits=scenario.limits)
    ensure_compiled(lambda text: on_progress(0.0, text))
    messages.prepare()
    warm_up(stack, scenario)
    address = parse_address(options.connect)
    transport = open_address(address)
    try:
        out = options.out or files.new_run_folder(scenario.name, None)
        log_path = options.log or out / "flight.mcap"
        settings = {
            "scenario": scenario.name,
            "vehicle": believed.name,
            "connect": options.connect,
            "arm": str(options.arm),
            "dry_run": str(options.dry_run),
            "pace": "realtime",
            "duration_s": f"{scenario.duration_s:g}",
        }
        log = FlightLog.open(
            log_path,
            metadata={"settings": settings, "versions": files.versions()},
            attachments=[
                Attachment("scenario.toml", "application/toml", scenario_file.text.encode()),
                Attachment("vehicle.toml", "application/toml", vehicle_file.text.encode()),
            ],
            overwrite=True,
        )
        recorder = ThreadedLog(log)
        score = EstimateScore(scenario)
        observer = LogObserver(recorder, scenario, believed, truth=False, on_record=score.on_record)
        companion = Companion(
            Link(240, 191, framing=framing_for(address)),
            stack,
            scenario,
            observer,
            CompanionConfig(arm=options.arm, dry_run=options.dry_run, heartbeat_timeout_s=options.heartbeat_timeout_s),
        )
        observer.companion = score.companion = companion
        timing = LoopTiming(1_000_000 // PERIOD_US)
        started = time.perf_counter()
        try:
            with undisturbed():
                _loop(companion, transport, recorder, timing, stop_requested, on_progress)
        finally:
            recorder.close()
    finally:
        transport.close()
    wall_s = time.perf_counter() - started
    result = _result(companion, scenario, believed, score, timing, log, wall_s, options)
    files.write_flight_report(log_path, out / "report.html", result)
    return result


def _loop(
    companion: Companion,
    transport: Transport,
    log: Recorder,
    timing: LoopTiming,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None],
) -> None:
    pace = Pace(PERIOD_US)
    done_at_us = -1
    ticks = timing_seen = 0
    while True:
        lateness_us = pace.wait()
        now_us = monotonic_us()
        clock = companion.view.clock
        for data in transport.receive_all():
            log.mavlink("rx", clock.vehicle_us(now_us) if clock.synchronised else 0, data)
            companion.receive_datagram(data, now_us)
        companion.step(now_us)
        t_us = clock.vehicle_us(now_us) if clock.synchronised else 0
        for data in companion.link.datagrams_to_send():
            log.mavlink("tx", t_us, data)
            transport.send(data)
        if companion.state in (State.STREAMING, State.OFFBOARD, State.LANDING):
            timing.lateness_us.append(lateness_us)
            timing.missed += pace.missed - timing_seen
            log.write("/timing", t_us, (float(lateness_us), float(pace.busy_us()), timing.missed))
        timing_seen = pace.missed
        ticks += 1
        if ticks % 25 == 0:
            pace.period_us = max(_LEAST_PERIOD_US, PERIOD_US / max(1.0, clock.rate))
            if reason := stop_requested():
                companion.stop(reason)
            on_progress(_progress(companion, t_us), companion.phase)
        if companion.done:
            done_at_us = now_us if done_at_us < 0 else done_at_us
            if now_us - done_at_us > _LAST_WORDS_S * 1e6:
                return


def _progress(companion: Companion, t_us: int) -> float:
    if companion.mission is None:
        return 0.0
    return min(1.0, (t_us - companion.flight_start_us) * 1e-6 / companion.mission.track_end_s)


def _result(
    companion: Companion,
    scenario: Scenario,
    believed: Vehicle,
    score: EstimateScore,
    timing: LoopTiming,
    log: FlightLog,
    wall_s: float,
    options: OffboardOptions,
) -> FlightResult:
    flown_us = max(0, companion.last_t_us - companion.flight_start_us) if companion.flight_start_us >= 0 else 0
    tracking = score.score.summary()
    result = FlightResult(
        scenario=scenario.name,
        seed=None,
        log=str(log.path),
        completed=companion.completed or (options.dry_run and companion.state is State.STREAMING),
        reason=companion.reason,
        flight_time_s=flown_us * 1e-6,
        wall_time_s=wall_s,
        clock_time_s=wall_s * companion.view.clock.rate,
        plant=None,
        tracking=tracking,
        loop=timing.summary(),
        log_problem=log.failed or "",
    )
    if options.vehicle is None and options.duration_s is None and not options.dry_run:
        result.checks = [judge(check, result.as_json()) for check in scenario.checks]
    return result
