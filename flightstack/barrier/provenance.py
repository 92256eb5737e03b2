"""Where a certificate comes from: the flight's log and the vehicle file that everything in it can be derived from anew.

The log is named by SHA-256 of what the stack saw and did, tick by tick, from the learner's first tick on:

    t_us, measurement (20 doubles), its three ages, thrust_norm, rate_frd_radps, delay_s  (little-endian, 232 bytes)

integers as int64, delay_s -1 where nothing was learned from the tick.  All of it is in /tick and /command,
so a certificate made in flight can name the log that is still being written.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from flightstack.checked import only
from flightstack.types import InputError, TickRecord

_TIME, _AGES, _DELAY = struct.Struct("<q"), struct.Struct("<3qd"), struct.Struct("<d")
_KEYS = ("log_sha256", "vehicle_sha256", "from_us", "until_us")


@dataclass(frozen=True, slots=True)
class Provenance:
    """The ticks and the vehicle file behind a certificate."""

    log_sha256: str
    vehicle_sha256: str
    """Of the vehicle file's bytes."""
    from_us: int
    """The learner's first tick."""
    until_us: int
    """The last tick that was hashed."""

    def as_json(self) -> dict[str, object]:
        """Plain JSON."""
        return asdict(self)


def parse_provenance(value: object, where: str) -> Provenance:
    """From a file's table; InputError, one line that names the key."""
    if not isinstance(value, Mapping):
        raise InputError(f"{where} must be a table")
    only(value, _KEYS, where)
    for key in _KEYS[:2]:
        if not isinstance(value.get(key), str) or len(value[key]) != 64:
            raise InputError(f"{where}.{key} must be a SHA-256 in hexadecimal")
    for key in _KEYS[2:]:
        if not isinstance(value.get(key), int) or isinstance(value[key], bool) or not 0 <= value[key] < 2**53:
            raise InputError(f"{where}.{key} must be a whole number from 0")
    return Provenance(*(value[key] for key in _KEYS))


class Trail:
    """The hash of a flight's ticks while it grows; mutable."""

    __slots__ = ("_hash", "_vehicle_sha256", "from_us", "until_us")

    def __init__(self, vehicle_text: str = "") -> None:
        self._vehicle_sha256 = hashlib.sha256(vehicle_text.encode()).hexdigest()
        self.begin()

    def begin(self) -> None:
        """Forget what was before: the learner begins anew."""
        self._hash = hashlib.sha256()
        self.from_us = self.until_us = -1

    def add(self, record: TickRecord) -> None:
        """One tick, as it goes to the log."""
        seen, command = record.measurement, record.command
        delay_s = record.delay_s
        delay_s = -1.0 if math.isnan(delay_s) else delay_s
        ages_us = seen.position_age_us, seen.attitude_age_us, seen.imu_age_us
        numbers: Any = (
            _TIME.pack(record.t_us), seen.row, _AGES.pack(*ages_us, command.thrust_norm), command.rate_frd_radps,
            _DELAY.pack(delay_s),
        )  # fmt: skip
        self._hash.update(b"".join(numbers))
        self.from_us = self.from_us if self.from_us >= 0 else record.t_us
        self.until_us = record.t_us

    def provenance(self) -> Provenance | None:
        """Of what rests on the ticks so far; None before the first."""
        if self.from_us < 0:
            return None
        return Provenance(self._hash.hexdigest(), self._vehicle_sha256, self.from_us, self.until_us)
