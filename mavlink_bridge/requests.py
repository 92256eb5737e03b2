"""Commands to the vehicle: sent, answered, sent again; one row per stream that the companion asks for.

PX4 answers DO_SET_MODE twice (its receiver at once, its commander with the verdict later), so an acceptance is no
proof: the newest answer counts, and the caller looks at the mode itself.  A refusal is always the commander's.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.link import Link

Request = tuple[int, tuple[float, ...]]

_RETRY_US = 1_000_000
_ANSWER_TIMEOUT_US = 250_000
_QUEUE_TRIES = 8
"""Of what a link loses three tenths each way, one in two hundred was never answered, one in 15,000 never heard."""
_RENEW_US = 100_000

STREAMS: tuple[tuple[type, int], ...] = (
    (m.AttitudeQuaternion, 4_000),  # PX4 tops out near 198 Hz
    (m.LocalPositionNed, 8_000),  # its source is 125 Hz
    (m.HighresImu, 4_000),  # near 246 Hz
    (m.ScaledImu, 40_000),  # for the accelerometer bias alone, which HIGHRES_IMU lacks and this one has
    (m.ServoOutputRaw, 10_000),
    (m.CurrentMode, 20_000),  # a change of mode is seen within 20 ms, by the dead-man too; HEARTBEAT takes up to 1 s
    (m.ExtendedSysState, 100_000),
    (m.EstimatorStatus, 200_000),
    (m.GpsRawInt, 200_000),  # whether there are satellites; a vehicle without a receiver sends none
    (m.GlobalPositionInt, 200_000),  # for the map only
    (m.Attitude, -1),  # the quaternion says the same
    (m.Odometry, 40_000),  # for its reset counter alone; position and attitude come on their own, faster
)
"""The streams that the companion asks for: message, interval in us (-1: off)."""


FLOWN_BY = (m.AttitudeQuaternion, m.HighresImu, m.LocalPositionNed)
"""The streams without which nobody flies."""
DISARM: Request = (px4.Cmd.COMPONENT_ARM_DISARM, (0.0,))


def stream_requests() -> list[Request]:
    """One SET_MESSAGE_INTERVAL per row of `STREAMS`."""
    return [again(message) for message, _ in STREAMS]


def again(message: type) -> Request:
    """The row of `STREAMS` for a message."""
    return px4.Cmd.SET_MESSAGE_INTERVAL, (float(m.id_of(message)), float(dict(STREAMS)[message]))


def set_mode(custom_mode: int) -> Request:
    """DO_SET_MODE."""
    return px4.Cmd.DO_SET_MODE, (1.0, float(px4.main_mode(custom_mode)), float(px4.sub_mode(custom_mode)))


@dataclass(slots=True)
class Status:
    """What became of the newest command of one kind."""

    request: Request | None = None
    sent_us: int = -1
    result: int | None = None
    answered_us: int = -1

    @property
    def accepted(self) -> bool:
        """The newest answer is an acceptance."""
        return self.result == px4.Result.ACCEPTED


class CommandQueue:
    """Commands in order, one at a time where they share a number, each until it is answered."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._system = 0
        self._now_us = 0
        self._status: dict[int, Status] = {}
        self._queue: deque[Request] = deque()
        self._urgent: deque[Request] = deque()
        self._tries = 0
        self._renewed_us = -_RENEW_US

    @property
    def is_waiting(self) -> bool:
        """Something that was queued is neither answered nor given up."""
        return bool(self._queue)

    def status(self, command: int) -> Status:
        """The newest state of a kind of command; a blank one before the first."""
        return self._status.get(command, Status())

    def request(self, request: Request, now_us: int) -> None:
        """Queue a command that is sent up to eight times until answered, after those before it."""
        self._now_us = now_us
        self._queue.append(request)

    def ensure(self, request: Request, now_us: int, again_us: int = _RETRY_US) -> bool:
        """Send a command now, and again (once a second) for as long as the caller keeps asking; whether it goes now."""
        status = self._status.setdefault(request[0], Status())
        if status.request != request or now_us - status.sent_us >= again_us:
            status.request, status.sent_us, status.result = request, now_us, None
            self._urgent.append(request)
            return True
        return False

    def identify(self, now_us: int) -> None:
        """Ask who the vehicle is, for as long as the caller keeps asking: on its answer hangs the whole flight."""
        self.ensure((px4.Cmd.REQUEST_MESSAGE, (float(m.id_of(m.AutopilotVersion)),)), now_us, _ANSWER_TIMEOUT_US)

    def renew(self, messages: tuple[type, ...], now_us: int) -> None:
        """Rows of `STREAMS` that do not come as asked for: another station on this link may have set them."""
        if now_us - self._renewed_us >= _RENEW_US:
            self._renewed_us = now_us
            for message in messages:
                self.insist(again(message))

    def forget(self, command: int) -> None:
        """What was sent is of before: the next `ensure` of this kind goes at once."""
        self._status.pop(command, None)

    def insist(self, request: Request) -> None:
        """Send a command at once, whatever is queued, and wait for nothing."""
        self._transmit(request)

    def acknowledge(self, ack: m.CommandAck) -> None:
        """Take a COMMAND_ACK."""
        status = self._status.get(ack.command)
        if status is not None:
            status.result, status.answered_us = ack.result, self._now_us

    def step(self, now_us: int, system: int) -> None:
        """Send what is due."""
        self._now_us, self._system = now_us, system
        while self._urgent:
            self._transmit(self._urgent.popleft())
        if not self._queue:
            return
        request = self._queue[0]
        status = self._status.setdefault(request[0], Status())
        if self._tries and status.result is not None:
            self._queue.popleft()
            self._tries = 0
        elif self._tries == 0 or now_us - status.sent_us >= _ANSWER_TIMEOUT_US:
            if self._tries == _QUEUE_TRIES:  # never answered: what depends on it will time out and say so
                self._queue.popleft()
                self._tries = 0
                return
            self._tries += 1
            status.request, status.sent_us, status.result = request, now_us, None
            self._transmit(request)

    def _transmit(self, request: Request) -> None:
        command, given = request
        p1, p2, p3, p4, p5, p6, p7 = (*given, *(math.nan,) * (7 - len(given)))  # NaN: unset, as MAVSDK does
        params = (p1, p2, p3, p4, p5, p6, p7)
        self._link.send(m.CommandLong(self._system, px4.COMPONENT_AUTOPILOT, int(command), 0, params))
