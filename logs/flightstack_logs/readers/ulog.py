"""PX4 ULog in (through pyulog): one table for each topic, `NAME` or `NAME_1`, `NAME_2` ... for its further instances.

Elements `q[0]`, `q[1]`, ... become one column `q`.  Parameters as they stood at the start are in `metadata`.

A log begins when its header says.  What was published before stands in it with its old stamp (or none, or that of an
earlier boot): such rows have the time at which the log begins.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.types import InputError
from flightstack_logs.readers.ulog_clock import Stamped, on_one_clock
from flightstack_logs.readers.ulog_frames import Frames, mended
from flightstack_logs.tables import About, Log, Table, plain

_ABOUT = About("table", "ulog", "", "PX4", 0.0)
MAGIC = b"ULog\x01\x12\x35"
SAID = "logged_messages"
"""The table of what PX4 printed: severity as in MAVLink, text."""
_LATEST_US = 2.0**52


def read_ulog(path: Path, data: bytes) -> Log:
    """The log in `data`, a damaged one as far as it goes; InputError where nothing can be had."""
    from pyulog import ULog

    frames = mended(data)
    try:
        with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
            log = ULog(io.BytesIO(frames.data), disable_str_exceptions=True)
    except Exception as error:  # a parser on damaged bytes: whatever it raises means the same
        raise InputError(f"log {path}: is a ULog too damaged to read ({_line(error)}); copy it again") from None
    topics = [topic for topic in log.data_list if "timestamp" in topic.data and len(topic.data["timestamp"])]
    clock_notes = _restamp(topics, frames)
    span = _span(log.start_timestamp, [topic.data["timestamp"] for topic in topics])
    tables = {}
    for topic in topics:
        name = topic.name if topic.multi_id == 0 else f"{topic.name}_{topic.multi_id}"
        tables[name] = _table(name, topic.data, span)
    if not tables:
        raise InputError(f"log {path}: is a ULog without data; record a flight with SDLOG_MODE 0 and SDLOG_PROFILE 1")
    tables |= _said(log, span, tables.keys())
    notes = [*frames.damage, *clock_notes, *_notes(log)]
    complete = not log.file_corruption and not frames.damage
    metadata = {
        "parameters": {name: repr(value) for name, value in log.initial_parameters.items()},
        "info": {name: str(value) for name, value in log.msg_info_dict.items() if isinstance(value, str | int)},
    }
    return Log.of_tables(path, "ulog", _ABOUT, tables, notes, len(data), complete=complete, metadata=metadata)


def _line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__} {error}".split())[:120]


def _notes(log: Any) -> list[str]:
    notes = []
    if log.file_corruption:
        notes.append("damaged: some messages could not be read")
    lost_ms = [dropout.duration for dropout in log.dropouts]
    if lost_ms:
        times = "once" if len(lost_ms) == 1 else f"{len(lost_ms)} times"
        notes.append(f"PX4 lost data {times} while logging, {sum(lost_ms)} ms in all")
    return notes


def _said(log: Any, span: tuple[float, float], taken: Collection[str]) -> dict[str, Table]:
    """What PX4 printed while it logged."""
    lines = [line for line in log.logged_messages if line.timestamp < _LATEST_US]
    if not lines or SAID in taken:
        return {}
    data = {
        "timestamp": np.array([line.timestamp for line in lines], np.uint64),
        "severity": np.array([min(max(line.log_level - ord("0"), 0), 7) for line in lines]),
        "text": np.array([line.message for line in lines], np.str_),
    }
    return {SAID: _table(SAID, data, span)}


def _restamp(topics: list[Any], frames: Frames) -> list[str]:
    """Put the stamps of all topics on one clock, in place; what was done."""
    stamped, whose = [], []
    for topic in topics:
        place = np.flatnonzero(frames.topics == topic.msg_id)
        if len(place) == len(topic.data["timestamp"]):  # else something was not parsed, and the order is not known
            stamped.append(Stamped(topic.name, place, topic.data["timestamp"].astype(np.float64)))
            whose.append(topic)
    done, notes = on_one_clock(stamped)
    for topic, each in zip(whose, done, strict=True):
        if not each.keep.all():
            topic.data.update({column: values[each.keep] for column, values in topic.data.items()})
        added = each.added_us[each.keep].astype(np.int64)
        for column in ("timestamp", "timestamp_sample") if added.any() else ():
            if column in topic.data:
                topic.data[column] = (topic.data[column].astype(np.int64) + added).astype(np.uint64)
    return notes


def _span(said_us: int, stamps: list[np.ndarray]) -> tuple[float, float]:
    """When the log begins and ends: from what its header says, if half of the rows agree, to its last row.

    Topics whose rows all have one stamp say nothing of it.
    """
    times = [t[(t > 0) & (t < _LATEST_US)].astype(np.float64) for t in stamps]
    moving = [t for t in times if len(t) and t.min() < t.max()] or [t for t in times if len(t)]
    if not moving:
        return 0.0, _LATEST_US
    every = np.concatenate(moving)
    return (float(said_us) if said_us <= np.median(every) else float(every.min())), float(every.max())


def _table(name: str, data: dict[str, Any], span: tuple[float, float]) -> Table:
    """Rows in order of time, without those whose stamp is no time."""
    stamps = data["timestamp"].astype(np.float64)
    keep = np.flatnonzero(stamps < _LATEST_US)
    stamps = np.where((stamps < span[0]) | (stamps > span[1]), span[0], stamps)
    order = keep[np.argsort(stamps[keep], kind="stable")]
    grouped: dict[str, list[np.ndarray]] = {}
    for column, values in data.items():
        if column != "timestamp":
            grouped.setdefault(column.partition("[")[0] if column.endswith("]") else column, []).append(values[order])
    columns = {column: plain(parts[0] if len(parts) == 1 else np.stack(parts, -1)) for column, parts in grouped.items()}
    return Table(name, stamps[order].astype(np.int64), columns, {})
