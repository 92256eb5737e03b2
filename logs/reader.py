"""Logs in: `read(path)` gives any supported log as typed tables; the kind of file is told by its content.

Today MCAP.  A further kind is one row in `_KINDS`: how its files begin and the function that reads them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flightstack.types import InputError
from logs.mcap_file import MAGIC, Channel, scan
from logs.topics import LEVELS, Attachment
from logs.wire import decode_columns, walk


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The messages of one topic as columns."""

    name: str
    t_us: NDArray[np.int64]
    """(N,) log time: the vehicle's time, microseconds since its boot, ascending."""
    columns: dict[str, np.ndarray]
    """Field -> (N,) or (N, k); float64, int64, bool or str."""
    units: dict[str, str]
    """Field -> unit, as the log says."""

    def __len__(self) -> int:
        return len(self.t_us)

    def __getitem__(self, column: str) -> np.ndarray:
        return self.columns[column]


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """The messages of one topic as they were logged: raw MAVLink, viewer messages, anything that is no table."""

    name: str
    t_us: NDArray[np.int64]
    """(N,) as in `Table`."""
    data: list[bytes]

    def __len__(self) -> int:
        return len(self.t_us)


@dataclass(frozen=True, slots=True)
class About:
    """What a log says about one of its topics."""

    kind: str
    """table, raw, log or view; empty in a log of other origin."""
    schema: str
    description: str
    source: str
    rate_hz: float
    """Nominal, 0 where none."""


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A whole log."""

    path: Path
    kind: str
    """Kind of file: mcap."""
    complete: bool
    """False where the file was cut off or is damaged; `notes` says how."""
    notes: tuple[str, ...]
    tables: dict[str, Table]
    messages: dict[str, Messages]
    about: dict[str, About]
    metadata: dict[str, dict[str, str]]
    attachments: tuple[Attachment, ...]
    size_bytes: int

    @property
    def span_us(self) -> tuple[int, int]:
        """First and last log time; (0, 0) in an empty log."""
        all_times = [table.t_us for table in self.tables.values()] + [raw.t_us for raw in self.messages.values()]
        times = [t for t in all_times if len(t)]
        if not times:
            return 0, 0
        return min(int(t[0]) for t in times), max(int(t[-1]) for t in times)

    def attachment(self, name: str) -> bytes | None:
        """Content of the attachment of that name."""
        return next((item.data for item in self.attachments if item.name == name), None)


def read(path: Path | str) -> Log:
    """Read a log, a cut-off one up to its last whole chunk; InputError, one line, where there is none to read."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"log {path}: can't be read ({error.strerror}); check the path") from None
    if not data:
        raise InputError(f"log {path}: is empty; nothing was ever written to it")
    for beginning, reader in _KINDS:
        if data.startswith(beginning):
            return reader(path, data)
        if beginning.startswith(data):
            raise InputError(f"log {path}: is cut off within its first bytes; there is nothing to read in it")
    raise InputError(f"log {path}: is of no known kind (known: .mcap); name a flight log")


def _read_mcap(path: Path, data: bytes) -> Log:
    content = scan(data, str(path))
    notes = list(content.notes)
    tables: dict[str, Table] = {}
    messages: dict[str, Messages] = {}
    about: dict[str, About] = {}
    for channel in content.channels.values():
        if channel.topic in about:
            notes.append(f"topic {channel.topic}: has a second channel; skipped")
            continue
        about[channel.topic] = _about(channel)
        times, bodies = _in_time(channel)
        try:
            columns = _columns(channel, bodies)
        except (ValueError, KeyError) as error:
            columns = None
            notes.append(f"topic {channel.topic}: kept as raw messages, {error}")
        if columns is None:
            messages[channel.topic] = Messages(channel.topic, times, bodies)
        else:
            tables[channel.topic] = Table(channel.topic, times, columns, _units(channel))
    return Log(
        path=path,
        kind="mcap",
        complete=content.finished and not content.notes,
        notes=tuple(notes),
        tables=tables,
        messages=messages,
        about=about,
        metadata=content.metadata,
        attachments=tuple(content.attachments),
        size_bytes=len(data),
    )


def _in_time(channel: Channel) -> tuple[NDArray[np.int64], list[bytes]]:
    """Log times in microseconds and the messages, in ascending order of time (equal times: as written)."""
    times = (np.array(channel.times_ns, dtype=np.uint64) // np.uint64(1000)).astype(np.int64)
    if len(times) < 2 or bool(np.all(times[1:] >= times[:-1])):
        return times, channel.messages
    order = np.argsort(times, kind="stable")
    return times[order], [channel.messages[index] for index in order.tolist()]


def _columns(channel: Channel, bodies: list[bytes]) -> dict[str, np.ndarray] | None:
    """The messages as columns, or None where they are not meant to be."""
    schema = channel.schema
    if schema is None or channel.message_encoding != "protobuf" or not bodies:
        return None
    if schema.name == "foxglove.Log":
        return _log_columns(bodies)
    if schema.name.startswith("flightstack."):
        return decode_columns(schema.data, schema.name, bodies)
    return None


def _log_columns(bodies: list[bytes]) -> dict[str, np.ndarray]:
    """Columns level, name, text of `foxglove.Log` messages (level 2, message 3, name 4)."""
    rows = [dict(walk(body)) for body in bodies]
    levels = dict(enumerate(LEVELS))
    return {
        "level": np.array(
            [levels.get(level, LEVELS[0]) if isinstance(level := row.get(2, 0), int) else "" for row in rows]
        ),
        "name": np.array([_text(row.get(4, b"")) for row in rows]),
        "text": np.array([_text(row.get(3, b"")) for row in rows]),
    }


def _text(value: int | bytes) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _about(channel: Channel) -> About:
    said = channel.metadata
    try:
        rate_hz = float(said.get("rate_hz", "0"))
    except ValueError:
        rate_hz = 0.0
    schema = channel.schema.name if channel.schema else channel.message_encoding
    return About(said.get("kind", ""), schema, said.get("description", ""), said.get("source", ""), rate_hz)


def _units(channel: Channel) -> dict[str, str]:
    """Field -> unit out of the channel's own metadata (`field.NAME` = `unit: meaning`)."""
    pairs = [(key[6:], value.partition(":")[0]) for key, value in channel.metadata.items() if key.startswith("field.")]
    return {name: "" if unit == "-" else unit for name, unit in pairs}


_KINDS: tuple[tuple[bytes, Callable[[Path, bytes], Log]], ...] = ((MAGIC, _read_mcap),)
