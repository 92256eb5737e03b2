"""`flightstack fly`: simulator and companion in one process, every message through UDP on loopback.

In lockstep the simulator's clock is the only clock: 4 ms are simulated, the datagrams go out, the companion waits for
just as many, ticks and answers, and the simulator waits for the answers.  No thread sleeps, nothing depends on the
machine, and the same seed gives the same log.  With `--realtime` the very same loop is paced by absolute deadlines.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace

from flightstack.autopilot import autopilot_of
from flightstack.cli import files
from flightstack.cli.compiled import JSBSIM, compiled_first
from flightstack.cli.filed import with_filed
from flightstack.cli.home import HOME, Home
from flightstack.cli.live_view import shown_live
from flightstack.cli.preparation import FlightOptions, Prepared, prepare_flight
from flightstack.cli.result import FlightResult, LoopTiming
from flightstack.cli.score import FlightScore
from flightstack.cli.sensors import error_statistics
from flightstack.cli.vehicle_gains import counted_on, tuned
from flightstack.dotted import changed_vehicle
from flightstack.scenario import Scenario
from flightstack.vehicle import Vehicle, vehicle_to_toml
from flightstack_logs.log_clock import LogClock, clock_metadata
from flightstack_logs.recorder import NoLog
from flightstack_logs.threaded import ThreadedLog
from flightstack_logs.writer import FlightLog, Recorder
from flightstack_sim.faults import Fault, parse_faults
from flightstack_sim.grade import Grade, changed_grade, load_grade
from flightstack_sim.plant import Truth
from flightstack_sim.server import UNIX_AT_BOOT_US, Server
from flightstack_sim.shell import ONBOARD, Shell
from flightstack_sim.simulated_vehicle import SimulatedVehicle, simulated_vehicle
from flightstack_sim.streams import LinkKind
from flightstack_sim.warmup import warm_up as warm_up_simulator
from mavlink_bridge import frequent
from mavlink_bridge.companion import Companion, CompanionConfig, MissionPlanner
from mavlink_bridge.link import MAX_DATAGRAM, Link
from mavlink_bridge.pace import Pace, undisturbed
from mavlink_bridge.transport.clock import utc_us
from mavlink_bridge.transport.udp import UdpSocket, connected_pair

TICK_MS = 4
LOCKSTEP_TIMEOUT_S = 2.0
FLIGHT_TIME_LIMIT_S = 180.0
"""Simulated time that a flight may take beyond its scenario before it counts as stuck."""
AFTERMATH_US = 60_000_000
"""After a fault the simulator goes on for so long after the companion's end, or until the vehicle is disarmed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlyOptions(FlightOptions):
    """What `fly` was asked for."""

    scenario: str = "paper-tracking"
    truth: str | None = None
    sensors: str | None = None
    seed: int = 0
    plant: str = "native"
    realtime: bool = False
    fault: str | None = None
    """As on the command line; see sim.faults."""
    home: Home = HOME
    hil_port: int = 4560
    """Of `--px4-hil`."""
    log_kept: bool = True
    """Not: nothing is written, and `log` in the result is null.  Of flights by the thousand."""
    beside: bool = True
    """Whether certificates are made in a process of their own; not where others fly on the other cores."""

    @property
    def in_real_time(self) -> bool:
        """See ProtectionOptions."""
        return self.realtime

    @property
    def as_written(self) -> bool:
        """The flight is the one that the scenario's checks were written for."""
        return self.stack_as_written and self.truth is None and self.sensors is None and self.fault is None

    @property
    def place(self) -> tuple[float, float] | None:
        """Where the simulator puts its vehicle."""
        return self.home.frame.latitude_deg, self.home.frame.longitude_deg

    def grade(self, scenario: Scenario) -> str:
        """Grade of the sensors that fly."""
        return self.sensors or scenario.sensors


@dataclass(frozen=True, slots=True)
class Setup:
    """A flight and the vehicle that flies it."""

    flight: Prepared
    truth: Vehicle
    grade: Grade
    plant: str = "native"
    faults: tuple[Fault, ...] = ()
    companion: CompanionConfig = field(default_factory=lambda: CompanionConfig(arm=True))


