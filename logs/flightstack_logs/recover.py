"""A cut-off or damaged MCAP mended: all that can be read in a new file that is whole, and what was lost in words."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mcap.writer import CompressionType, Writer

from flightstack.types import InputError
from flightstack_logs.info import info
from flightstack_logs.mcap_file import McapChannel, McapContent, scan
from flightstack_logs.reader import bytes_of, read


class Recovered(NamedTuple):
    """What was saved, and what was not."""

    messages: int
    """As `log info` counts them in the new file: the rows of blocks, not the blocks."""
    topics: int
    lost: tuple[str, ...]
    """One line each; empty where the file was whole."""


def recover(source: Path, path: Path) -> Recovered:
    """Write what `source` still holds to `path`, a new file; InputError, one line, where that can't be done."""
    data = bytes_of(source)
    if path.exists():
        raise InputError(f"log {path}: exists already; choose another name or remove it")
    content = scan(data, str(source))
    if (
        not any(channel.messages for channel in content.channels.values())
        and not content.attachments
        and not content.metadata
    ):
        raise InputError(f"log {source}: holds nothing that can be read; there is nothing to recover")
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as file:
            _write(content, Writer(file, compression=CompressionType.LZ4))
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"log {path}: can't be written ({error.strerror or error}); {source} is as it was") from None
    saved = info(read(path))
    return Recovered(saved.messages, sum(bool(topic.messages) for topic in saved.topics), tuple(content.notes))


def _write(content: McapContent, out: Writer) -> None:
    out.start()
    for name, entries in content.metadata.items():
        out.add_metadata(name, entries)
    for item in content.attachments:
        out.add_attachment(0, 0, item.name, item.media_type, item.data)
    numbers: dict[int, int] = {}
    schemas: dict[tuple[str, str, bytes], int] = {}
    for number, channel in content.channels.items():
        schema = 0
        if channel.schema is not None:
            key = channel.schema.name, channel.schema.encoding, channel.schema.data
            if key not in schemas:
                schemas[key] = out.register_schema(*key)
            schema = schemas[key]
        numbers[number] = out.register_channel(channel.topic, channel.message_encoding, schema, channel.metadata)
    counts = dict.fromkeys(numbers, 0)
    for time_ns, number, data in heapq.merge(*(_in_file_order(n, c) for n, c in content.channels.items())):
        out.add_message(numbers[number], time_ns, data, time_ns, counts[number])
        counts[number] += 1
    out.finish()  # type: ignore[no-untyped-call]


def _in_file_order(number: int, channel: McapChannel) -> Iterator[tuple[int, int, bytes]]:
    for time_ns, data in zip(channel.times_ns, channel.messages, strict=True):
        yield time_ns, number, data
