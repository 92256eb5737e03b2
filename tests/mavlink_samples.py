"""Random values for every row of the message table, in the wire's own terms: the tests' side of the conversion.

The unit factors stand here a second time, for the units that pymavlink's dialect states: the oracle of the table.
"""

from __future__ import annotations

import random
import struct
from typing import Any

from mavlink_bridge.codec import Row
from mavlink_bridge.layout import LACKING, WireField, dialect
from mavlink_bridge.messages import MESSAGES

IN_DIALECT = [row for row in MESSAGES if row.name not in LACKING]
_BY_NAME = {message.msgname: message for message in dialect.mavlink_map.values()}
_TEXT = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_0123456789 .,:-"

UNIT_FACTORS = {
    "ms": ("us", 1000),
    "us": ("us", 1),
    "ns": ("ns", 1),
    "s": ("s", 1),
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "m": ("m", 1),
    "mm/s": ("mps", 1e-3),
    "cm/s": ("mps", 1e-2),
    "m/s": ("mps", 1),
    "m/s/s": ("mps2", 1),
    "mG": ("mps2", 9.80665e-3),
    "rad": ("rad", 1),
    "rad/s": ("radps", 1),
    "mrad/s": ("radps", 1e-3),
    "deg": ("deg", 1),
    "cdeg": ("deg", 1e-2),
    "degE5": ("deg", 1e-5),
    "degE7": ("deg", 1e-7),
    "degC": ("degc", 1),
    "cdegC": ("degc", 1e-2),
    "hPa": ("hpa", 1),
    "gauss": ("gauss", 1),
    "mgauss": ("gauss", 1e-3),
    "mV": ("v", 1e-3),
    "cA": ("a", 1e-2),
    "mAh": ("mah", 1),
    "hJ": ("hj", 1),
    "Hz": ("hz", 1),
}
"""Unit of the dialect -> (suffix of our field's name, our value per wire value)."""

SCALED_WITHOUT_UNIT = {"eph": 1e-2, "epv": 1e-2}
"""Wire fields that MAVLink's text scales ("unitless * 100") without a unit."""


def dialect_class(row: Row) -> Any:
    """pymavlink's class of a row's message."""
    return _BY_NAME[row.name]


def float32(value: float) -> float:
    """The nearest float32."""
    result: float = struct.unpack("<f", struct.pack("<f", value))[0]
    return result


def random_wire_value(field: WireField, rng: random.Random) -> Any:
    """One value, or a list for an array, of a wire field: any that its type can hold, floats finite."""
    if field.is_bytes:
        if field.type == "char":
            return "".join(rng.choice(_TEXT) for _ in range(rng.randint(0, field.length)))
        return rng.randbytes(field.length)
    values = [_scalar(field, rng) for _ in range(field.elements)]
    return values if field.length else values[0]


def _scalar(field: WireField, rng: random.Random) -> float | int:
    if field.is_float:
        return float32(rng.choice([0.0, 1.0, -2.5, 3.3e38, 1e-42, rng.gauss(0.0, 1.0), rng.uniform(-1e4, 1e4)]))
    low, high = field.integer_range
    return rng.choice([low, high, 0, 1, rng.randint(low, high), rng.randint(max(low, -1000), min(high, 1000))])


def random_wire_values(row: Row, rng: random.Random) -> dict[str, Any]:
    """Every field of a row's layout."""
    return {field.name: random_wire_value(field, rng) for field in row.layout.fields}


def payload_of(row: Row, values: dict[str, Any]) -> bytes:
    """The whole payload of these values."""
    flat: list[Any] = []
    for field in row.layout.fields:
        value = values[field.name]
        flat += [value.encode() if isinstance(value, str) else value] if field.is_bytes or not field.length else value
    return struct.pack("<" + "".join(field.format for field in row.layout.fields), *flat)


def random_event(row: Row, rng: random.Random) -> Any:
    """An event as it would come in, all of its values finite."""
    values = random_wire_values(row, rng)
    return row.decode(payload_of(row, values).ljust(row.size, b"\0"), 0)
