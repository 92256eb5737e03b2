"""A blind case as this project's own log: what a vehicle would have reported, and nothing else.

No truth, no setpoints, no attachments: a log of a real flight has what the stack adds, but nothing that the workflow
reads.  Numbers are rounded as on the wire (single precision, pulse widths of whole microseconds), motors come at 100
to 125 Hz, battery and landing state once a second.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flightstack.types import F64
from flightstack_logs.writer import FlightLog

_MOTORS_HZ = 100.0
_SLOW_S = 1.0
_UNUSED = (0,) * 12


def write_mcap(path: Path, table: dict[str, F64], on_ground: F64) -> None:
    """The measured `table` (column of the CSV header -> (N,)) as an MCAP log; `on_ground` (N,): landing state."""
    t_us = np.rint(1e6 * table["time_s"]).astype(np.int64)
    pos, vel = _columns(table, "pos_{}_m", "ned"), _columns(table, "vel_{}_mps", "ned")
    q, rate = _columns(table, "q_{}", "wxyz"), _columns(table, "rate_{}_radps", "xyz")
    accel, motor = _columns(table, "accel_{}_mps2", "xyz"), _columns(table, "motor_{}", "1234")
    pulse = np.rint(1000.0 + 1000.0 * motor).astype(int)
    period_s = float(np.median(np.diff(table["time_s"])))
    each, slow = max(1, round(1.0 / period_s / _MOTORS_HZ)), max(1, round(_SLOW_S / period_s))
    log = FlightLog.open(path, metadata={}, overwrite=True)
    for k, now in enumerate(t_us.tolist()):
        log.write("/vehicle/local_position", now, (now, tuple(pos[k]), tuple(vel[k])))
        log.write("/vehicle/attitude", now, (now, tuple(q[k]), tuple(rate[k])))
        log.write("/vehicle/imu", now, (now, tuple(accel[k]), tuple(rate[k])))
        if k % each == 0:
            log.write("/vehicle/motors", now, (now, (*pulse[k].tolist(), *_UNUSED)))
        if k % slow == 0:
            if "battery_v" in table:
                log.write("/vehicle/battery", now, (float(table["battery_v"][k]), float("nan"), -1))
            log.write("/vehicle/status", now, ("OFFBOARD", True, bool(on_ground[k])))
    log.close()
    if log.failed is not None:
        raise RuntimeError(log.failed)


def _columns(table: dict[str, F64], name: str, axes: str) -> F64:
    return np.stack([table[name.format(axis)] for axis in axes], axis=1)
