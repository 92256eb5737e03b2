"""What a flight's log holds of the vehicle's messages, as the companion was given them: same values, same order.

The tables /vehicle/... carry what the wire carried (single precision, stamps); what decides something and has no table
stands in /vehicle/message.  Together they are all that the companion goes by.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from flightstack.types import InputError
from flightstack_logs.tables import Log, Messages, Table
from flightstack_logs.topics import MESSAGE
from mavlink_bridge import messages as m

_ZERO = (0.0, 0.0, 0.0)


class Input(NamedTuple):
    """A message and when the companion had it."""

    t_us: int
    """Log time."""
    place: int
    message: Any


def _attitude(table: Table) -> Iterator[Any]:
    for row in _rows(table, "t_boot_us", "q_ned_frd", "rate_frd_radps"):
        yield m.AttitudeQuaternion(row[0], tuple(row[1]), tuple(row[2]))


def _position(table: Table) -> Iterator[Any]:
    for row in _rows(table, "t_boot_us", "pos_ned_m", "vel_ned_mps"):
        yield m.LocalPositionNed(row[0], tuple(row[1]), tuple(row[2]))


def _imu(table: Table) -> Iterator[Any]:
    for row in _rows(table, "t_us", "accel_frd_mps2", "rate_frd_radps"):
        yield m.HighresImu(row[0], tuple(row[1]), tuple(row[2]), _ZERO, 0.0, 0.0, 0.0, 0.0, 0)


def _motors(table: Table) -> Iterator[Any]:
    for row in _rows(table, "t_us", "pwm_us"):
        yield m.ServoOutputRaw(row[0], 0, tuple(row[1]))


def _rows(table: Table, *columns: str) -> Iterator[tuple[Any, ...]]:
    return zip(*(table[name].tolist() for name in columns), strict=True)


_MADE_OF: dict[str, Callable[[Table], Iterator[Any]]] = {
    "/vehicle/attitude": _attitude,
    "/vehicle/local_position": _position,
    "/vehicle/imu": _imu,
    "/vehicle/motors": _motors,
}


def _others(raw: Messages) -> Iterator[Any]:
    for data in raw.data:
        row = m.BY_ID.get(int.from_bytes(data[:3], "little"))
        message = None if row is None or len(data) < 3 + row.size else row.decode(data, 3)
        if message is None:
            raise InputError("holds a message that this version does not know")
        yield message


def recorded_inputs(log: Log) -> list[Input]:
    """Every message that the companion went by, in its order; InputError where the log does not hold them."""
    try:
        parts: list[tuple[Table | Messages, Iterator[Any]]] = [
            (log.tables[topic], make(log.tables[topic])) for topic, make in _MADE_OF.items() if topic in log.tables
        ]
        parts.append((log.messages[MESSAGE], _others(log.messages[MESSAGE])))
        found: list[Input] = []
        for source, made in parts:
            if source.place is None:
                raise KeyError(source.name)
            found += map(Input._make, zip(source.t_us.tolist(), source.place.tolist(), made, strict=True))
    except KeyError as error:
        raise InputError(
            f"log {log.path}: has not kept all that the vehicle said ({error}); nothing to replay"
        ) from None
    except InputError as error:
        raise InputError(f"log {log.path}: {error}; replay it with the version that flew") from None
    found.sort(key=lambda each: (each.t_us, each.place))
    return found
