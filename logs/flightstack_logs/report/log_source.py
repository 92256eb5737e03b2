"""A log as the report reads it: signals on the page's time axis, what happened when, and what others' logs hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flightstack.types import F64
from flightstack_logs.reader import Log, Table
from flightstack_logs.report.flight import FlightEvent, Recorded, ReportSamples, samples

_SEVERITY_OF = {"warning": "warning", "error": "error", "fatal": "error"}
_SAME_TEXT_S = 1.0
_OURS = {"/tick", "/command", "/control", "/setpoint", "/learner", "/filter", "/events"}
"""Topics that only this project writes."""


@dataclass(frozen=True, slots=True, eq=False)
class LogSource:
    """A log with the zero of the report's time axis."""

    log: Log
    zero_us: int

    def table(self, topic: str) -> Table | None:
        """The topic's table, None where it has no rows."""
        table = self.log.tables.get(topic)
        return table if table is not None and len(table) else None

    def seconds(self, t_us: np.ndarray) -> F64:
        """Log times on the report's axis."""
        return np.asarray((np.asarray(t_us, dtype=np.int64) - self.zero_us) * 1e-6, dtype=np.float64)

    def signal(self, topic: str, column: str) -> ReportSamples | None:
        """A column over its own sample time where the topic carries one, else over log time."""
        table = self.table(topic)
        if table is None or column not in table.columns:
            return None
        sampled = table.columns.get("t_boot_us", table.columns.get("t_us", table.t_us))
        values = table.columns[column]
        if values.dtype.kind not in "fiub":
            return None
        return samples(self.seconds(sampled), values.astype(np.float64))

    def first(self, *places: tuple[str, str]) -> ReportSamples | None:
        """The first of several places that holds the signal."""
        found = (self.signal(topic, column) for topic, column in places)
        return next((signal for signal in found if signal is not None), None)


def recorded_of(source: LogSource) -> Recorded | None:
    """What a log of others holds; None of a flight of this project."""
    if _OURS & source.log.tables.keys() or "settings" in source.log.metadata:
        return None
    velocity = source.signal("/vehicle/local_position", "vel_ned_mps")
    force = source.signal("/vehicle/imu", "accel_frd_mps2")
    battery = source.signal("/vehicle/battery", "voltage_v")
    ends = [(each.t_s[0], each.t_s[-1]) for each in (velocity, force, battery) if each is not None]
    first_s, last_s = source.seconds(np.array(source.log.span_us)) if not ends else np.array(ends).T
    return Recorded(float(np.max(last_s) - np.min(first_s)), velocity, force, battery)


def events_of(source: LogSource) -> tuple[FlightEvent, ...]:
    """What the vehicle and the log say that happened, in order; phases apart."""
    said = _lines(source, "/vehicle/statustext", "vehicle says")
    own = [
        event
        for event in _lines(source, "/events", "")
        if event.kind != "phase"
        and not any(event.text == other.text and abs(event.t_s - other.t_s) < _SAME_TEXT_S for other in said)
    ]
    return tuple(sorted([*own, *said, *_arming(source)], key=lambda event: event.t_s))


def _lines(source: LogSource, topic: str, kind: str) -> list[FlightEvent]:
    table = source.table(topic)
    if table is None or not {"level", "name", "text"} <= table.columns.keys():
        return []
    return [
        FlightEvent(
            float(source.seconds(t_us)), kind or str(name), str(text).strip(), _SEVERITY_OF.get(str(level), "info")
        )
        for t_us, level, name, text in zip(table.t_us, table["level"], table["name"], table["text"], strict=True)
    ]


def _arming(source: LogSource) -> list[FlightEvent]:
    """Changes of what the vehicle said of itself: disarmed and on the ground before its first word."""
    table = source.table("/vehicle/status")
    if table is None:
        return []
    found = []
    for column, before, kind, words in (
        ("armed", False, "arming", ("reported disarmed", "reported armed")),
        ("landed", True, "landing", ("reported in the air", "reported on the ground")),
    ):
        if column in table.columns and (column == "armed" or source.table("/events") is None):  # ours have phases
            state = np.asarray(table[column], dtype=bool)
            changes = np.flatnonzero(state != np.concatenate([[before], state[:-1]]))
            found += [FlightEvent(float(source.seconds(table.t_us[i])), kind, words[int(state[i])]) for i in changes]
    return found
