"""`flightstack fly --px4-hil`: a scenario on a real PX4 (started by the user) behind which our physics runs.

One loop has both halves: 4 ms of physics in lockstep with PX4 over TCP, then the companion's tick on PX4's offboard
link over UDP.  The companion's clock is the physics', so a busy machine slows the flight down and disturbs nothing.
PX4 says itself how old it expects a fix of GPS to be.  The truth is known: it is logged, and scores the flight.

PX4's local frame begins where its estimator had its first fix, half a metre of noise beside the vehicle.  So the truth
is put into that frame before anything is compared with it: GPS_GLOBAL_ORIGIN tells its origin, and an altitude is
`ref_alt - z`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flightstack.cli import files
from flightstack.cli.column import Column
from flightstack.cli.compiled import compiled_first
from flightstack.cli.flight import FLIGHT_TIME_LIMIT_S, FlyOptions, Setup, prepare, warm_up_all
from flightstack.cli.hil import DEFAULT_SENSORS, DEFAULT_VEHICLE, HIL_PORT, HilSession
from flightstack.cli.live_view import shown_live
from flightstack.cli.result import FlightResult, LoopTiming, Place, relative, tracking_summary
from flightstack.cli.score import FlightScore
from flightstack.cli.simulate import HOST, OFFBOARD_PORT
from flightstack.geodesy import LocalFrame
from flightstack.types import InputError, TickRecord, Tuple3
from flightstack_logs.log_clock import LogClock, clock_metadata
from flightstack_logs.threaded import ThreadedLog
from flightstack_logs.writer import Recorder
from flightstack_sim.px4_hil import STEP_US, PhysicsBehindPx4
from flightstack_sim.warmup import warm_up_lockstep
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.companion import Companion
from mavlink_bridge.link import Link
from mavlink_bridge.pace import undisturbed
from mavlink_bridge.param_session import ParamSession
from mavlink_bridge.transport.address import Transport, UdpIn, open_address
from mavlink_bridge.transport.clock import utc_us
from mavlink_bridge.transport.tcp import TcpServer

CONNECT_LIMIT_S = 60.0
"""So long PX4 is waited for."""
_BOOT_LIMIT_US = 30_000_000
_GPS_DELAY = "EKF2_GPS_DELAY"
_LAST_STEPS = 50
_ORIGIN_PERIOD_US = 1_000_000


@dataclass(slots=True)
class GlobalEstimateScore:
    """Where PX4 believes the vehicle, against where it is, on the globe; fed while the scenario is tracked."""

    frame: LocalFrame
    """Of the truth."""
    origin: tuple[float, float, float] | None = None
    """Latitude, longitude (degrees), altitude (m) of PX4's local frame; None until it is told."""
    distances_m: Column = field(default_factory=Column)
    """Of the estimated position from the reference."""
    _errors: Column = field(default_factory=lambda: Column(3))

    def on_message(self, t_us: int, message: object) -> None:
        """GPS_GLOBAL_ORIGIN; others mean nothing here."""
        if isinstance(message, m.GpsGlobalOrigin):
            self.origin = message.lat_deg, message.lon_deg, message.alt_msl_m

    def in_px4s_frame(self, true_ned_m: Tuple3) -> Tuple3 | None:
        """The true position in PX4's local frame; None until its origin is told."""
        if self.origin is None:
            return None
        lat, lon, ref_alt_m = self.origin
        north, east = LocalFrame(lat, lon, 0.0).to_local(*self.frame.to_globe(true_ned_m[0], true_ned_m[1]))
        return north, east, ref_alt_m - (self.frame.altitude_m - true_ned_m[2])

    def add(self, estimated_ned_m: Place, true_ned_m: Tuple3) -> None:
        """One tick, both positions in PX4's local frame."""
        north, east, down = relative(estimated_ned_m, true_ned_m)
        self._errors.extend((north, east, -down))

    def summary(self) -> dict[str, Any]:
        """rms of the horizontal and of the vertical error, and the mean of the latter; null where nothing is known.
        Beside them `tracking` by the estimate, as a flight without truth has it."""
        tracking = {"tracking": tracking_summary("estimate", self.distances_m.table())}
        if not len(self._errors):
            return {"horizontal_rms_m": None, "height_rms_m": None, "height_mean_m": None} | tracking
        errors = self._errors.table()
        return tracking | {
            "horizontal_rms_m": float(np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean())),
            "height_rms_m": float(np.sqrt((errors[:, 2] ** 2).mean())),
            "height_mean_m": float(errors[:, 2].mean()),
        }


