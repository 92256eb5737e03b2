"""MCAP in: this project's own logs, and others' as far as their schemas are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flightstack.types import I64, U8
from flightstack_logs import rows
from flightstack_logs.log_clock import aligned
from flightstack_logs.mcap_file import McapChannel, McapContent, scan
from flightstack_logs.tables import About, Log, Messages, Table
from flightstack_logs.topics import LEVELS
from flightstack_logs.wire import decode_columns, walk


def read_mcap(path: Path, data: bytes, *, align: bool = True) -> Log:
    """The log in `data`; damage is in its notes.  `align`: the vehicle's stamps on the log's time line."""
    content = scan(data, str(path))
    notes = list(content.notes)
    blocks = {each.topic: each for each in content.channels.values() if each.topic.startswith(rows.PREFIX)}
    tables: dict[str, Table] = {}
    messages: dict[str, Messages] = {}
    about: dict[str, About] = {}
    for channel in _with_packed(content, blocks):
        if channel.topic in about:
            notes.append(f"topic {channel.topic}: has a second channel; skipped")
            continue
        about[channel.topic] = _about(channel)
        bodies: list[bytes] | U8
        times, bodies = _in_time(channel)
        places = None
        try:
            if (block := blocks.get(rows.PREFIX + channel.topic)) is not None and block.messages:
                packed = rows.unpack(block.messages)
                times, bodies, places = packed.t_us, packed.messages, packed.place
            columns = _columns(channel, bodies)
        except (ValueError, KeyError) as error:
            columns = None
            notes.append(f"topic {channel.topic}: kept as raw messages, {error}")
        if columns is None:
            data_of = bodies if isinstance(bodies, list) else [row.tobytes() for row in bodies]
            messages[channel.topic] = Messages(channel.topic, times, data_of, places)
        else:
            tables[channel.topic] = Table(channel.topic, times, columns, _units(channel), places)
    return Log(
        path=path,
        kind="mcap",
        complete=content.finished and not content.notes,
        notes=tuple(notes),
        tables=aligned(tables) if align else tables,
        messages=messages,
        about=about,
        metadata=content.metadata,
        attachments=tuple(content.attachments),
        size_bytes=len(data),
    )


def _with_packed(content: McapContent, blocks: dict[str, McapChannel]) -> list[McapChannel]:
    """The topics of a log; blocks of rows are no topics, but one of which there is nothing else is."""
    found = [channel for channel in content.channels.values() if channel.topic not in blocks]
    known = {channel.topic for channel in found}
    alone = [name.removeprefix(rows.PREFIX) for name in blocks]
    return found + [McapChannel(topic, "", {"kind": "raw"}, None) for topic in alone if topic not in known]


def _in_time(channel: McapChannel) -> tuple[I64, list[bytes]]:
    """Log times in microseconds and the messages, in ascending order of time (equal times: as written)."""
    times = (np.array(channel.times_ns, dtype=np.uint64) // np.uint64(1000)).astype(np.int64)
    if len(times) < 2 or bool(np.all(times[1:] >= times[:-1])):
        return times, channel.messages
    order = np.argsort(times, kind="stable")
    return times[order], [channel.messages[index] for index in order.tolist()]


def _columns(channel: McapChannel, bodies: list[bytes] | U8) -> dict[str, np.ndarray] | None:
    """The messages as columns, or None where they are not meant to be."""
    schema = channel.schema
    if schema is None or channel.message_encoding != "protobuf" or not len(bodies):
        return None
    if schema.name == "foxglove.Log" and isinstance(bodies, list):
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


def _about(channel: McapChannel) -> About:
    said = channel.metadata
    try:
        rate_hz = float(said.get("rate_hz", "0"))
    except ValueError:
        rate_hz = 0.0
    schema = channel.schema.name if channel.schema else channel.message_encoding
    return About(said.get("kind", ""), schema, said.get("description", ""), said.get("source", ""), rate_hz)


def _units(channel: McapChannel) -> dict[str, str]:
    """Field -> unit out of the channel's own metadata (`field.NAME` = `unit: meaning`)."""
    pairs = [(key[6:], value.partition(":")[0]) for key, value in channel.metadata.items() if key.startswith("field.")]
    return {name: "" if unit == "-" else unit for name, unit in pairs}
