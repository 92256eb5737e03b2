"""What was flown of late, and what h a certificate would have given it.

A certificate that holds the vehicle now may still bend the path that it flies: where bounds are wide its region is a
part of what was asked for, and the path comes near its edge.  What was flown within a period says so beforehand.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from flightstack.barrier.margins import Ledger
from flightstack.barrier.records import Certificate
from flightstack.barrier.search import Axis, Worth
from flightstack.barrier.shapes import Barrier, piece_at
from flightstack.jit import njit_called
from flightstack.region import Region
from flightstack.types import F64, Measurement

_EVERY_US = 100_000
_KEPT = 120
"""Twelve seconds."""
_WELL_INSIDE_H = 0.3


class FlownPath:
    """Places and speeds, ten a second; changed in place."""

    __slots__ = ("_kept", "_taken_us")

    def __init__(self) -> None:
        self._kept: deque[F64] = deque(maxlen=_KEPT)
        self._taken_us = -_EVERY_US

    def take(self, measurement: Measurement, region: Region, origin_ned_m: F64) -> None:
        """One tick.  All begins anew where the vehicle is near the edge of what was asked for, as on its way there."""
        if measurement.t_us - self._taken_us < _EVERY_US:
            return
        self._taken_us = measurement.t_us
        e = (measurement.pos_ned_m - origin_ned_m - region.centre_ned_m) / np.array(region.semi_axes_m)
        v = measurement.vel_ned_mps / np.array(region.semi_axes_mps)
        if float(np.max(e * e + v * v)) > 1.0 - _WELL_INSIDE_H:
            self._kept.clear()
        else:
            self._kept.append(measurement.row[:6].copy())

    def worth(self, axis: Axis, needs: Ledger, centre_m: float, origin_m: float) -> Worth:
        """h of an axis' barrier where it is least of all that is kept, as `least_h` has it with the doubts that the
        barrier needs; where nothing is, its area."""
        i, ahead = axis.axis, axis.response.c1_s + axis.response.delay_s
        states = np.array(list(self._kept)[::2]).reshape(-1, 6)
        e, v = states[:, i] - origin_m - centre_m, np.ascontiguousarray(states[:, 3 + i])

        def worth(barrier: Barrier) -> float:
            if not len(e):
                return barrier.area_m2ps
            return _least_h(barrier.rows, e, v, ahead, needs.setting(barrier).off_mps)

        return worth

    def least(self, certificate: Certificate, origin_ned_m: F64 | None) -> float:
        """Least h of all that is kept; infinite of nothing."""
        return least_h(certificate, np.array(self._kept), origin_ned_m) if self._kept else math.inf


def least_h(certificate: Certificate, states: F64, origin_ned_m: F64 | None) -> float:
    """Least h of places and speeds (n, 6), NED, as they are and looked ahead by lag and delay, less what doubts of
    speed may take there."""
    least = math.inf
    for axis in certificate.axes:
        i, ahead = axis.axis, axis.response.c1_s + axis.response.delay_s
        start = certificate.centre_ned_m[i] + (0.0 if origin_ned_m is None else float(origin_ned_m[i]))
        e, v = states[:, i] - start, np.ascontiguousarray(states[:, 3 + i])
        least = min(least, _least_h(axis.barrier.rows, e, v, ahead, axis.setting.off_mps))
    return least


@njit_called
def _least_h(rows: F64, e: F64, v: F64, ahead_s: float, off_mps: float) -> float:
    least = np.inf
    for i in range(len(e)):
        there = e[i] + ahead_s * v[i]
        if math.isnan(there + off_mps):
            return np.nan
        for j in range(rows.shape[0]):
            least = min(least, piece_at(rows[j], e[i], v[i])[0])
            for off in (off_mps, -off_mps):
                least = min(least, piece_at(rows[j], there, v[i] + off)[0])
    return least
