"""Reading and setting parameters of one vehicle, sans-IO: bytes in, bytes out, time given.

    session = ParamSession(link, names)      meets the vehicle, reads the values that stand
    session.write(values)                    sets them, each until the vehicle says that it has it
    session.receive(data, now_us); session.step(now_us) every few milliseconds until `settled` or `problem`

Nothing is written to an armed vehicle.  PX4 answers PARAM_SET with the value that it took (PARAM_VALUE) or with
PARAM_ERROR; integers travel bit-cast, so a parameter's type is read before it is set.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.link import Link

_RETRY_US = 300_000
_TRIES = 10
_HEARTBEAT_US = 1_000_000
_INTEGERS = range(1, 9)
"""MAV_PARAM_TYPE of the integers."""


class Stored(NamedTuple):
    """A parameter as the vehicle told it."""

    value: float
    kind: int
    """MAV_PARAM_TYPE."""


class ParamSession:
    """One vehicle's parameters; `problem` says in one line why it can't go on, empty: nothing."""

    def __init__(self, link: Link, names: Iterable[str]) -> None:
        self._link = link
        self.system = 0
        self.uid = 0
        """The vehicle's AUTOPILOT_VERSION.uid."""
        self.identified = False
        self.armed = False
        self.problem = ""
        self.stored: dict[str, Stored] = {}
        """Every parameter as last told."""
        self._names = list(names)
        self._wanted: dict[str, float] = {}
        self._sent: dict[str, tuple[int, int]] = {}
        """Name -> (tries, local time of the last)."""
        self._heartbeat_us, self._asked_us = -_HEARTBEAT_US, -_RETRY_US

    @property
    def settled(self) -> bool:
        """The vehicle is known, and everything asked for was read or taken."""
        return self.identified and not self._open()

    def write(self, values: Mapping[str, float]) -> None:
        """Set these; they must have been read before."""
        self._wanted, self._sent = dict(values), {}
        for name, value in values.items():
            kind = self.stored[name].kind
            if kind in _INTEGERS and value != int(value):
                self.problem = f"{name} is an integer: {value:g} can't be set"

    def receive(self, data: bytes, now_us: int) -> None:
        """Take what arrived from the wire."""
        self._link.receive_datagram(data, now_us)
        while (received := self._link.next_event()) is not None:
            message = received.message
            if received.component != px4.COMPONENT_AUTOPILOT or self.system not in (0, received.system):
                continue
            if isinstance(message, m.Heartbeat) and message.autopilot == px4.AUTOPILOT_PX4:
                self.system = received.system
                self._link.expect_peer(received.system)
                self.armed = bool(message.base_mode & px4.ARMED_BIT)
            elif self.system and isinstance(message, m.AutopilotVersion):
                self.uid, self.identified = message.uid, True
            elif self.system and isinstance(message, m.ParamValue):
                value = float(message.value)
                if math.isfinite(value):
                    self.stored[message.param_id] = Stored(value, message.param_type)
            elif isinstance(message, m.ParamError) and message.param_id in self._open():
                self.problem = f"the vehicle refuses parameter {message.param_id} (MAV_PARAM_ERROR {message.error})"

    def step(self, now_us: int) -> None:
        """Send what is due."""
        if now_us - self._heartbeat_us >= _HEARTBEAT_US:
            self._heartbeat_us = now_us
            self._link.send(m.Heartbeat(px4.TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4))
        if self.system and not self.identified and now_us - self._asked_us >= _RETRY_US:
            self._asked_us = now_us
            version = (float(m.id_of(m.AutopilotVersion)), *(math.nan,) * 6)
            ask = m.CommandLong(self.system, px4.COMPONENT_AUTOPILOT, int(px4.Cmd.REQUEST_MESSAGE), 0, version)
            self._link.send(ask)
        if not self.system or self.problem:
            return
        if self._wanted and self.armed:
            self.problem = "the vehicle is armed: its parameters stay as they are"
            return
        for name in self._open():
            tries, sent_us = self._sent.get(name, (0, now_us - _RETRY_US))
            if now_us - sent_us < _RETRY_US:
                continue
            if tries == _TRIES:
                self.problem = f"the vehicle does not answer for parameter {name}"
                return
            self._sent[name] = tries + 1, now_us
            self._ask(name)

    def to_send(self) -> list[bytes]:
        """Datagrams for the wire."""
        return self._link.datagrams_to_send()

    def _ask(self, name: str) -> None:
        if name not in self._wanted:
            self._link.send(m.ParamRequestRead(self.system, px4.COMPONENT_AUTOPILOT, name, -1))
            return
        kind = self.stored[name].kind
        bits = m.param_bits(self._wanted[name], kind)
        self._link.send(m.ParamSet(self.system, px4.COMPONENT_AUTOPILOT, name, bits, kind))

    def _open(self) -> list[str]:
        """What is still to be read, or to be taken."""
        unread = [name for name in self._names if name not in self.stored]
        return unread or [name for name, value in self._wanted.items() if not self.has(name, value)]

    def has(self, name: str, value: float) -> bool:
        """Whether a parameter that was read stands at this value, as far as the vehicle can hold it."""
        stored = self.stored[name]
        return stored.value == (value if stored.kind in _INTEGERS else _float32(value))


def _float32(value: float) -> float:
    """The nearest value that PX4's 32-bit float can hold."""
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)