class HilFlight:
    """Physics, PX4's answers and the companion, stepped together."""

    def __init__(self, setup: Setup, options: FlyOptions, server: TcpServer, link: Transport, log: Recorder) -> None:
        prepared = setup.flight
        self.hil = PhysicsBehindPx4(setup.truth, setup.grade, seed=options.seed, plant=setup.plant)
        self.session = HilSession(server, self.hil)
        self.score = FlightScore(prepared, of="truth")
        self.estimate = GlobalEstimateScore(self.hil.frame)
        self._clock = LogClock(log, zero_us=0, utc_us=utc_us())
        observer = prepared.observer(log, self._clock, truth=True)
        observer.record_to = self._on_record
        observer.message_to = self.estimate.on_message
        self.companion = Companion(Link(240, 191), prepared.stack, prepared.scenario, observer, setup.companion)
        observer.companion = self.score.companion = self.companion
        self._link, self._log = link, log
        self.duration_s = prepared.scenario.duration_s
        self._events = sorted(prepared.scenario.events, key=lambda event: event.time_s)
        self._true_start_ned_m: Tuple3 = (0.0, 0.0, 0.0)
        self._record: TickRecord | None = None
        self._origin_due_us = 0
        self._system = 0

    @property
    def t_us(self) -> int:
        """Simulated time."""
        return self.hil.t_us

    def read_gps_delay(self, stop_requested: Callable[[], str]) -> float | None:
        """How old PX4 expects a fix to be, seconds, by its parameter, used from here on; None: it does not say."""
        session = ParamSession(Link(240, 191), [_GPS_DELAY])
        while not session.settled and not session.problem and self.t_us < _BOOT_LIMIT_US and not stop_requested():
            self.session.step(stop_requested)
            for data in self._link.receive_all():
                session.receive(data, self.t_us)
            session.step(self.t_us)
            for data in session.to_send():
                self._link.send(data)
        self._system = session.system
        if _GPS_DELAY not in session.stored:
            return None
        delay_s = 1e-3 * session.stored[_GPS_DELAY].value
        self.hil.set_gps_delay(delay_s)
        return delay_s

    def step(self, stop_requested: Callable[[], str]) -> None:
        """4 ms of physics, PX4's answer, the companion's tick."""
        companion = self.companion
        self.session.step(stop_requested)
        now_us = self.t_us
        t_us, keeps_wire = self._clock.step(now_us), self._log.keeps_wire
        for data in self._link.receive_all():
            if keeps_wire:
                self._log.mavlink("rx", t_us, data)
            companion.receive_datagram(data, now_us)
        engaged = companion.flight_start_us
        companion.step(now_us)
        self._ask_for_origin(now_us)
        for data in companion.link.datagrams_to_send():
            if keeps_wire:
                self._log.mavlink("tx", t_us, data)
            self._link.send(data)
        truth = self.hil.plant.truth()
        if engaged != companion.flight_start_us:
            self._true_start_ned_m = truth.pos_ned_m
        self._observe(truth, t_us)

    def _on_record(self, record: TickRecord) -> None:
        self._record = record
        self.score.on_record(record)

    def _observe(self, truth: Any, t_us: int) -> None:
        """Log the truth, let timed effects happen, and score while the scenario is tracked."""
        self._log.truth(t_us, truth)
        self.score.on_truth(truth)
        track_s = self.score.track_s(self.companion.last_t_us)
        if track_s is None:
            return
        while self._events and self._events[0].time_s <= track_s:
            event = self._events.pop(0)
            self.hil.plant.set_effect(event.effect, dict(event.values))
            self._log.event(t_us, "effect", f"{event.effect} is now {dict(event.values)}")
        start_ned_m, told = self.companion.start_ned_m, self.estimate.in_px4s_frame(truth.pos_ned_m)
        if told is None:
            self.score.add(track_s, truth.pos_ned_m, self._true_start_ned_m, truth)
        else:
            self.score.add(track_s, told, start_ned_m, truth)
        if told is None or self._record is None or not 0.0 <= track_s <= self.duration_s:
            return
        estimated = self._record.measurement.pos_ned_m
        self.estimate.add(estimated, told)
        wanted = self._record.reference.pos_ned_m
        away_m = math.dist(relative(estimated, start_ned_m), relative(wanted, start_ned_m))
        self.estimate.distances_m.append(away_m)

    def _ask_for_origin(self, now_us: int) -> None:
        """Once a second, until it is told."""
        if self.estimate.origin is not None or not self._system or now_us < self._origin_due_us:
            return
        self._origin_due_us = now_us + _ORIGIN_PERIOD_US
        wanted = (float(m.id_of(m.GpsGlobalOrigin)), *(math.nan,) * 6)
        self.companion.link.send(
            m.CommandLong(self._system, px4.COMPONENT_AUTOPILOT, int(px4.Cmd.REQUEST_MESSAGE), 0, wanted)
        )


