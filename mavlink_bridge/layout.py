"""Layouts of MAVLink messages on the wire: fields in wire order, struct format and the CRC extra byte.

pymavlink's `development` dialect is used as data only: names, types, array lengths, CRC extras and
enum values (`dialect`).  What it lacks is written as MAVLink's XML would say it; layout and CRC extra then follow from
MAVLink's own rules: fields sorted by size, largest first, extensions after them in the order given; the CRC extra
hashes names and types.
Source: mavlink.io/en/guide/serialization.html.
"""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct
from typing import Any

import pymavlink.dialects.v20.development as _development
from fastcrc.crc16 import mcrf4xx

dialect: Any = _development
"""pymavlink's dialect module: enum values by name (`dialect.MAV_CMD_DO_SET_MODE`)."""

_FORMATS = {
    "char": "c",
    "uint8_t": "B",
    "int8_t": "b",
    "uint16_t": "H",
    "int16_t": "h",
    "uint32_t": "I",
    "int32_t": "i",
    "uint64_t": "Q",
    "int64_t": "q",
    "float": "f",
    "double": "d",
}
_SIZES = {name: Struct("<" + code).size for name, code in _FORMATS.items()}


@dataclass(frozen=True, slots=True)
class WireField:
    """One field as MAVLink names it."""

    name: str
    type: str
    length: int
    """Elements of an array, 0 for a scalar."""
    unit: str = ""
    """MAVLink's, empty where it says none."""

    @property
    def is_float(self) -> bool:
        """A float or double, or an array of them."""
        return self.type in ("float", "double")

    @property
    def is_bytes(self) -> bool:
        """An array of characters or bytes, one element of the unpacked tuple."""
        return self.length > 0 and self.type in ("char", "uint8_t")

    @property
    def elements(self) -> int:
        """How many elements it has in the unpacked tuple."""
        return 1 if self.is_bytes else max(1, self.length)

    @property
    def size(self) -> int:
        """Bytes."""
        return _SIZES[self.type] * max(1, self.length)

    @property
    def format(self) -> str:
        """Its part of the struct format."""
        return f"{self.length}s" if self.is_bytes else _FORMATS[self.type] * self.elements

    @property
    def integer_range(self) -> tuple[int, int]:
        """Smallest and largest value of an integer field."""
        bits = 8 * _SIZES[self.type]
        return (0, 2**bits - 1) if self.type.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


@dataclass(frozen=True, slots=True)
class MessageLayout:
    """A message on the wire."""

    id: int
    name: str
    crc_extra: int
    fields: tuple[WireField, ...]
    """In wire order."""

    def field(self, name: str) -> WireField:
        """The field of that name; KeyError where there is none."""
        for field in self.fields:
            if field.name == name:
                return field
        raise KeyError(f"{self.name} has no field {name}")


LACKING: dict[str, tuple[int, str]] = {
    "LINK_NODE_STATUS": (
        8,
        "uint64_t timestamp, uint8_t tx_buf, uint8_t rx_buf, uint32_t tx_rate, uint32_t rx_rate, "
        "uint16_t rx_parse_err, uint16_t tx_overflows, uint16_t rx_overflows, uint32_t messages_sent, "
        "uint32_t messages_received, uint32_t messages_lost",
    ),
    "PROTOCOL_VERSION": (
        300,
        "uint16_t version, uint16_t min_version, uint16_t max_version, uint8_t spec_version_hash[8], "
        "uint8_t library_version_hash[8]",
    ),
    "TIME_ESTIMATE_TO_TARGET": (
        380,
        "int32_t safe_return, int32_t land, int32_t mission_next_item, int32_t mission_end, int32_t commanded_action",
    ),
    "COMPONENT_INFORMATION": (
        395,
        "uint32_t time_boot_ms, uint32_t general_metadata_file_crc, char general_metadata_uri[100], "
        "uint32_t peripherals_metadata_file_crc, char peripherals_metadata_uri[100]",
    ),
    "COMPONENT_METADATA": (397, "uint32_t time_boot_ms, uint32_t file_crc, char uri[100]"),
    "EVENT": (
        410,
        "uint8_t destination_component, uint8_t destination_system, uint32_t id, uint32_t event_time_boot_ms, "
        "uint16_t sequence, uint8_t log_levels, uint8_t arguments[40]",
    ),
    "CURRENT_EVENT_SEQUENCE": (411, "uint16_t sequence, uint8_t flags"),
    "REQUEST_EVENT": (
        412,
        "uint8_t target_system, uint8_t target_component, uint16_t first_sequence, uint16_t last_sequence",
    ),
    "RESPONSE_EVENT_ERROR": (
        413,
        "uint8_t target_system, uint8_t target_component, uint16_t sequence, uint16_t sequence_oldest_available, "
        "uint8_t reason",
    ),
}
"""Messages that pymavlink 2.4's dialect lacks: id, fields in the order of MAVLink's XML."""

