"""The log's one time line: microseconds from 0 at its start, each period later than the last, in the vehicle's seconds.

Whoever flies tells the clock each period what time it is here (`local_us`, a clock that never jumps) and, once that is
known, by the vehicle's own clock (its time since boot, as fitted from its stamps).  The log counts the vehicle's
seconds: a simulator may run faster or slower than this machine, and whoever reads speeds needs the time that the
vehicle lived in.  Everything written in one period bears the same time.

Where the vehicle's clock leaps (a reboot, a new fit) the log's goes on by the time that passed here.  The topic /clock
says once a second, and at each such leap, which UTC and which vehicle time belong to a log time; readers use it to put
sample stamps, which are the vehicle's own, on the log's time line (`aligned`).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from flightstack.types import I64
from flightstack_logs.tables import Table

TOPIC = "/clock"
STAMPS = ("t_boot_us", "t_us")
"""Columns that hold the vehicle's own stamps; the first one that a table has is its sample time."""
_PERIOD_US = 1_000_000
_LEAP_US = 100_000
"""What the vehicle's clock may differ by from what was expected of it: links jitter by tens of milliseconds."""


class _Writes(Protocol):
    def write(self, topic: str, t_us: int, record: object) -> None: ...


class LogClock:
    """Time of the log; `t_us` is that of the period that was stepped last."""

    def __init__(self, log: _Writes, *, zero_us: int, utc_us: int) -> None:
        """`zero_us`: local time of the log's start; `utc_us`: UTC then, microseconds since 1970."""
        self.t_us = 0
        self._log, self._zero_us, self._utc_us = log, zero_us, utc_us
        self._local_us = zero_us
        self._ahead_us: int | None = None
        """Vehicle's time less the log's; None before the first stamp."""
        self._due_us = 0

    def step(self, local_us: int, vehicle_us: int | None = None, rate: float = 1.0) -> int:
        """A new period: the log's time now.  `vehicle_us`: None while it is not known; `rate`: its seconds per ours."""
        expected_us = self.t_us + round((local_us - self._local_us) * rate)
        self._local_us = local_us
        if vehicle_us is None:
            t_us, leapt = expected_us, False
        else:
            leapt = self._ahead_us is None or abs(vehicle_us - self._ahead_us - expected_us) > _LEAP_US
            if self._ahead_us is None or leapt:
                self._ahead_us = vehicle_us - expected_us
            t_us = vehicle_us - self._ahead_us
        later_us = self.t_us + (local_us > self._zero_us)  # no two periods share a time: replay tells them apart
        self.t_us = max(later_us, t_us)
        if leapt or self.t_us >= self._due_us:
            self._due_us = self.t_us + _PERIOD_US
            vehicle = -1 if self._ahead_us is None else self.t_us + self._ahead_us
            self._log.write(TOPIC, self.t_us, (self._utc_us + local_us - self._zero_us, vehicle))
        return self.t_us


def clock_metadata(utc_us: int, *, simulated: bool) -> dict[str, str]:
    """The log's metadata `clock`: when it began, and whose date that is."""
    began = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(utc_us // 1_000_000))
    return {
        "utc_start": f"{began}.{utc_us % 1_000_000 // 1000:03d}Z",
        "utc": "simulated" if simulated else "wall clock",
    }


def aligned(tables: Mapping[str, Table]) -> dict[str, Table]:
    """The tables with their vehicle's stamps on the log's time line; as they are in a log without /clock."""
    clock = tables.get(TOPIC)
    if clock is None or "vehicle_us" not in clock.columns:
        return dict(tables)
    known = np.flatnonzero(clock["vehicle_us"] >= 0)
    if not known.size:
        return dict(tables)
    since_us, ahead_us = clock.t_us[known], clock["vehicle_us"][known] - clock.t_us[known]
    if not ahead_us.any():
        return dict(tables)
    return {name: _aligned(table, since_us, ahead_us) for name, table in tables.items()}


def _aligned(table: Table, since_us: I64, ahead_us: I64) -> Table:
    """Each row by the last entry of /clock up to its log time, rows before the first by the first."""
    stamps = [name for name in STAMPS if name in table.columns and table.columns[name].dtype.kind == "i"]
    if table.name == TOPIC or not stamps:
        return table
    entry = np.maximum(np.searchsorted(since_us, table.t_us, side="right") - 1, 0)
    moved = {name: table.columns[name] - ahead_us[entry] for name in stamps}
    return replace(table, columns={**table.columns, **moved})
