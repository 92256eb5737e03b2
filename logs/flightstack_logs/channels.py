"""An open topic of a log that is being written: its channel, its schema and how its records are encoded."""

from __future__ import annotations

import foxglove
import foxglove.messages
import numpy as np

from flightstack_logs import rows
from flightstack_logs.encoder import Encoder, NumbersEncoder, make_encoder
from flightstack_logs.topics import Kind, Topic
from flightstack_logs.wire import descriptor


class Channel:
    """An open topic: where its messages go and how each type of record is encoded."""

    __slots__ = ("_topic", "base", "copy_due_us", "encoders", "held", "is_log", "is_shown", "log", "numbers", "packed")

    def __init__(self, topic: Topic, context: foxglove.Context, *, packed: bool) -> None:
        schema, encoding = _schema(topic)
        channel = foxglove.Channel(
            topic.name, schema=schema, message_encoding=encoding, context=context, metadata=_channel_metadata(topic)
        )
        self._topic = topic
        self.base = channel
        self.log = channel.base.log
        self.is_log = topic.kind is Kind.LOG
        self.packed = packed
        self.copy_due_us = 0
        self.is_shown = topic.kind is Kind.TABLE
        self.encoders: dict[type, Encoder] = {}
        self.numbers: NumbersEncoder | None = None
        """Of rows of numbers; None before the first."""
        self.held: rows.Numbers | None = None
        """Where they are held until the chunk ends (`rows.RowBlocks.hold`)."""

    def open_numbers(self) -> NumbersEncoder:
        """From now on rows of numbers can be encoded."""
        numbers = self.numbers = NumbersEncoder(self._topic)
        self.encoders[np.ndarray] = lambda row: numbers.encode(row[np.newaxis]).tobytes()
        return numbers

    def encode(self, record: object) -> bytes:
        """Encode a record that the kept encoders don't know or can't do; keep the encoder that could."""
        kind = type(record)
        if kind is np.ndarray and self._topic.kind is Kind.TABLE:
            self.open_numbers()
            return self.encoders[kind](record)
        if self._topic.kind is not Kind.TABLE:
            self.encoders[kind] = bytes
            return bytes(record)  # type: ignore[call-overload, no-any-return]
        encoder = make_encoder(self._topic, record, blocks=kind not in self.encoders)
        data = encoder(record)
        self.encoders[kind] = encoder
        return data


def _schema(topic: Topic) -> tuple[foxglove.Schema, str]:
    """Schema and message encoding of a topic."""
    if topic.kind is Kind.RAW:
        return foxglove.Schema(name=topic.schema, encoding="", data=b""), "mavlink"
    if topic.kind is Kind.TABLE:
        return foxglove.Schema(name=topic.schema, encoding="protobuf", data=descriptor(topic)), "protobuf"
    schema: foxglove.Schema = getattr(foxglove.messages, topic.schema.removeprefix("foxglove.")).get_schema()
    return schema, "protobuf"


def _channel_metadata(topic: Topic) -> dict[str, str]:
    """What the file itself says about a topic: meaning, source, nominal rate, `unit: meaning` of each field."""
    about = {
        "description": topic.text,
        "source": topic.source,
        "rate_hz": f"{topic.rate_hz:g}",
        "kind": topic.kind.value,
    }
    return about | {f"field.{field.name}": f"{field.unit or '-'}: {field.text}" for field in topic.fields}


def block_channel(topic: str, context: foxglove.Context) -> foxglove.Channel:
    """Where the blocks of a topic's rows go (`rows`)."""
    about = {"description": f"all of {topic}, packed (`flightstack log` unpacks it)", "kind": "rows"}
    schema = foxglove.Schema(name=rows.SCHEMA_NAME, encoding="protobuf", data=rows.schema())
    return foxglove.Channel(
        rows.PREFIX + topic, schema=schema, message_encoding="protobuf", context=context, metadata=about
    )
