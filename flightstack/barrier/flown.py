"""What was flown of late and is planned, and what h a certificate gives it.

A certificate that holds the vehicle now may still bend the path that it flies: where bounds are wide its region is a
part of what was asked for, and the path comes near its edge.  What was flown within a period says so beforehand, and
what is planned does so before there was a period.
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
from flightstack.trajectory import Trajectory
from flightstack.types import F64, Measurement

_EVERY_US = 100_000
_KEPT = 120
"""Twelve seconds."""
_WELL_INSIDE_H = 0.3
_PLANNED_S, _PLANNED_EVERY_S = 30.0, 0.25
NOTHING_PLANNED = np.zeros((0, 6))


def planned_of(trajectory: Trajectory, duration_s: float, region: Region) -> F64:
    """Places and speeds (n, 6), NED from where the flight begins, of a path's first 30 s that lie well inside a region:
    what comes near the edge of what was asked for is bent by any certificate."""
    points = [trajectory.at(float(t_s)) for t_s in np.arange(0.0, min(duration_s, _PLANNED_S), _PLANNED_EVERY_S)]
    states = np.array([[*point.pos_ned_m, *point.vel_ned_mps] for point in points]).reshape(-1, 6)
    inside = [_is_well_inside(state[:3] - region.centre_ned_m, state[3:], region) for state in states]
    well: F64 = states[np.array(inside, dtype=bool)]
    return well


def _is_well_inside(e_ned_m: F64, vel_ned_mps: F64, region: Region) -> bool:
    e, v = e_ned_m / np.array(region.semi_axes_m), vel_ned_mps / np.array(region.semi_axes_mps)
    return float(np.max(e * e + v * v)) <= 1.0 - _WELL_INSIDE_H


class FlownPath:
    """Places and speeds, ten a second, and those that are planned (n, 6), NED from where the flight began; changed in
    place."""

    __slots__ = ("_kept", "_planned", "_taken_us")

    def __init__(self, planned: F64 = NOTHING_PLANNED) -> None:
        self._planned = planned
        self._kept: deque[F64] = deque(maxlen=_KEPT)
        self._taken_us = -_EVERY_US

    def take(self, measurement: Measurement, region: Region, origin_ned_m: F64) -> None:
        """One tick.  All begins anew where the vehicle is near the edge of what was asked for, as on its way there."""
        if measurement.t_us - self._taken_us < _EVERY_US:
            return
        self._taken_us = measurement.t_us
        e_ned_m = measurement.pos_ned_m - origin_ned_m - region.centre_ned_m
        if _is_well_inside(e_ned_m, measurement.vel_ned_mps, region):
            self._kept.append(measurement.row[:6].copy())
        else:
            self._kept.clear()

    def worth(self, axis: Axis, needs: Ledger, centre_m: float, origin_m: float) -> Worth:
        """h of an axis' barrier where it is least of all that is kept or planned, as `least_h` has it with the doubts
        that the barrier needs; where nothing is, its area."""
        i, ahead = axis.axis, axis.response.c1_s + axis.response.delay_s
        states = np.array(list(self._kept)[::2]).reshape(-1, 6)
        e = np.concatenate([states[:, i] - origin_m, self._planned[:, i]]) - centre_m
        v = np.concatenate([states[:, 3 + i], self._planned[:, 3 + i]])

        def worth(barrier: Barrier) -> float:
            if not len(e):
                return barrier.area_m2ps
            return _least_h(barrier.rows, e, v, ahead, needs.setting(barrier).off_mps)

        return worth

    def least(self, certificate: Certificate, origin_ned_m: F64 | None) -> float:
        """Least h of all that is kept or planned; infinite of nothing."""
        kept = least_h(certificate, np.array(self._kept), origin_ned_m) if self._kept else math.inf
        return min(kept, least_h(certificate, self._planned, None))


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