def prepare(options: FlyOptions, on_read: Callable[[], None] = lambda: None) -> Setup:
    """Read and check everything before anything moves; InputError with one line where something is wrong.

    on_read: called when the files are read and nothing else is done yet.
    """
    faults = parse_faults(options.fault)

    def known(scenario: Scenario, believed: Vehicle) -> Mapping[str, float]:
        return autopilot_of(believed, _truth(options, scenario, believed))

    # a site's certificate takes seconds: it is made once, for the gains that `offboard` reads from its vehicle
    flight = prepare_flight(options, {} if options.site is None else known, on_read)
    truth = _truth(options, flight.scenario, flight.believed)
    gains = autopilot_of(flight.believed, truth)
    if flight.protection.filter.enabled and tuned(flight.believed, gains) is not flight.believed:
        flight = prepare_flight(options, gains)
    scenario = flight.scenario
    sensors = options.grade(flight.scenario)
    settings = {
        "truth": truth.name,
        "seed": str(options.seed),
        "sensors": sensors,
        "plant": options.plant,
        "pace": "realtime" if options.realtime else "lockstep",
    }
    if faults:
        settings["fault"] = options.fault or ""
    carried = {"truth.toml": vehicle_to_toml(truth)}
    if options.plant == JSBSIM:
        from flightstack_sim.jsbsim.trial import try_out

        tried = try_out(truth, ((event.effect, dict(event.values)) for event in flight.scenario.events))
        settings["jsbsim"], carried["aircraft.xml"] = tried.version, tried.aircraft_xml
    grade = load_grade(sensors)
    flown = changed_grade(sensors, scenario.grade_changes, f"{scenario.name}: grade")
    most_s = flight.protection.round_trip_max_s
    counted = counted_on(flight.believed) if flight.protection.filter.enabled else {}
    companion = CompanionConfig(arm=True, round_trip_max_s=most_s, estimate=error_statistics(grade), counted=counted)
    return Setup(flight.with_more(settings, carried), truth, flown, options.plant, faults, companion)


def _truth(options: FlyOptions, scenario: Scenario, believed: Vehicle) -> Vehicle:
    """What really flies."""
    if options.truth is None:
        return scenario.truth_vehicle(believed)
    truth, _ = files.load_vehicle(options.truth)
    if options.truth == scenario.flight.get("truth"):
        truth = changed_vehicle(truth, scenario.truth.changes, scenario.name)
    return truth


_WARM: set[tuple[str, ...]] = set()
"""Kinds of flights that this process has warmed up for."""


def warm_up_all(setup: Setup) -> None:
    """Call once whatever is loaded or compiled at its first call, so that no flight has to wait for it."""
    frequent.prepare()
    setup.flight.warm_up()
    warm_up_simulator(setup.truth, setup.grade, setup.plant)


