"""The small protocols beside commands: parameters, files, clocks, missed events.

Each function takes a message addressed to this vehicle and returns what to send back on the same link.
Parameters: integers are bit-cast into the float field (byte-wise union); the list begins with `_HASH_CHECK`;
what can't be read or set is answered by PARAM_ERROR.  There are no files: clients are told so at once.
"""

from __future__ import annotations

import struct
import zlib
from collections import deque
from typing import Any, Final

from flightstack_sim.autopilot.params import PARAMS, ParamResult, Params, ParamType, find
from flightstack_sim.autopilot.requests import Sender
from mavlink_bridge import messages as m

_HASH_NAME: Final = "_HASH_CHECK"
_HASH_TYPE: Final = 5  # UINT32
_NO_INDEX: Final = 65535
_EVENTS_KEPT: Final = 40


# --- parameters ---


def _value(params: Params, index: int) -> m.ParamValue:
    spec = PARAMS[index]
    bits = m.param_bits(params.at(index), spec.type)
    return m.ParamValue(spec.name, bits, int(spec.type), len(PARAMS), index)


def _hash(params: Params) -> m.ParamValue:
    """A number that changes when any parameter does: a client with a cache can skip the list."""
    digest = 0
    for index, spec in enumerate(PARAMS):
        digest = zlib.crc32(spec.name.encode(), digest)
        digest = zlib.crc32(struct.pack("<I", m.param_bits(params.at(index), spec.type)), digest)
    return m.ParamValue(_HASH_NAME, digest, _HASH_TYPE, len(PARAMS), _NO_INDEX)


def _error(sender: Sender, name: str, index: int, error: int) -> m.ParamError:
    return m.ParamError(sender.system, sender.component, name, index, error)


def read_parameter(message: m.ParamRequestRead, params: Params, sender: Sender) -> Any:
    """PARAM_REQUEST_READ, by index or (index -1) by name."""
    index: int | None = message.param_index
    if message.param_index < 0:
        if message.param_id == _HASH_NAME:
            return _hash(params)
        index = find(message.param_id)
    if index is None or not index < len(PARAMS):
        return _error(sender, message.param_id, message.param_index, ParamResult.DOES_NOT_EXIST)
    return _value(params, index)


def set_parameter(message: m.ParamSet, params: Params, sender: Sender) -> tuple[Any, bool]:
    """PARAM_SET: the answer, and whether it holds for all links (a new value) or only for the sender (an error)."""
    index = find(message.param_id)
    if index is None:
        return _error(sender, message.param_id, -1, ParamResult.DOES_NOT_EXIST), False
    if message.param_type != PARAMS[index].type:
        return _error(sender, message.param_id, -1, ParamResult.TYPE_MISMATCH), False
    result = params.set(message.param_id, message.value, ParamType(message.param_type))
    if result is not ParamResult.OK:
        return _error(sender, message.param_id, -1, result), False
    return _value(params, index), True


class ParameterList:
    """A running PARAM_REQUEST_LIST of one link: a few parameters a tick, as PX4's link has room."""

    __slots__ = ("_next",)

    def __init__(self) -> None:
        self._next = len(PARAMS)

    @property
    def running(self) -> bool:
        """Whether something is left to send."""
        return self._next < len(PARAMS)

    def start(self) -> None:
        """From the beginning."""
        self._next = -1

    def take(self, params: Params, count: int) -> list[m.ParamValue]:
        """The next `count` items; the hash comes first."""
        items = []
        while count > 0 and self.running:
            items.append(_hash(params) if self._next < 0 else _value(params, self._next))
            self._next += 1
            count -= 1
        return items


# --- files: none ---

_FTP_HEADER: Final = struct.Struct("<HBBBBBBI")
_FTP_SIZE: Final = 251
_FTP_TERMINATE, _FTP_RESET, _FTP_LIST = 1, 2, 3
_FTP_ACK, _FTP_NAK = 128, 129
_FTP_END_OF_FILE, _FTP_NOT_FOUND = 6, 10


def answer_file(message: m.FileTransferProtocol, sender: Sender) -> m.FileTransferProtocol | None:
    """FTP: every folder is empty and no file exists; an answer from another server is left alone."""
    payload = message.payload.ljust(_FTP_SIZE, b"\0")
    sequence, session, opcode, _, _, _, _, offset = _FTP_HEADER.unpack_from(payload)
    if opcode >= _FTP_ACK:
        return None
    if opcode in (_FTP_TERMINATE, _FTP_RESET):
        answer, size, data = _FTP_ACK, 0, b""
    else:
        error = _FTP_END_OF_FILE if opcode == _FTP_LIST else _FTP_NOT_FOUND
        answer, size, data = _FTP_NAK, 1, bytes([error])
    header = _FTP_HEADER.pack((sequence + 1) & 0xFFFF, session, answer, size, opcode, 0, 0, offset)
    return m.FileTransferProtocol(0, sender.system, sender.component, (header + data).ljust(_FTP_SIZE, b"\0"))


# --- clocks ---


def answer_timesync(message: m.Timesync, sender: Sender, now_us: int) -> m.Timesync | None:
    """A question (tc1 0) gets our clock and its own stamp back."""
    if message.tc1_ns != 0:
        return None
    return m.Timesync(1000 * now_us, message.ts1_ns, sender.system, sender.component)


def answer_ping(message: m.Ping, sender: Sender) -> m.Ping | None:
    """A ping to everybody goes back to its sender."""
    if message.target_system != 0 or message.target_component != 0:
        return None
    return m.Ping(message.t_us, message.seq, sender.system, sender.component)


# --- events ---


class EventMemory:
    """The last events, for clients that missed some."""

    __slots__ = ("_events", "sequence")

    def __init__(self) -> None:
        self._events: deque[m.Event] = deque(maxlen=_EVENTS_KEPT)
        self.sequence = 0

    def add(self, event_id: int, log_levels: int, arguments: bytes, now_us: int) -> m.Event:
        """Number an event and keep it."""
        self.sequence = (self.sequence + 1) & 0xFFFF
        event = m.Event(0, 0, event_id, now_us, self.sequence, log_levels, arguments.ljust(40, b"\0"))
        self._events.append(event)
        return event

    def answer(self, message: m.RequestEvent, sender: Sender) -> list[Any]:
        """REQUEST_EVENT: the events from first to last, or what is gone."""
        count = ((message.last_sequence - message.first_sequence) & 0xFFFF) + 1
        kept = {event.sequence: event for event in self._events}
        oldest = self._events[0].sequence if self._events else self.sequence
        answers: list[Any] = []
        for step in range(min(count, _EVENTS_KEPT)):
            number = (message.first_sequence + step) & 0xFFFF
            event = kept.get(number)
            if event is None:
                answers.append(m.ResponseEventError(sender.system, sender.component, number, oldest))
                break
            answers.append(event)
        return answers
