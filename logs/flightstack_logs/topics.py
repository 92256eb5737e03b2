"""The one table of log topics: what each carries, in which units and frames, how often and where it comes from.

A topic is one table of `topics.toml`; writer, reader, `log info` and the round-trip test walk them.  The log time of a
message counts from 0 at the log's start (`log_clock`), microseconds in the API, nanoseconds in the file.
Names keep their meaning across topics: `pos_ned_m` is a position, north-east-down, whether it is the truth's, the
estimate's or the setpoint's.  Viewer topics (`Kind.VIEW`) are in Foxglove's well-known schemas, in frames `world` (ENU)
and `body` (FLU); they repeat what the tables say and are never read back.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from enum import Enum
from importlib import resources
from typing import Any


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a TABLE topic."""

    name: str
    type: str
    """double, float, int64, int32, bool or string."""
    size: int
    """0 for a scalar, else the length of the array."""
    unit: str
    text: str
    path: str = ""
    """Attribute path within the record, where it isn't the name."""


class Kind(Enum):
    """How a topic's messages are encoded."""

    TABLE = "table"
    """Protocol buffer of this project, fields of fixed size: numbers read back as columns."""
    RAW = "raw"
    """Bytes as they were on the wire."""
    LOG = "log"
    """`foxglove.Log`: a line of text with a level; read back as columns `level`, `name`, `text`."""
    VIEW = "view"
    """A Foxglove message for the 3-D or map view."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One row: a topic of the log."""

    name: str
    kind: Kind
    schema: str
    rate_hz: float
    """Nominal; 0 where messages come as things happen."""
    source: str
    text: str
    fields: tuple[Field, ...] = ()

    @property
    def packed(self) -> bool:
        """Whether a compact log (`rows`) holds its messages packed, beside a thinned copy for viewers."""
        return self.name == MESSAGE or (self.kind is Kind.TABLE and self.rate_hz >= _PACKED_FROM_HZ)


MESSAGE = "/vehicle/message"
"""What the vehicle sent that decides something and stands in no table: replay needs it."""
_PACKED_FROM_HZ = 20.0


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file carried inside the log: vehicle file, scenario, settings."""

    name: str
    media_type: str
    data: bytes

    @classmethod
    def of_text(cls, name: str, text: str) -> Attachment:
        """A text file; its name's ending says what it is."""
        return cls(name, f"application/{name.rpartition('.')[2]}", text.encode())


SITE_OUTLINES = "site-outlines.json"
"""Attachment of a flight in a site: its lines in metres from the place of arming."""
CERTIFICATE, FINAL_CERTIFICATE = "certificate.json", "certificate-final.json"
RESULT = "result.json"
"""Attachments: the certificate that a flight began with, and the last one that was made in flight."""

LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")
"""Levels of `foxglove.Log`, by number."""

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
"""MAVLink's severities, by number."""

_LEVEL_OF_SEVERITY = ("fatal", "fatal", "fatal", "error", "warning", "info", "info", "debug")


def severity_names(severity: int) -> tuple[str, str]:
    """Foxglove level and MAVLink name of a MAV_SEVERITY; numbers out of range count as the nearest."""
    number = min(max(severity, 0), len(SEVERITIES) - 1)
    return _LEVEL_OF_SEVERITY[number], SEVERITIES[number]


FILTER_STATUS = ("nothing certified", "not engaged", "passed", "changed", "infeasible", "not solved", "falsified")
"""Status of the barrier filter, by number; from `infeasible` on its fallback acts."""


def _topic(name: str, row: dict[str, Any]) -> Topic:
    fields = tuple(Field(*field) for field in row.pop("fields", ()))
    return Topic(name, Kind(row.pop("kind")), **row, fields=fields)


_TABLE = tomllib.loads(resources.files("flightstack_logs").joinpath("topics.toml").read_text(encoding="utf-8"))
TOPICS: dict[str, Topic] = {name: _topic(name, row) for name, row in _TABLE.items()}
"""Name -> topic, in the order of `topics.toml`, which holds them."""
