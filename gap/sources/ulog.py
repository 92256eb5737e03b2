"""PX4's logs, by today's and by old topic names; estimator outputs and IMU, never the simulator's ground truth."""

from __future__ import annotations

from flightstack.vehicle import Vehicle
from gap.records import Signal
from logs.reader import Log


def signals(log: Log, vehicle: Vehicle) -> tuple[dict[str, Signal], list[str]]:
    """Signals of a PX4 log, and what was done to read them."""
    return {}, []