class SimulatedFlight:
    """One flight in the simulator; `run` flies it to its end."""

    def __init__(
        self,
        setup: Setup,
        options: FlyOptions,
        log: Recorder,
        planner: MissionPlanner | None = None,
        utc_us: int = UNIX_AT_BOOT_US,
    ) -> None:
        """`utc_us`: when the flight begins; in lockstep, which has no date of its own, the simulator's."""
        prepared = setup.flight
        self._clock = LogClock(log, zero_us=0, utc_us=utc_us)
        self.scenario = prepared.scenario
        self._log = log
        self.vehicle: SimulatedVehicle = simulated_vehicle(
            prepared.believed, setup.truth, setup.grade, seed=options.seed, plant=setup.plant,
            heading_rad=options.home.heading_rad,
        )  # fmt: skip
        self._ours, self._theirs = connected_pair()
        server = Server(self.vehicle, links=(LinkKind.ONBOARD,), frame=options.home.frame, faults=setup.faults)
        self.shell = Shell(server, (self._theirs,), options.seed)
        self.score = FlightScore(prepared, of="truth")
        observer = prepared.observer(log, self._clock, truth=True)
        observer.record_to = self.score.on_record
        stack, config = prepared.stack, setup.companion
        self.companion = Companion(Link(240, 191), stack, self.scenario, observer, config, planner)
        observer.companion = self.score.companion = self.companion
        self.faulty = bool(setup.faults)
        """Whether faults were asked for."""
        self._events = sorted(self.scenario.events, key=lambda event: event.time_s)
        self._true_start_ned_m = (0.0, 0.0, 0.0)

    @property
    def t_us(self) -> int:
        """Simulated time."""
        return self.vehicle.t_us

    @property
    def progress(self) -> float:
        """Share of the scenario flown, 0..1."""
        companion = self.companion
        if companion.mission is None:
            return 0.0
        flown = (self.t_us - companion.flight_start_us) * 1e-6
        return min(1.0, flown / companion.mission.track_end_s)

    def step(self) -> None:
        """4 ms of both ends."""
        companion, server, log, seam = self.companion, self.shell.server, self._log, self.shell.seam
        most_bytes = 0 if seam.bad else MAX_DATAGRAM
        server.advance(TICK_MS)
        now_us, keeps_wire = self._clock.step(self.vehicle.plant.t_us), log.keeps_wire
        if self.faulty:
            for at_us, words in server.faults.new():
                log.event(at_us, "fault", words)
        for data in self._carry(seam.out(ONBOARD, server.datagrams(ONBOARD, most_bytes)), self._theirs, self._ours):
            if keeps_wire:
                log.mavlink("rx", now_us, data)
            companion.receive_datagram(data, now_us)
        engaged = companion.flight_start_us
        companion.step(now_us)
        answers = companion.link.datagrams_to_send(most_bytes)
        if keeps_wire:
            for data in answers:
                log.mavlink("tx", now_us, data)
        for data in seam.into(ONBOARD, self._carry(answers, self._ours, self._theirs)):
            server.receive(ONBOARD, data)
        truth = self.vehicle.plant.truth()
        if engaged != companion.flight_start_us:
            self._true_start_ned_m = truth.pos_ned_m
        self._observe(truth, now_us)

    def _carry(self, datagrams: list[bytes], sender: UdpSocket, receiver: UdpSocket) -> list[bytes]:
        """Send a tick's messages, packed into as few datagrams as hold them, and wait until they are there."""
        if not datagrams:
            return datagrams
        for data in datagrams:
            sender.send(data)
        arrived = receiver.receive_exactly(len(datagrams), LOCKSTEP_TIMEOUT_S)
        if lost := len(datagrams) - len(arrived):
            self.companion.stop(f"{lost} datagrams were lost on loopback: this machine is too busy to fly")
        return arrived

    def _observe(self, truth: Truth, now_us: int) -> None:
        """Log the truth, let timed effects happen, and score while the scenario is tracked."""
        self._log.truth(now_us, truth)
        self.score.on_truth(truth)
        track_s = self.score.track_s(now_us)
        if track_s is None:
            return
        while self._events and self._events[0].time_s <= track_s:
            event = self._events.pop(0)
            self.vehicle.plant.set_effect(event.effect, dict(event.values))
            self._log.event(now_us, "effect", f"{event.effect} is now {dict(event.values)}")
        self.score.add(track_s, truth.pos_ned_m, self._true_start_ned_m, truth)

    def close(self) -> None:
        """Close the sockets."""
        self._ours.close()
        self.shell.close()


def fly(
    options: FlyOptions,
    *,
    stop_requested: Callable[[], str] = lambda: "",
    on_progress: Callable[[float, str], None] = lambda share, phase: None,
    report_wanted: Callable[[FlightResult], bool] = lambda result: True,
) -> FlightResult:
    """Fly a scenario in the simulator; log and report lie where the result says.

    `stop_requested` is asked each tick: words of why to land now, or nothing; `report_wanted` when the flight is over
    and its page not made yet.  InputError before anything flies.
    """
    scenario, file = files.load_scenario(options.scenario, options.waypoints)
    options = with_filed(options, scenario.flight, str(file.path))
    setup = prepare(options, compiled_first(on_progress, options.site, options.plant))
    return fly_setup(
        setup, options, stop_requested=stop_requested, on_progress=on_progress, report_wanted=report_wanted
    )


