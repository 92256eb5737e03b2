"""Where the vehicle truly was beside where it was to be: a flight's log held against the station's ground truth.

The log has the reference by the vehicle's time and, in /clock, which UTC belongs to it; the truth has local time, which
is tied to UTC here.  PX4's local frame begins at its first fix, so a constant offset says nothing: the standard
deviation of the difference is what is told.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.px4.station import Truth
from flightstack_logs.reader import read

F64 = NDArray[np.float64]


def std_of_truth_m(log: Path, truth: Sequence[Truth], track_s: float) -> F64 | None:
    """(3,) standard deviation, north, east and up, of the true path about the reference over the last `track_s`
    seconds before the command to land; None where the log does not say."""
    tables = read(log).tables
    clock, setpoint, events = (tables.get(name) for name in ("/clock", "/setpoint", "/events"))
    if clock is None or setpoint is None or events is None:
        return None
    lands_us = events.t_us[(events["name"] == "phase") & (events["text"] == "land")]
    if not len(lands_us):
        return None
    rows = (setpoint.t_us > lands_us[0] - round(track_s * 1e6)) & (setpoint.t_us < lands_us[0])
    reference = setpoint["pos_ned_m"][rows] * np.array([1.0, 1.0, -1.0])
    local_s = np.interp(setpoint.t_us[rows], clock.t_us, 1e-6 * clock["utc_us"]) - (time.time() - time.monotonic())
    true = np.array(truth)[:, :4]
    at = np.stack([np.interp(local_s, true[:, 0], true[:, axis]) for axis in (1, 2, 3)], axis=1)
    return np.asarray((at - reference).std(axis=0))
