"""What `flightstack log info` says: duration, topics with rates and units, metadata, attachments, events."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flightstack_logs.reader import Log
from flightstack_logs.standard import with_vehicle_topics

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table as RichTable

SCHEMA = "flightstack.loginfo/1"
_EVENTS_SHOWN = 40
_NAMES_SHOWN = 24
PARAMETERS = "parameters"
"""Of a log's metadata: an autopilot's."""
_EXACT = 1 << 24
"""Whole numbers up to here are exact in single precision."""


@dataclass(frozen=True, slots=True)
class FieldInfo:
    """One column of a topic."""

    name: str
    unit: str
    size: int
    """0 for a scalar, else the length of the array."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic."""

    name: str
    kind: str
    schema: str
    messages: int
    rate_hz: float | None
    """Mean over the topic's own span; None with fewer than two messages."""
    nominal_rate_hz: float | None
    source: str
    description: str
    fields: tuple[FieldInfo, ...]


@dataclass(frozen=True, slots=True)
class EventInfo:
    """One line of /events or /vehicle/statustext."""

    t_s: float
    """Since the log's first message."""
    level: str
    source: str
    name: str
    text: str


@dataclass(frozen=True, slots=True)
class LogInfo:
    """All of it."""

    path: str
    kind: str
    size_bytes: int
    complete: bool
    notes: tuple[str, ...]
    start_us: int
    """Log time of the first message."""
    duration_s: float
    messages: int
    topics: tuple[TopicInfo, ...]
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, int]
    """Name -> size in bytes."""
    events: tuple[EventInfo, ...]

    def as_json(self) -> dict[str, Any]:
        """For `--json`."""
        return {"schema": SCHEMA, **asdict(self)}


def info(log: Log) -> LogInfo:
    """Sum up a log."""
    start_us, end_us = log.span_us
    topics = tuple(_topic(log, name) for name in sorted(log.about))
    return LogInfo(
        path=str(log.path),
        kind=log.kind,
        size_bytes=log.size_bytes,
        complete=log.complete,
        notes=log.notes,
        start_us=start_us,
        duration_s=(end_us - start_us) * 1e-6,
        messages=sum(topic.messages for topic in topics),
        topics=topics,
        metadata=log.metadata,
        attachments={item.name: len(item.data) for item in log.attachments},
        events=_events(with_vehicle_topics(log)),
    )


def _topic(log: Log, name: str) -> TopicInfo:
    about = log.about[name]
    table = log.tables.get(name)
    times = table.t_us if table is not None else log.messages[name].t_us
    span_us = int(times[-1] - times[0]) if len(times) > 1 else 0
    fields: tuple[FieldInfo, ...] = ()
    if table is not None:
        fields = tuple(
            FieldInfo(column, table.units.get(column, ""), values.shape[1] if values.ndim > 1 else 0)
            for column, values in table.columns.items()
        )
    return TopicInfo(
        name=name,
        kind=about.kind or ("table" if table is not None else "raw"),
        schema=about.schema,
        messages=len(times),
        rate_hz=(len(times) - 1) * 1e6 / span_us if span_us > 0 else None,
        nominal_rate_hz=about.rate_hz or None,
        source=about.source,
        description=about.description,
        fields=fields,
    )


def _events(log: Log) -> tuple[EventInfo, ...]:
    """The lines of both text topics, by time."""
    events, start_us = [], log.span_us[0]
    for topic, source in (("/events", "companion"), ("/vehicle/statustext", "vehicle")):
        table = log.tables.get(topic)
        if table is None or not {"level", "name", "text"} <= table.columns.keys():
            continue
        for t_us, level, name, text in zip(
            table.t_us.tolist(), table["level"].tolist(), table["name"].tolist(), table["text"].tolist(), strict=True
        ):
            events.append(EventInfo((t_us - start_us) * 1e-6, level, source, name, text))
    return tuple(sorted(events, key=lambda event: event.t_s))


def parameters(log: Log) -> list[tuple[str, str]]:
    """An autopilot's parameters by name, for readers."""
    return _plain(log.metadata.get(PARAMETERS, {}))


def _plain(entries: dict[str, str]) -> list[tuple[str, str]]:
    """Sorted; numbers as short as they are on board, in single precision: 0.05, not 0.05000000074505806."""
    shown = []
    for name, text in sorted(entries.items()):
        try:
            value = float(text)
        except ValueError:
            shown.append((name, text))
        else:
            whole = text.lstrip("-").isdecimal() or (value.is_integer() and abs(value) < _EXACT)
            shown.append((name, str(int(value)) if whole else str(np.float32(value))))
    return shown


def render(summary: LogInfo) -> Group:
    """The summary for a terminal (a rich renderable)."""
    from rich.console import Group
    from rich.text import Text

    size = f"{summary.size_bytes / 1e6:.1f} MB" if summary.size_bytes >= 100_000 else f"{summary.size_bytes} bytes"
    head = Text(f"{summary.path}: {summary.duration_s:.1f} s, {summary.messages} messages, {size}", style="bold")
    state = Text("complete", style="green") if summary.complete else Text("not complete", style="yellow")
    for note in summary.notes:
        state.append(f"\n  {note}")
    parts: list[Text | RichTable] = [head, state, _topic_table(summary)]
    for name, entries in sorted(summary.metadata.items()):
        pairs = _plain(entries) if name == PARAMETERS else sorted(entries.items())
        said = [f"{key} {value}" for key, value in pairs]
        parts.append(Text(f"{name}: " + _listed(said, "; --json lists all")))
    if summary.attachments:
        files = ", ".join(f"{name} ({size} bytes)" for name, size in summary.attachments.items())
        parts.append(Text(f"attachments: {files}"))
    if summary.events:
        parts.append(_event_table(summary))
    return Group(*parts)


def _topic_table(summary: LogInfo) -> RichTable:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("topic", no_wrap=True)
    table.add_column("messages", justify="right")
    table.add_column("Hz", justify="right")
    table.add_column("what")
    for topic in summary.topics:
        rate = f"{topic.rate_hz:.1f}" if topic.rate_hz is not None else "-"
        columns = _listed([_column(field) for field in topic.fields])
        what = Text(topic.description or topic.schema)
        if columns:
            what.append(f"\n{columns}", style="dim")
        table.add_row(Text(topic.name), str(topic.messages), rate, what)
    return table


def _listed(names: list[str], where: str = "") -> str:
    """In one line; of very many the first."""
    more = len(names) - _NAMES_SHOWN
    return ", ".join(names) if more <= 0 else ", ".join(names[:_NAMES_SHOWN]) + f" and {more} more{where}"


def _column(field: FieldInfo) -> str:
    size = f"[{field.size}]" if field.size else ""
    return f"{field.name}{size}" + (f" ({field.unit})" if field.unit not in ("", "1") else "")


def _event_table(summary: LogInfo) -> RichTable:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("t [s]", "level", "event", "text"):
        table.add_column(name, justify="right" if name == "t [s]" else "left")
    for event in summary.events[:_EVENTS_SHOWN]:
        table.add_row(f"{event.t_s:.2f}", event.level, Text(event.name), Text(event.text))
    if len(summary.events) > _EVENTS_SHOWN:
        table.add_row("", "", "", f"and {len(summary.events) - _EVENTS_SHOWN} more; --json lists all")
    return table
