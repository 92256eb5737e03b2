"""A recorder beside the log's: what is logged is also shown live, thinned, by threads of its own.

The flight's thread appends to a bounded queue at most 10 times a second of its own and of this machine's time, and
waits for nobody.  A browser that is slow or goes away is the business of the servers' threads alone.
"""

from __future__ import annotations

import io
import time
from pathlib import Path

import foxglove

from flightstack.barrier.records import Certificate
from flightstack.types import InputError, TickRecord
from flightstack_logs import scene as viewer
from flightstack_logs.live.board import Board
from flightstack_logs.live.page_server import HOST, PageServer
from flightstack_logs.recorder import NoLog, Recorder
from flightstack_logs.threaded import ThreadedLog
from flightstack_logs.topics import Attachment
from flightstack_logs.writer import FlightLog

DEFAULT_PORT = 8765
_PERIOD_S = 0.1
_QUEUE = 500
_SHOWN = frozenset({"/vehicle/status", "/vehicle/battery", "/clock"})


class _Nowhere(io.RawIOBase):
    """A file that keeps nothing: the sink is the WebSocket."""

    _at = 0

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        size = len(memoryview(data))  # type: ignore[arg-type]
        self._at += size
        return size

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._at

    def tell(self) -> int:
        return self._at


class LiveRecorder:
    """`log` (None: nothing is kept), and what can be seen of it on `port` (Foxglove) and `port` + 1 (the page)."""

    def __init__(self, log: Recorder | None, port: int = DEFAULT_PORT) -> None:
        """InputError, one line, where a port is taken."""
        self._log, self._board = NoLog() if log is None else log, Board()
        shown = FlightLog(Path("live"), _Nowhere())
        try:
            self._page = PageServer(port + 1, self._board)
        except OSError as error:
            raise InputError(_taken(port + 1, error.strerror or str(error))) from None
        try:
            self._server = foxglove.start_server(name="flightstack", host=HOST, port=port, context=shown.context)
        except (RuntimeError, OSError) as error:
            self._page.stop()
            raise InputError(_taken(port, str(error))) from None
        self._shown = ThreadedLog(shown, capacity=_QUEUE, poll_s=0.5 * _PERIOD_S)
        self._tick_due_us = self._truth_due_us = self._timing_due_us = 0
        self._tick_due_s = self._truth_due_s = 0.0

    @property
    def failed(self) -> str | None:
        """The first thing that went wrong with the log, one line."""
        return self._log.failed

    @property
    def keeps_wire(self) -> bool:
        """Whether the log beside it keeps datagrams."""
        return self._log.keeps_wire

    def write(self, topic: str, t_us: int, record: object) -> None:
        """One message of a topic of the table."""
        self._log.write(topic, t_us, record)
        if topic in _SHOWN:
            self._shown.write(topic, t_us, record)
            if topic == "/vehicle/status":
                self._board.status(*record)  # type: ignore[misc]
        elif topic == "/timing" and t_us >= self._timing_due_us:
            self._timing_due_us = t_us + round(1e6 * _PERIOD_S)
            self._shown.write(topic, t_us, record)
            assert isinstance(record, tuple)
            self._board.timing(record[0], record[2])

    def mavlink(self, direction: str, t_us: int, data: bytes) -> None:
        """Not shown."""
        self._log.mavlink(direction, t_us, data)

    def tick(self, record: TickRecord, t_us: int | None = None) -> None:
        """One tick of the stack."""
        self._log.tick(record, t_us)
        at_us = record.t_us if t_us is None else t_us
        if at_us >= self._tick_due_us and (now_s := time.monotonic()) >= self._tick_due_s:
            self._tick_due_us, self._tick_due_s = at_us + round(1e6 * _PERIOD_S), now_s + _PERIOD_S
            self._shown.tick(record, at_us)
            self._board.tick(at_us, record)

    def truth(self, t_us: int, truth: object) -> None:
        """The simulator's truth."""
        self._log.truth(t_us, truth)
        if t_us >= self._truth_due_us and (now_s := time.monotonic()) >= self._truth_due_s:
            self._truth_due_us, self._truth_due_s = t_us + round(1e6 * _PERIOD_S), now_s + _PERIOD_S
            self._shown.truth(t_us, truth)
            self._board.truth(t_us, truth)

    def event(self, t_us: int, name: str, text: str, severity: str = "info") -> None:
        """Something that happened."""
        self._log.event(t_us, name, text, severity)
        self._shown.event(t_us, name, text, severity)
        self._board.event(t_us, name, text)

    def statustext(self, t_us: int, severity: int, text: str) -> None:
        """A line that the vehicle said, with its MAV_SEVERITY."""
        self._log.statustext(t_us, severity, text)
        self._shown.statustext(t_us, severity, text)

    def location(self, t_us: int, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        """Where the vehicle is on the map."""
        self._log.location(t_us, latitude_deg, longitude_deg, altitude_m)
        self._shown.location(t_us, latitude_deg, longitude_deg, altitude_m)

    def scene(self, t_us: int, view: viewer.Shown) -> None:
        """What the 3-D view shows."""
        self._log.scene(t_us, view)
        self._shown.scene(t_us, view)
        self._board.scene(view)

    def certificate(self, t_us: int, certificate: Certificate) -> None:
        """What the filter keeps to from now on."""
        self._log.certificate(t_us, certificate)

    def result(self, attachment: Attachment) -> None:
        """What the flight came to."""
        self._log.result(attachment)

    def meanwhile(self, until_us: int) -> None:
        """The loop sleeps until then, by time.monotonic."""
        self._log.meanwhile(until_us)
        self._shown.meanwhile(until_us)

    def close(self) -> None:
        """Finish the log; nothing is shown any more."""
        self._log.close()
        self._shown.close(1.0)
        self._page.stop()
        self._server.stop()


def _taken(port: int, why: str) -> str:
    return f"--live: port {port} of {HOST} can't be had ({' '.join(why.split())}); name another: --live=PORT"