def fly_behind_px4(
    options: FlyOptions,
    *,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None] = lambda share, phase: None,
    report_wanted: Callable[[FlightResult], bool] = lambda result: True,
) -> FlightResult:
    """Fly a scenario on the PX4 that connects; InputError where none does, or something is wrong beforehand."""
    if options.fault is not None:
        raise InputError("--fault is for the simulated autopilot: with --px4-hil, leave it out")
    options = replace(
        options, vehicle=options.vehicle or DEFAULT_VEHICLE, sensors=options.sensors or DEFAULT_SENSORS, realtime=True
    )
    setup = prepare(options, compiled_first(on_progress, options.site, options.plant))
    out = options.out or files.new_run_folder(setup.flight.scenario.name, options.seed)
    options = replace(options, log=options.log or out / "flight.mcap")
    instance = options.hil_port - HIL_PORT
    with (
        closing(TcpServer.bind(HOST, options.hil_port)) as server,
        closing(open_address(UdpIn(HOST, OFFBOARD_PORT + instance))) as link,
        setup.flight.protection.beside(),
    ):
        warm_up_all(setup)
        warm_up_lockstep(setup.truth, setup.plant)
        _wait_for_px4(server, options.hil_port, stop_requested, on_progress)
        result = _flown(setup, options, (server, link), stop_requested, on_progress)
    if report_wanted(result):
        assert options.log is not None
        files.write_flight_report(options.log, out / "report.html", result)
    return result


def _wait_for_px4(
    server: TcpServer, port: int, stop_requested: Callable[[], str], on_progress: Callable[[float, str], None]
) -> None:
    limit_s = time.monotonic() + CONNECT_LIMIT_S
    on_progress(0.0, f"waiting for PX4 on TCP {HOST}:{port} (make px4_sitl none_iris)")
    while not server.accept(0.1):
        if stop_requested():
            raise KeyboardInterrupt
        if time.monotonic() > limit_s:
            raise InputError(
                f"no PX4 came to TCP {HOST}:{port} within {CONNECT_LIMIT_S:g} s: start one whose simulator is MAVLink "
                "(make px4_sitl none_iris; instance i looks at 4560 + i)"
            )


def _flown(
    setup: Setup,
    options: FlyOptions,
    ends: tuple[TcpServer, Transport],
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None],
) -> FlightResult:
    assert options.log is not None
    settings = {"pace": "behind a real PX4", "hil_port": str(options.hil_port)}
    log = setup.flight.with_more(settings).open_log(options.log, clock_metadata(utc_us(), simulated=False))
    with undisturbed(real_time=True) as is_ahead:
        recorder, timing = (
            shown_live(ThreadedLog(log), options.live),
            LoopTiming(1_000_000 // STEP_US, is_ahead=is_ahead),
        )
        started = time.perf_counter()
        try:
            flight = HilFlight(setup, options, *ends, recorder)
            delay_s = flight.read_gps_delay(stop_requested)
            words = "not told" if delay_s is None else f"{delay_s:g} s"
            recorder.event(0, "parameters", f"{_GPS_DELAY} {words}: fixes arrive so old")
            _run(flight, ends[0], timing, stop_requested, on_progress)
        finally:
            recorder.close()
    result = flight.score.result(
        log,
        wall_s=time.perf_counter() - started,
        clock_s=flight.t_us * 1e-6,
        timing=timing,
        completed=flight.companion.completed,
        checked=False,
        seed=options.seed,
        plant=setup.plant,
    )
    result.unprotected_ok, result.estimate = options.unprotected_ok, flight.estimate.summary()
    return result


def _run(
    flight: HilFlight,
    server: TcpServer,
    timing: LoopTiming,
    stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None],
) -> None:
    companion, pace = flight.companion, flight.session.pace
    limit_us = flight.t_us + int((flight.duration_s + FLIGHT_TIME_LIMIT_S) * 1e6)
    while not companion.done:
        flight.step(stop_requested)
        timing.lateness_us.append(flight.session.lateness_us)
        timing.missed = pace.missed
        if not server.connected:
            companion.reason = companion.reason or "PX4 has closed the connection to its simulator"
            return
        if flight.hil.steps % 25 == 0:
            if reason := stop_requested():
                companion.stop(reason)
            on_progress(0.0, companion.phase)
        if flight.t_us > limit_us:
            companion.reason = companion.reason or f"stuck in {companion.state.value}: gave up"
            return
    for _ in range(_LAST_STEPS):  # what the last words (Hold) do is in the log too
        flight.step(stop_requested)
