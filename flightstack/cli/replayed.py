"""Two flights' tables field by field: where they first differ, and by how much."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flightstack_logs.tables import Log, Table

COMPARED = ("/setpoint", "/tick", "/control", "/command", "/learner", "/filter")
"""Outputs of a tick, in the order in which a difference is looked for."""
DIGEST = "digest"
_SINGLE = 1.2e-7
"""Relative step of single precision: another machine's number may be rounded to the next one."""
_SINGLE_TOPICS = frozenset({"/setpoint", "/control", "/learner", "/filter"})


@dataclass(frozen=True, slots=True)
class Difference:
    """One field that differs: where first, and by how much at most."""

    topic: str
    field: str
    first_s: float
    recorded: str
    replayed: str
    greatest: float | None
    """Null where the values are no numbers, or one of them is not finite."""


@dataclass(slots=True)
class Replayed:
    """What came of a replay."""

    log: str
    ticks: int
    exact: bool = True
    """Compared bit for bit."""
    differences: list[Difference] = field(default_factory=list)
    """The one that begins first leads."""
    first_s: float | None = None
    """The first tick of which anything differs, logged or not; null where nothing does, or with a tolerance."""
    until_s: float | None = None
    """Of a log that was cut off: up to when it holds everything, and was compared; null where it is whole."""

    @property
    def same(self) -> bool:
        """Nothing differs."""
        return not self.differences and self.first_s is None

    @property
    def lines(self) -> list[str]:
        """In words: what differs, the first tick that does, and by how much."""
        cut = [] if self.until_s is None else [f"cut off: compared up to {self.until_s:.3f} s, where all is there"]
        if self.same:
            return [f"{self.ticks} ticks: the same" + (", bit for bit" if self.exact else ""), *cut]
        told = cut
        if self.first_s is not None:
            told.append(f"first tick that differs: {self.first_s:.3f} s")
        if not self.differences:
            return [*told, "by less than the logged fields show: in the last bits"]
        first = self.differences[0]
        told += [
            f"differs from {first.first_s:.3f} s on: {first.topic} {first.field}: recorded {first.recorded}, "
            f"today {first.replayed}"
        ]
        for each in self.differences:
            most = "" if each.greatest is None else f", by {each.greatest:.3g} at most"
            told.append(f"{each.topic} {each.field}: from {each.first_s:.3f} s on{most}")
        return told

    def as_json(self) -> dict[str, Any]:
        """The `flightstack.replay/1` object."""
        rows = [{name: getattr(each, name) for name in Difference.__slots__} for each in self.differences]
        return {
            "schema": "flightstack.replay/1",
            "log": self.log,
            "ticks": self.ticks,
            "same": self.same,
            "first_s": self.first_s,
            "until_s": self.until_s,
            "differences": rows,
        }


def differences_of(recorded: Log, replayed: Log, tolerance: float, until_us: int | None = None) -> list[Difference]:
    """Every field that differs, by the time from which it does, up to `until_us`; InputError where the formats do."""
    found = []
    for topic in COMPARED:
        then, now = (_until(log.tables.get(topic), until_us) for log in (recorded, replayed))
        if then is None and now is None:
            continue
        if then is None or now is None:
            only = "recorded" if now is None else "today's"
            first = then if then is not None else now
            assert first is not None
            found.append(Difference(topic, "(topic)", float(first.t_us[0]) * 1e-6, only, "not there", None))
            continue
        found += _of_table(topic, then, now, tolerance)
    return sorted(found, key=lambda each: each.first_s)


def _until(table: Table | None, until_us: int | None) -> Table | None:
    if table is None or until_us is None:
        return table
    rows = int(np.searchsorted(table.t_us, until_us, side="right"))
    columns = {name: values[:rows] for name, values in table.columns.items()}
    return replace(table, t_us=table.t_us[:rows], columns=columns) if rows else None


def _of_table(topic: str, then: Table, now: Table, tolerance: float) -> list[Difference]:
    rows = min(len(then), len(now))
    apart = np.flatnonzero(then.t_us[:rows] != now.t_us[:rows])
    rows = int(apart[0]) if len(apart) else rows
    found = []
    if tolerance and topic in _SINGLE_TOPICS:
        tolerance = max(tolerance, _SINGLE)
    for name, values in then.columns.items():
        if name in now.columns and (each := _of_column(topic, name, values[:rows], now[name][:rows], then, tolerance)):
            found.append(each)
    if len(apart) or len(then) != len(now):
        longer = then if len(then) > rows else now
        at_s = float(longer.t_us[min(rows, len(longer) - 1)]) * 1e-6
        found.append(Difference(topic, "(ticks)", at_s, f"{len(then)} rows", f"{len(now)} rows", None))
    return found


def _of_column(
    topic: str, name: str, then: np.ndarray, now: np.ndarray, table: Table, tolerance: float
) -> Difference | None:
    if then.shape != now.shape:
        return Difference(topic, name, float(table.t_us[0]) * 1e-6, str(then.shape), str(now.shape), None)
    if then.dtype.kind == "f":
        with np.errstate(invalid="ignore"):  # inf less inf
            near = np.abs(then - now) <= tolerance * np.maximum(1.0, np.abs(then))
        differs = ~(near | (then == now) | (np.isnan(then) & np.isnan(now)))
    else:
        differs = then != now
    rows = np.flatnonzero(differs if differs.ndim == 1 else differs.any(axis=1))
    if not len(rows):
        return None
    first, greatest = int(rows[0]), None
    if then.dtype.kind in "fi":
        with np.errstate(invalid="ignore"):
            gap = np.abs(then.astype(np.float64) - now.astype(np.float64))[rows]
        greatest = float(np.nanmax(gap)) if np.isfinite(gap).any() else None
    at_s = float(table.t_us[first]) * 1e-6
    return Difference(topic, name, at_s, str(then[first].tolist()), str(now[first].tolist()), greatest)