def fly_setup(
    setup: Setup,
    options: FlyOptions,
    *,
    planner: MissionPlanner | None = None,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None] = lambda share, phase: None,
    at_end: Callable[[Recorder, int], None] = lambda log, t_us: None,
    report_wanted: Callable[[FlightResult], bool] = lambda result: True,
) -> FlightResult:
    """The same with a flight that is prepared, and with a `planner` that may change the mission while it is flown.

    `at_end` is called after the flight, with its log still open.
    """
    if planner is not None:
        setup = replace(setup, flight=setup.flight.with_more({"planner": type(planner).__name__}))
    out = options.out or files.new_run_folder(setup.flight.scenario.name, options.seed)
    log_path = options.log or out / "flight.mcap"
    with setup.flight.protection.beside() if options.beside or options.realtime else nullcontext():
        result = _flown(setup, replace(options, log=log_path), planner, stop_requested, on_progress, at_end)
    if report_wanted(result):
        files.write_flight_report(log_path, out / "report.html", result)
    return result


def _flown(
    setup: Setup,
    options: FlyOptions,
    planner: MissionPlanner | None,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None],
    at_end: Callable[[Recorder, int], None],
) -> FlightResult:
    kind = (setup.plant, setup.flight.settings["controller"], setup.flight.settings["filter"], setup.grade.name)
    if options.realtime or kind not in _WARM:  # in lockstep a first call is only slow, so once is enough
        warm_up_all(setup)
        _WARM.add(kind)
    assert options.log is not None
    began_us = utc_us() if options.realtime else UNIX_AT_BOOT_US
    log: FlightLog | NoLog = NoLog()
    if options.log_kept:
        log = setup.flight.open_log(options.log, clock_metadata(began_us, simulated=not options.realtime))
    with undisturbed(real_time=options.realtime) as is_ahead:  # the log's thread too
        recorder = shown_live(
            ThreadedLog(log) if options.realtime and isinstance(log, FlightLog) else log, options.live
        )
        timing = LoopTiming(250, is_ahead=is_ahead) if options.realtime else None
        started = time.perf_counter()
        try:
            flight = SimulatedFlight(setup, options, recorder, planner, began_us)
            try:
                _run(flight, recorder, timing, stop_requested, on_progress)
            finally:
                flight.close()
            at_end(recorder, flight.t_us)
            result = flight.score.result(
                log,
                wall_s=time.perf_counter() - started,
                clock_s=flight.t_us * 1e-6,
                timing=timing,
                completed=flight.companion.completed,
                checked=options.as_written,
                seed=options.seed,
                plant=setup.plant,
            )
            result.link_too_slow = setup.flight.protection.link_too_slow(flight.companion)
            result.unprotected_ok = options.unprotected_ok
            recorder.result(result.attachment())
        finally:
            recorder.close()
    result.log_problem = log.failed or ""
    return result


def _run(
    flight: SimulatedFlight,
    log: Recorder,
    timing: LoopTiming | None,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None],
) -> None:
    companion = flight.companion
    pace = None if timing is None else Pace(TICK_MS * 1000, is_ahead=timing.is_ahead, meanwhile=log.meanwhile)
    limit_us = int((flight.scenario.duration_s + FLIGHT_TIME_LIMIT_S) * 1e6)
    ticks, plant = 0, flight.vehicle.plant
    while not companion.done:
        if pace is not None and timing is not None:
            pace.wait()
            late_us = timing.tick(pace.between_us, TICK_MS * 1000)
        flight.step()
        if pace is not None and timing is not None:
            log.write("/timing", flight.t_us, (late_us, float(pace.busy_us()), timing.missed))
        ticks += 1
        if ticks % 25 == 0:
            if reason := stop_requested():
                companion.stop(reason)
            on_progress(flight.progress, companion.phase)
        if plant.t_us > limit_us:
            companion.reason = companion.reason or f"stuck in {companion.state.value}: gave up"
            break
    for _ in range(50):  # what the last words (Hold) do is in the log too
        flight.step()
    end_us = min(limit_us, flight.t_us + AFTERMATH_US) if flight.faulty else 0
    while flight.t_us < end_us and flight.shell.server.commander.state.armed:  # what the autopilot makes of the fault
        flight.step()
