"""`flightstack offboard`: the companion alone, in real time, against any PX4."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from flightstack.cli import files
from flightstack.cli.compiled import compiled_first
from flightstack.cli.console import say
from flightstack.cli.estimate_gate import EstimateGate
from flightstack.cli.inspection import Inspector
from flightstack.cli.live_view import shown_live
from flightstack.cli.preparation import FlightOptions, Prepared, prepare_flight
from flightstack.cli.protection import Protection
from flightstack.cli.real_time import PERIOD_US, RealTimeLoop
from flightstack.cli.result import FlightResult, LoopTiming
from flightstack.cli.score import FlightScore
from flightstack.cli.set_params import VehicleLink, parameters_set
from flightstack.cli.vehicle_gains import ask_gains, changed, counted_on
from flightstack.cli.vehicle_site import ask_vehicle, carried, unknowing
from flightstack.scenario import Scenario
from flightstack.types import InputError
from flightstack_logs.log_clock import LogClock, clock_metadata
from flightstack_logs.threaded import ThreadedLog
from flightstack_logs.writer import FlightLog
from mavlink_bridge import frequent
from mavlink_bridge.companion import Companion, CompanionConfig, Observer
from mavlink_bridge.link import Link
from mavlink_bridge.pace import undisturbed
from mavlink_bridge.signing import Signer
from mavlink_bridge.transport.address import Serial, Transport, UdpIn, UdpOut, framing_for, open_address, parse_address
from mavlink_bridge.transport.clock import monotonic_us, utc_us
from mavlink_bridge.transport.dead_man import NO_DEAD_MAN, DeadManProcess, DeadManWatch, SetpointSource
from mavlink_bridge.transport.key_file import KeyFile

_LEAST_BAUD = 500_000
_LAST_WORDS_TIMES = 5
"""A program that ends without warning says them so often: a link may lose one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OffboardOptions(FlightOptions):
    """What `offboard` was asked for."""

    connect: str
    scenario: str = "hover"
    arm: bool = False
    dry_run: bool = False
    believe_file: bool = False
    """Fly though PX4's parameters contradict the vehicle file."""
    set_params: str | None = None
    """Parameters to set for the flight: name or file."""
    sensors: str | None = None
    """Grade that says what the vehicle's estimate is like."""
    heartbeat_timeout_s: float = 10.0
    dead_man: bool = True
    """A process of its own answers the companion's silence."""
    signing_key: Path | None = None
    """File of the key that signs what is sent and without which nothing counts that is received."""

    where: tuple[float, float] | None = None
    """Latitude and longitude of the vehicle; None: not asked for, or not known."""

    @property
    def place(self) -> tuple[float, float] | None:
        """See ProtectionOptions."""
        return self.where

    @property
    def in_real_time(self) -> bool:
        """See ProtectionOptions."""
        return True

    def grade(self, scenario: Scenario) -> str:
        """As named; else what the file of parameters says, else the scenario's, which the vehicle may contradict."""
        return self.sensors or files.load_params(self.set_params).sensors or scenario.sensors

    @property
    def as_written(self) -> bool:
        """The flight is the one that the scenario's checks were written for."""
        return self.stack_as_written and not self.dry_run


def offboard(
    options: OffboardOptions,
    *,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None] = lambda share, phase: None,
    report_wanted: Callable[[FlightResult], bool] = lambda result: True,
) -> FlightResult:
    """Fly a scenario on the vehicle at an address; InputError before anything moves, else a result."""
    if options.site is not None:
        site, where = ask_vehicle(options.site, options.connect, options.heartbeat_timeout_s)
        options = replace(options, site=site, where=where)
    prepared = prepare_flight(options, on_read=compiled_first(on_progress, options.site))
    if options.dry_run and options.set_params:
        raise InputError("--dry-run changes nothing on the vehicle: leave out --set-params")
    require_room(parse_address(options.connect))
    if prepared.protection.unattainable:
        say(f"not protected: {prepared.protection.unattainable}")
    with _key(options.signing_key) as signer:
        if prepared.protection.filter.enabled:
            gains = ask_gains(options.connect, signer, options.heartbeat_timeout_s, prepared.believed)
            if others := changed(prepared.believed, gains):
                say(others)
                prepared = prepare_flight(options, gains)
        with prepared.protection.beside():
            frequent.prepare()
            prepared.warm_up()
            return _offboard(options, prepared, signer, stop_requested, on_progress, report_wanted)


