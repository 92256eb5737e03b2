"""The companion in real time: a tick every 4 ms over a transport, its time between ticks watched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from flightstack.cli.inspection import Inspector
from flightstack.cli.result import LoopTiming
from flightstack_logs.log_clock import LogClock
from flightstack_logs.topics import TOPICS
from flightstack_logs.writer import Recorder
from mavlink_bridge.companion import Companion
from mavlink_bridge.handshake import State
from mavlink_bridge.pace import Pace
from mavlink_bridge.transport.address import Transport
from mavlink_bridge.transport.clock import monotonic_us
from mavlink_bridge.transport.dead_man import DeadManWatch
from mavlink_bridge.transport.stall_watch import WAITING, StallWatch
from mavlink_bridge.watchdogs import SLEPT_US

PERIOD_US = 4_000
STALL_US = 8_000
"""Two periods too late: told in the log with what kept the tick."""
_LEAST_PERIOD_US = 500
_LAST_WORDS_S = 0.3
"""After the end the link stays open for so long, for the last command and its answer."""
_DEAD_MAN_COLUMNS = tuple(field.name for field in TOPICS["/dead_man"].fields if field.name != "ended")
_COUNTED = frozenset({State.STREAMING, State.OFFBOARD, State.RETAKING, State.LANDING, State.HOLDING})


@dataclass(slots=True)
class RealTimeLoop:
    """`run` ticks until the companion is done."""

    companion: Companion
    transport: Transport
    log: Recorder
    line: LogClock
    timing: LoopTiming
    inspector: Inspector
    dead_man: DeadManWatch | None
    stop_requested: Callable[[], str]
    on_progress: Callable[[float, str], None]
    _ticks: int = 0
    _done_at_us: int = field(default=-1)
    _dead_man_row: tuple[object, ...] = ()

    def run(self) -> None:
        """Until nothing more will happen and the last command has had its time."""
        pace = Pace(PERIOD_US, is_ahead=self.timing.is_ahead, meanwhile=self.log.meanwhile)
        with StallWatch(PERIOD_US, told_from_us=STALL_US) as watch:
            while not self._is_over():
                watch.mark(WAITING)
                pace.wait()
                self._tick(watch, pace)

    def _tick(self, watch: StallWatch, pace: Pace) -> None:
        stall = watch.tick("receiving")
        companion, now_us, keeps_wire = self.companion, monotonic_us(), self.log.keeps_wire
        clock, counted = companion.view.clock, companion.state in _COUNTED
        received_us = now_us
        t_us = self.line.step(now_us, clock.vehicle_us(now_us) if clock.synchronised else None, clock.rate)
        for data in self.transport.receive_all():
            if keeps_wire:
                self.log.mavlink("rx", t_us, data)
            companion.receive_datagram(data, now_us)
        watch.mark("deciding and flying")
        if self.dead_man is not None:
            self.dead_man.hear()
            self._note_dead_man(t_us, self.dead_man)
        if (later_us := monotonic_us()) - now_us > PERIOD_US:  # stalled in here: what is decided is decided now
            now_us = later_us
        self.log.write("/step", t_us, (received_us, now_us))
        companion.step(now_us)
        watch.mark("sending and logging")
        for data in companion.link.datagrams_to_send():
            if monotonic_us() - now_us > SLEPT_US:
                continue  # stopped in here: to a failsafe that has acted since, it would be the way back to OFFBOARD
            if keeps_wire:
                self.log.mavlink("tx", t_us, data)
            self.transport.send(data)
        if self.dead_man is not None:
            self.dead_man.tell()
        if counted:  # by the state before the step: the tick that ends a flight counts too
            late_us = self.timing.tick(watch.between_us, PERIOD_US)
            self.log.write("/timing", t_us, (late_us, float(pace.busy_us()), self.timing.missed))
            if stall is not None:
                self.timing.stall(stall.between_us, stall.words)
                self.log.event(t_us, "stall", f"stall: {stall.words}", "warning")
        self._now_and_then(now_us, pace)

    def _note_dead_man(self, t_us: int, dead_man: DeadManWatch) -> None:
        """Into the log, where anything but its being alive has changed."""
        report = dead_man.report
        alive_ns, *rest = (getattr(report, name) for name in _DEAD_MAN_COLUMNS)
        row = (*rest, bool(dead_man.ended))
        if row != self._dead_man_row:
            self._dead_man_row = row
            self.log.write("/dead_man", t_us, (alive_ns, *row))

    def _now_and_then(self, now_us: int, pace: Pace) -> None:
        companion = self.companion
        self._ticks += 1
        if self._ticks % 25 == 0:
            pace.period_us = max(_LEAST_PERIOD_US, PERIOD_US / max(1.0, companion.view.clock.rate))
            companion.view.other_system = self.transport.other
            if reason := self.stop_requested():
                companion.stop(reason)
            self.on_progress(_progress(companion), companion.phase)
        if companion.done:
            self._done_at_us = now_us if self._done_at_us < 0 else self._done_at_us
            self.inspector.count(now_us)

    def _is_over(self) -> bool:
        linger_s = max(_LAST_WORDS_S, self.inspector.lasts_s)
        return self._done_at_us >= 0 and monotonic_us() - self._done_at_us > linger_s * 1e6


def _progress(companion: Companion) -> float:
    if companion.mission is None:
        return 0.0
    return min(1.0, (companion.last_t_us - companion.flight_start_us) * 1e-6 / companion.mission.track_end_s)
