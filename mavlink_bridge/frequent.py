"""The messages that nearly every datagram of the vehicle holds, a whole run of them in one compiled call.

They are read from the wire by the message table, as `codec` does it one by one, into one row of numbers, and taken from
there into what is made of them: the newest samples (`flightstack.predictor`), the watch of the estimate
(`flightstack.consistency`) and the latency of commands.  Only what is as usual is read here: a good unsigned MAVLink 2
frame of the expected sender with the expected sequence number, finite, each kind once.  The rest is the link's business
as before, message by message.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import permutations
from typing import Final

import numpy as np

from flightstack.consistency import JUMP_M, watch_attitude, watch_imu, watch_position
from flightstack.jit import Entry, njit
from flightstack.predictor import Streams, take_attitude, take_imu, take_motors, take_position
from flightstack.types import F64, U8, Tuple3
from mavlink_bridge import messages as m
from mavlink_bridge.codec import Row, Wire
from mavlink_bridge.command_latency import SENT, CommandLatency, compare_report
from mavlink_bridge.compiled_crc import crc
from mavlink_bridge.framing import HEADER_SIZE, MAGIC_V2
from mavlink_bridge.vehicle_params import Outputs, motor_commands
from mavlink_bridge.vehicle_view import VehicleView
from mavlink_bridge.watchdogs import Watchdogs

KINDS: Final = (m.HighresImu, m.AttitudeQuaternion, m.LocalPositionNed, m.ServoOutputRaw)
IMU, ATTITUDE, POSITION, MOTORS = range(1, 5)
"""Their numbers; an order of messages is an octal number with these digits, the first one first."""
_MESSAGES = [m.BY_EVENT[kind] for kind in KINDS]
NUMBERS: Final = {row.id: number for number, row in enumerate(_MESSAGES, 1)}
"""By id."""
_TYPES = {"float": 0, "uint8_t": 1, "uint16_t": 2, "uint32_t": 3, "uint64_t": 4}
_HIGHEST_US = 1e15
"""Stamps up to here are whole numbers as floats too."""


def _sources(message: Row) -> list[tuple[str, Wire]]:
    """Where an event's fields come from: its stamp, then the tuples, then the rest."""
    stamp, *others = message.wires.items()
    return [stamp, *sorted(others, key=lambda source: not message.is_tuple(source[1]))]


def _elements(number: int) -> Iterator[tuple[int, int, int, bool]]:
    """Of each number of a message, as `_sources` has them: offset in the payload, type, factor, must be finite."""
    row, offset = _MESSAGES[number - 1], 0
    elements, offsets = row.elements(), []
    for element in elements:
        offsets.append(offset)
        offset += element.field.size // element.field.elements
    for name, source in _sources(row):
        assert not source.per
        for index in row.element_indices(source):
            field = elements[index].field
            yield offsets[index], _TYPES[field.type], source.times, field.is_float and name not in row.nan


_COLUMNS = [list(_elements(number)) for number in NUMBERS.values()]
_COUNTS = np.array([0, *map(len, _COLUMNS)])
AT: Final = (0, *(int(place) for place in np.cumsum(_COUNTS)))
"""Where each message's numbers begin in the row, by its number, first its stamp; last, how many there are."""
DOWN, VEL_DOWN = AT[POSITION] + 3, AT[POSITION] + 6
"""Where height and vertical velocity stand in the row, NED."""
_TABLE = np.zeros((1 + len(KINDS), max(_COUNTS), 4), np.int64)
for _number, _column in enumerate(_COLUMNS, 1):
    _TABLE[_number, : len(_column)] = _column