EXTENSIONS: dict[str, str] = {
    "TIMESYNC": "uint8_t target_system, uint8_t target_component",
    "SET_ATTITUDE_TARGET": "float thrust_body[3]",
    "MISSION_CURRENT": "uint32_t mission_id, uint32_t fence_id, uint32_t rally_points_id",
    "MISSION_COUNT": "uint32_t opaque_id",
    "MISSION_ACK": "uint32_t opaque_id",
}
"""Extension fields that its dialect doesn't know yet, appended where it doesn't."""

_AS_BITS = {"param_value": "uint32_t"}
"""PX4 bit-casts integer parameters into this float: as a float, some would change on their way (signalling NaN)."""


def struct_of(fields: tuple[WireField, ...]) -> Struct:
    """A payload of these fields, little-endian, unpadded."""
    return Struct("<" + "".join(field.format for field in fields))


_BY_NAME: dict[str, Any] = {message.msgname: message for message in dialect.mavlink_map.values()}

CRC_EXTRAS: dict[int, int] = {number: message.crc_extra for number, message in dialect.mavlink_map.items()}
"""CRC extra byte by message id, of everything the dialect knows; the link adds what the table adds."""


def _parse(text: str) -> tuple[WireField, ...]:
    """Fields of a definition such as `uint32_t id, uint8_t arguments[40]`, in the order given."""
    fields = []
    for part in filter(None, text.split(",")):
        kind, name = part.split()
        name, _, length = name.partition("[")
        fields.append(WireField(name, kind, int(length.rstrip("]") or 0)))
    return tuple(fields)


def crc_extra_of(name: str, fields: tuple[WireField, ...]) -> int:
    """MAVLink's CRC extra byte of a message: name, types, names and array lengths of its base fields in wire order."""
    text = name.encode() + b" "
    for field in fields:
        text += f"{field.type} {field.name} ".encode()
        if field.length:
            text += bytes([field.length])
    crc = mcrf4xx(text)
    return (crc & 0xFF) ^ (crc >> 8)


def layout(name: str) -> MessageLayout:
    """The layout of a message by its MAVLink name."""
    if name not in _BY_NAME:
        number, definition = LACKING[name]
        fields = tuple(sorted(_parse(definition), key=lambda field: -_SIZES[field.type]))
        return MessageLayout(number, name, crc_extra_of(name, fields), fields)
    message = _BY_NAME[name]
    types = dict(zip(message.fieldnames, message.fieldtypes, strict=True)) | {
        field: bits for field, bits in _AS_BITS.items() if field in message.fieldnames
    }
    fields = tuple(
        WireField(field, types[field], length, message.fieldunits_by_name.get(field, ""))
        for field, length in zip(message.ordered_fieldnames, message.array_lengths, strict=True)
    )
    fields += tuple(field for field in _parse(EXTENSIONS.get(name, "")) if field.name not in types)
    return MessageLayout(message.id, name, message.crc_extra, fields)