def _offboard(
    options: OffboardOptions,
    prepared: Prepared,
    signer: Signer | None,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None],
    report_wanted: Callable[[FlightResult], bool],
) -> FlightResult:
    scenario = prepared.scenario
    address = parse_address(options.connect)
    wanted = files.load_params(options.set_params).values
    with (
        undisturbed(real_time=True) as is_ahead,
        closing(open_address(address, signer)) as transport,
        parameters_set(VehicleLink(transport, address, signer, options.heartbeat_timeout_s), wanted, say) as change,
    ):
        out = options.out or files.new_run_folder(scenario.name, None)
        log_path = options.log or out / "flight.mcap"
        began_us = utc_us()
        log = prepared.with_more(_settings(options, scenario, signed=signer is not None)).open_log(
            log_path, clock_metadata(began_us, simulated=False)
        )
        recorder = shown_live(ThreadedLog(log), options.live)
        zero_us = monotonic_us()
        line = LogClock(recorder, zero_us=zero_us, utc_us=began_us)
        line.step(zero_us)  # the log begins at 0, however late the vehicle's first message comes
        score = FlightScore(prepared, of="estimate")
        observer = prepared.observer(recorder, line, truth=False)
        observer.record_to = score.on_record
        observer.message_to = score.on_message
        link = Link(240, 191, framing=framing_for(address), signing=signer)
        companion, inspector, config = companion_of(link, options, prepared, observer)
        observer.companion = score.companion = companion
        timing = LoopTiming(1_000_000 // PERIOD_US, is_ahead=is_ahead)
        started = time.perf_counter()
        try:
            with ExitStack() as watched:
                dead_man = None
                if options.dead_man and not options.dry_run:
                    process = watched.enter_context(DeadManProcess(transport.fileno(), signer))
                    dead_man = DeadManWatch(process, companion, transport)
                loop = RealTimeLoop(
                    companion, transport, recorder, line, timing, inspector, dead_man, stop_requested, on_progress
                )
                with last_words(companion, transport):
                    loop.run()
                timing.dead_man = NO_DEAD_MAN if dead_man is None else dead_man.summary()
            result = _result(score, log, options, timing, time.perf_counter() - started)
            if options.dry_run:
                result.checklist = inspector.checklist(config)
            result.contradictions = inspector.found
            recorder.result(result.attachment())
        finally:
            recorder.close()
    result.log_problem, result.parameters_set = log.failed or "", change.as_json()
    if report_wanted(result):
        files.write_flight_report(log_path, out / "report.html", result)
    return result


def companion_of(
    link: Link, options: OffboardOptions, prepared: Prepared, observer: Observer
) -> tuple[Companion, Inspector, CompanionConfig]:
    """The companion of such a flight, what judges its vehicle, and what it may do."""
    inspector = Inspector(
        prepared, believe_file=options.believe_file, dry_run=options.dry_run, dead_man=options.dead_man
    )
    sensors, site = options.grade(prepared.scenario), prepared.protection.site
    bounds = None if site is None else site.estimate
    config = CompanionConfig(
        arm=options.arm,
        dry_run=options.dry_run,
        heartbeat_timeout_s=options.heartbeat_timeout_s,
        contradictions=inspector.contradictions,
        dead_man=options.dead_man,
        speaks_first=isinstance(parse_address(options.connect), UdpOut) and options.signing_key is None,
        round_trip_max_s=prepared.protection.round_trip_max_s,
        counted=counted_on(prepared.believed) if prepared.protection.filter.enabled else {},
        misplaced=lambda view: carried(view, options.where) or unknowing(view, bounds, sensors),
    )
    companion = Companion(link, prepared.stack, prepared.scenario, observer, config, inspector)
    inspector.attach(companion)
    inspector.gate = _heed(prepared.protection, sensors, companion)
    return companion, inspector, config


def _settings(options: OffboardOptions, scenario: Scenario, *, signed: bool) -> dict[str, str]:
    """What the log says of this flight besides what every flight says."""
    return {
        "connect": options.connect,
        "arm": str(options.arm),
        "dry_run": str(options.dry_run),
        "believe_file": str(options.believe_file),
        "heartbeat_timeout_s": f"{options.heartbeat_timeout_s:g}",
        "place": "" if options.place is None else "{!r} {!r}".format(*options.place),
        "pace": "realtime",
        "signing": "on" if signed else "off",
        "dead_man": "on" if options.dead_man else "off",
        "set_params": options.set_params or "none",
        "sensors": options.grade(scenario),
    }


def _result(
    score: FlightScore, log: FlightLog, options: OffboardOptions, timing: LoopTiming, wall_s: float
) -> FlightResult:
    companion, protection = score.companion, score.prepared.protection
    assert companion is not None
    result = score.result(
        log,
        wall_s=wall_s,
        clock_s=wall_s * companion.view.clock.rate,
        timing=timing,
        completed=None if options.dry_run else companion.completed,
        checked=options.as_written,
    )
    result.link_too_slow, result.unprotected_ok = protection.link_too_slow(companion), options.unprotected_ok
    return result


def _heed(protection: Protection, sensors: str, companion: Companion) -> EstimateGate | None:
    """From now on the vehicle's own words decide whether anything is certified; None where nothing would be."""
    bounds = protection.estimate if protection.site is None else protection.site.estimate
    if bounds is None:
        return None
    gate = EstimateGate(bounds, sensors, say)
    gate.companion = companion
    if protection.watched is not None:
        protection.watched.contradicted = gate
    return gate


def require_room(address: UdpIn | UdpOut | Serial) -> None:
    """InputError where a serial line is too slow for the streams that a flight needs."""
    if isinstance(address, Serial) and address.baud < _LEAST_BAUD:
        raise InputError(
            f"serial line {address.device} at {address.baud} baud carries {address.baud // 10_000} kB/s, the streams "
            "need some 50: set it and PX4's port (SER_*_BAUD) to 921600"
        )


@contextmanager
def _key(path: Path | None) -> Iterator[Signer | None]:
    """The key, ours alone; InputError where it can't be had."""
    if path is None:
        yield None
        return
    with closing(KeyFile.open(path)) as key:
        yield key.signer


@contextmanager
def last_words(companion: SetpointSource, transport: Transport) -> Iterator[None]:
    """Whatever ends the flight (a bug, a second Ctrl-C): a vehicle that is ours is levelled and given to PX4's Hold."""
    try:
        yield
    except BaseException as error:
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        with suppress(Exception):  # the first exception counts, and what can be said is said
            for _ in range(_LAST_WORDS_TIMES):
                companion.say_last_words(reason)
                for data in companion.link.datagrams_to_send():
                    transport.send(data)
        raise