_PLACES, _SIZES = np.array(AT), np.array([0, *(row.size for row in _MESSAGES)])
_EXTRAS = np.array([0, *(row.crc_extra for row in _MESSAGES)])
_NUMBER_OF = np.array([NUMBERS.get(number, 0) for number in range(256)])
_LONGEST = -(-max(row.size for row in _MESSAGES) // 8) * 8
_ORDERS: Final = {
    sum(number << 3 * place for place, number in enumerate(reversed(order))): order
    for count in range(1, 1 + len(KINDS))
    for order in permutations(range(1, 1 + len(KINDS)), count)
}
_IDS = frozenset(NUMBERS)


class Heard:
    """Some of these messages, from one datagram; each kind at most once."""

    __slots__ = ("order", "row")

    def __init__(self, order: int, row: F64) -> None:
        self.order = order
        self.row = row
        """All numbers, at the places that `AT` says; what did not come is undefined.  Never written to again."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """Which came, in their order."""
        return _ORDERS[self.order]


class Taking:
    """Takes them into what a companion knows of its vehicle and into its watchdogs."""

    def __init__(self, view: VehicleView, watch: Watchdogs) -> None:
        streams, latency = view.streams, view.latency
        self._view, self._watch = view, watch
        self._rows = (
            streams.row, streams.observer.row, streams.imu_bias.row, watch.estimate.row, view.params.outputs_row,
            latency.sent_row, latency.square_row,
        )  # fmt: skip

    def take(self, heard: Heard, now_us: int) -> None:
        """As `VehicleView.update` and `Watchdogs.see` take them one by one, at local time `now_us`."""
        view, watch, row, order = self._view, self._watch, heard.row, heard.order
        resets, flying, jumped = watch.resets, watch.is_flying, False
        while order := _HEAR.call(row, order, self._rows, resets.shift_ned_m, flying, jumped):
            watch.has_stepped(int(row.item(AT[POSITION])))
            jumped = True
        view.heard_at_us = now_us
        for number in heard.numbers:
            view.counts[KINDS[number - 1]] += 1
            if number == IMU:
                stamp_us = int(row.item(AT[IMU]))
                watch.note_stamp(stamp_us)
                view.clock.observe(stamp_us, now_us)
            elif number == POSITION and flying and not jumped:
                watch.has_stepped(int(row.item(AT[POSITION])))
            elif number == MOTORS:
                view.latency.look()


class FrequentReader:
    """Reads runs of one sender's messages; what `Link.read_runs` wants."""

    def __init__(self, system: int, component: int) -> None:
        self.source = system << 8 | component
        """Whose messages are read."""

    def read(self, data: bytes, at: int, sequence: int) -> tuple[int, int, Heard | None]:
        """What begins at `at`, its sequence number given: where it ends, how many messages, and these."""
        if at + HEADER_SIZE > len(data) or data[at + 7] not in _IDS:
            return at, 0, None
        row = np.empty(AT[-1])
        found = _READ.call(data, at, sequence, self.source, row)
        order, end = found & 0xFFF, found >> 12
        return (end, len(_ORDERS[order]), Heard(order, row)) if order else (at, 0, None)


@njit
def _read(data: bytes, at: int, sequence: int, source: int, row: F64) -> int:
    """Where the run ends, and its order in the last 12 bits."""
    order, end, have = 0, at, len(data)
    payload = np.empty(_LONGEST, np.uint8)
    while end + HEADER_SIZE + 2 <= have:
        size, number = data[end + 1], _NUMBER_OF[data[end + 7]]
        crc_at = end + HEADER_SIZE + size
        if data[end] != MAGIC_V2 or data[end + 2] != 0 or number == 0 or crc_at + 2 > have:
            break
        if data[end + 8] != 0 or data[end + 9] != 0 or data[end + 4] != sequence:
            break
        if data[end + 5] << 8 | data[end + 6] != source:
            break
        if crc(data, end + 1, crc_at, _EXTRAS[number]) != data[crc_at] | data[crc_at + 1] << 8:
            break
        for k in range(_LONGEST):
            payload[k] = data[end + HEADER_SIZE + k] if k < size else 0
        if _has(order, number) or not _decode(number, payload, row):
            break
        order, end, sequence = order * 8 + number, crc_at + 2, (sequence + 1) & 0xFF
    return end << 12 | order


@njit
def _has(order: int, number: int) -> bool:
    """Whether a number is among an order's digits."""
    while order:
        if order & 7 == number:
            return True
        order >>= 3
    return False


@njit
def _decode(number: int, payload: U8, row: F64) -> bool:
    """A message's numbers into the row; False where one is not as usual."""
    floats, words, longs = payload.view(np.float32), payload.view(np.uint32), payload.view(np.uint64)
    at = _PLACES[number]
    for k in range(_COUNTS[number]):
        offset, kind, times, finite = _TABLE[number, k]
        if kind == 0:
            value = np.float64(floats[offset >> 2])
            if finite and not math.isfinite(value):
                return False
        elif kind == 1:
            value = np.float64(payload[offset])
        elif kind == 2:
            value = np.float64(payload[offset] | payload[offset + 1] << 8)  # may lie at an odd place
        elif kind == 3:
            value = np.float64(words[offset >> 2])
        else:
            value = np.float64(longs[offset >> 3])
        row[at + k] = value * times
    return row[at] <= _HIGHEST_US and (number != MOTORS or row[at + 17] == 0.0)  # what motors have is on port 0


@njit
def _hear(
    row: F64, order: int, rows: tuple[F64, F64, F64, F64, F64, F64, F64], shift: Tuple3, flying: bool, watched: bool
) -> int:  # fmt: skip
    """Take messages in their order; what is left of it: from a position on that jumped, nearly always nothing.

    `rows`: of Streams, its observer and its accelerometer's bias, EstimateWatch, Outputs, CommandLatency (two).
    `flying`: positions are shifted, and jumps looked for; `watched`: the first is a position that was looked at.
    """
    streams, observed, bias, watch, outputs, sent, square = rows
    sample, above = np.empty(7), 0
    while order >> above:
        above += 3
    while above:
        above -= 3
        number = order >> above & 7
        at = _PLACES[number]
        t_us = row[at]
        sample[:] = row[at + 1 : at + 8]
        if number == IMU:
            watch_imu(watch, t_us, sample[:6])
            take_imu(streams, bias, t_us, sample[:6])
        elif number == ATTITUDE:
            watch_attitude(watch, t_us, sample)
            take_attitude(streams, t_us, sample)
        elif number == POSITION:
            if not watched and watch_position(watch, t_us, sample[:6]) >= JUMP_M and flying:
                return order & (8 << above) - 1
            if flying:
                for i in range(3):
                    sample[i] -= shift[i]
            take_position(streams, observed, t_us, sample[:6])
        else:
            commands = motor_commands(row[at + 1 : at + 17], outputs)
            take_motors(streams, t_us, commands)
            compare_report(sent, square, t_us, commands)
        watched = False
    return 0


_READ = Entry(_read, "Bytes(u1, 1, 'C'), i8, i8, i8, f8[::1]")
_HEAR = Entry(_hear, "f8[::1], i8, UniTuple(f8[::1], 7), UniTuple(f8, 3), b1, b1")


def prepare() -> None:
    """Make every codec now, and load what the first commands and datagrams call: for loops in real time."""
    m.prepare()
    for entry in (_READ, _HEAR, SENT):
        entry.prepare()
    motors = Outputs().commands((1500,) * 16)  # a report that comes by itself, as by a link that delays, is taken so
    CommandLatency().reported(0, motors)
    Streams().motors(0, motors)
