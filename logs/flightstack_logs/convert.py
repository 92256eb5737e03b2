"""Another's log as this project's MCAP: every table under its own name, and the vehicle's words under our topics.

`/vehicle/...` and the 3-D view are what `standard` can make of the log; the tables as they were logged stand beside
them as `/KIND/NAME`.  Nothing is resampled.
"""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from flightstack.types import F64, InputError
from flightstack_logs import scene as viewer
from flightstack_logs.reader import read
from flightstack_logs.standard import with_vehicle_topics
from flightstack_logs.tables import Log, Messages, Table
from flightstack_logs.topics import TOPICS, Field, Kind, Topic
from flightstack_logs.writer import FlightLog

_BLOCK = 4096
_Rows = Iterator[tuple[int, int, str, object]]
"""Time in microseconds, place of the table, topic, record."""
_NO_NAME = re.compile(r"[^A-Za-z0-9_]+")


class Converted(NamedTuple):
    """What was written."""

    messages: int
    topics: int


class _Pose(NamedTuple):
    pos_ned_m: F64
    q_ned_frd: F64


def convert(log: Log, path: Path) -> Converted:
    """Write the log to `path`; InputError, one line, where it can't be written.

    A flight's compact MCAP comes out with every table at its full rate, message by message, for any viewer.
    """
    if log.kind == "mcap":
        return _plain(log, path)
    if log.kind == "cfusdlog":
        raise InputError(
            f"log {log.path}: a Crazyflie's columns are named by whoever logged; `log export` writes its CSV"
        )
    whole = with_vehicle_topics(log)
    source = {"file": log.path.name, "kind": log.kind} | {f"note_{k}": note for k, note in enumerate(log.notes, 1)}
    poses = _poses(whole)
    out = FlightLog.open(path, metadata={"source": source, **log.metadata}, overwrite=False)
    topics = [_declared(out, whole, table) for table in whole.tables.values()]
    rows = [_rows(place, topic, whole.tables[name]) for place, (name, topic) in enumerate(topics)]
    return _written(out, log, rows, poses)


def _written(out: FlightLog, log: Log, rows: list[_Rows], poses: _Poses | None) -> Converted:
    """All rows in order of time; the file is taken away again where it can't be written."""
    try:
        for t_us, _, topic, record in heapq.merge(*rows, key=lambda row: row[:2]):
            out.write(topic, t_us, record)
            if poses is not None and topic == "/vehicle/attitude":
                poses.write(out, t_us)
    finally:
        out.close()
    if out.failed is not None:
        out.path.unlink(missing_ok=True)
        raise InputError(f"{out.failed}; {log.path} is as it was")
    return Converted(out.messages, len(rows))


def _plain(log: Log, path: Path) -> Converted:
    """Every topic of the table, message by message; what a log holds beyond it is left out."""
    as_logged = read(log.path, as_logged=True)
    tables = [table for name, table in as_logged.tables.items() if name in TOPICS]
    raw = [each for name, each in as_logged.messages.items() if name in TOPICS]
    if all(table.place is None for table in tables):
        raise InputError(f"log {log.path}: is an MCAP already; mend a damaged one with `flightstack log recover`")
    metadata = {name: entries for name, entries in log.metadata.items() if name != "log"}
    out = FlightLog.open(path, metadata=metadata, attachments=log.attachments, overwrite=False)
    rows = [_rows(place, TOPICS[table.name], table) for place, table in enumerate(tables)]
    rows += [_messages(place, each) for place, each in enumerate(raw, len(tables))]
    return _written(out, log, rows, None)


def _messages(place: int, raw: Messages) -> _Rows:
    for t_us, data in zip(raw.t_us.tolist(), raw.data, strict=True):
        yield t_us, place, raw.name, data


def _declared(out: FlightLog, log: Log, table: Table) -> tuple[str, Topic]:
    """Name of the table and the topic that its rows go to."""
    known = TOPICS.get(table.name)
    if known is not None:
        return table.name, known
    name = _NO_NAME.sub("_", table.name)
    fields, taken = [], set[str]()
    for column, values in table.columns.items():
        safe = _NO_NAME.sub("_", column).strip("_") or "column"
        safe = safe if not safe[0].isdigit() else f"_{safe}"
        while safe in taken:
            safe += "_"
        taken.add(safe)
        size = values.shape[1] if values.ndim > 1 else 0
        fields.append(Field(safe, _type(values), size, table.units.get(column, ""), "" if safe == column else column))
    topic = Topic(f"/{log.kind}/{table.name}", Kind.TABLE, f"flightstack.{log.kind}.{name}", 0.0, log.kind,
                  "as it was logged", tuple(fields))  # fmt: skip
    out.declare(topic)
    return table.name, topic


def _type(values: np.ndarray) -> str:
    return {"f": "double", "i": "int64", "u": "int64", "b": "bool"}.get(values.dtype.kind, "string")


def _rows(place: int, topic: Topic, table: Table) -> _Rows:
    """(time, place of the table, topic, record in the order of the fields), a block at a time."""
    if topic.kind is Kind.TABLE and topic.name == table.name:
        columns = [table.columns[field.name] for field in topic.fields]
    else:
        columns = list(table.columns.values())
    for begin in range(0, len(table), _BLOCK):
        some = slice(begin, begin + _BLOCK)
        parts = [column[some].tolist() for column in columns]
        for t_us, *record in zip(table.t_us[some].tolist(), *parts, strict=True):
            yield t_us, place, topic.name, tuple(record)


class _Poses:
    """Place and attitude at the attitude's times, for the 3-D view."""

    def __init__(self, attitude: Table, position: Table) -> None:
        self._trail = viewer.VehicleTrail(truth=False)
        self._place = np.stack(
            [np.interp(attitude.t_us, position.t_us, position["pos_ned_m"][:, axis]) for axis in range(3)], axis=-1
        )
        self._turn, self._row = attitude["q_ned_frd"], 0

    def write(self, out: FlightLog, t_us: int) -> None:
        """The views of the next row, if they are due."""
        row, self._row = self._row, self._row + 1
        pose = _Pose(self._place[row], self._turn[row])
        if self._trail.is_due(t_us) and np.isfinite(pose.pos_ned_m).all() and np.isfinite(pose.q_ned_frd).all():
            for topic, data in self._trail.poses(t_us, pose):
                out.write(topic, t_us, data)


def _poses(log: Log) -> _Poses | None:
    attitude, position = log.tables.get("/vehicle/attitude"), log.tables.get("/vehicle/local_position")
    return None if attitude is None or position is None else _Poses(attitude, position)
