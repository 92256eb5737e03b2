"""Algorithm 1 for stops: faster and faster in all directions, as far as the certificate in force allows.

A round is a star: eight straight runs from rest to rest, each turned by 135 degrees against the one before, so that
every direction in steps of 45 degrees is flown once, and the last run ends where the first began.  A run is as fast as
is asked only where the certified way out from each of its points is clear of everything forbidden, and the filter would
not bend it; else the star is flown slower.  After a round what was felt gives a narrower certificate, under which the
same room allows more.

The next round is faster by half at most, and no faster than at which what was felt, grown with the square of the speed
(as drag does), stays within the certificate in force.  It ends where that is hardly faster than what was flown.

Source: L. Wang, E. Theodorou, M. Egerstedt, "Safe Learning of Quadrotor Dynamics Using Barrier Certificates", 2018,
Algorithm 1; what it samples next is the state of greatest uncertainty: here the fastest that can be left again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flightstack.rows import JERK_E, JERK_N
from flightstack.site import backup
from flightstack.site.clearance import CHUTE, clear_of
from flightstack.site.stopping import SMOOTH_M, Prior, StoppingCertificate
from flightstack.trajectory import Polynomial, Trajectory, minimum_snap
from flightstack.types import F64, STANDARD_GRAVITY_MPS2

FIRST_MPS, MOST_MPS, GROWTH = 2.0, 8.0, 1.5
_CALM = 1.1
"""A round that is not faster by so much is none."""
RUNS = 8
_TURNED_RAD = 0.75 * math.pi
EXTRAPOLATED = math.sqrt(1.5)
"""How much faster than was flown a certificate holds: what was felt counts half as much again."""
_ACC_MPS2 = 3.5
"""The most that a run accelerates: what braking is certified for, less room to follow it."""
_HURRY_S = 0.7
"""A slow one accelerates less: a short path from rest to rest turns fast."""
_GENTLE = 0.5
"""The same for the ways to the first corner and back."""
_PEAK_SPEED, _PEAK_ACC = 35.0 / 16.0, 7.5132
"""Of a path of degree 7 from rest to rest, over length by time and by time squared."""
_EVERY_S, _LEAD = 0.1, 1.05
_SLOWER = 0.93
DIRECTIONS = np.stack([[math.cos(math.pi / 4.0 * k), math.sin(math.pi / 4.0 * k)] for k in range(RUNS)])
"""(8, 2) north, east."""


class StarRound(NamedTuple):
    """One star, and what came of it."""

    asked_mps: float
    flown_mps: float
    """The least over the directions of the greatest speed."""
    force_mps2: float
    """The greatest that was felt up to its end."""
    prior: Prior | None
    """What the certificate in force from its end on holds for; None: the one before it stays."""


def star(middle_ned_m: F64, yaw_rad: float, speed_mps: float) -> list[Polynomial]:
    """The way to the star's first corner (3,), its eight runs at that greatest speed, and the way back."""
    acc_mps2 = min(_ACC_MPS2, speed_mps / _HURRY_S)
    length = _PEAK_ACC / _PEAK_SPEED**2 * speed_mps**2 / acc_mps2
    around = 0.5 * length / math.cos(0.5 * (math.pi - _TURNED_RAD))
    corners = [np.append(middle_ned_m, yaw_rad)]
    for k in range(RUNS + 1):
        angle = math.pi / RUNS + _TURNED_RAD * k  # so that the runs lead along DIRECTIONS
        corners.append(corners[0] + around * np.array([math.cos(angle), math.sin(angle), 0.0, 0.0]))
    corners.append(corners[0])
    paths = []
    for k, (start, end) in enumerate(pairwise(corners)):
        hard = acc_mps2 if 0 < k <= RUNS else _GENTLE * acc_mps2
        span = math.sqrt(_PEAK_ACC * float(np.linalg.norm((end - start)[:3])) / hard)
        paths.append(minimum_snap(np.stack([start, end]), np.array([0.0, span])))
    return paths


def leads_clear(path: Trajectory, made: StoppingCertificate, flat: F64) -> bool:
    """Whether the certified way out from each point of a path (relative to the site's origin) is clear of a packed
    site, its chutes shut, for a vehicle that follows it a little faster."""
    shut = flat.copy()
    shut[CHUTE] = -1.0
    path = path.slowed(_LEAD)
    row, half = made.rows[made.row_of(0.0)], made.halves()[1]
    points, way, start = np.zeros((backup.STEPS, backup.ROW)), np.zeros((backup.STEPS, 5)), np.zeros(backup.ROW)
    for t_s in np.arange(0.0, path.duration_s, _EVERY_S).tolist():
        start[: backup.ASKED_N] = path.at(t_s).row[: backup.ASKED_N]
        start[backup.ASKED_N : backup.SNAP_N] = start[JERK_N : JERK_E + 1]
        count = backup.roll(start, row, half, points, way)
        if count == 0 or clear_of(shut, way, count, 1.0)[0] < SMOOTH_M:
            return False
    return True


def fastest_star(
    middle_ned_m: F64, yaw_rad: float, speed_mps: float, fits: Callable[[Trajectory], bool]
) -> tuple[float, list[Polynomial]]:
    """The star at that speed, or the fastest below whose paths fit; 0 and nothing where none does."""
    while speed_mps > 0.5:
        paths = star(middle_ned_m, yaw_rad, speed_mps)
        if all(fits(path) for path in paths):
            return speed_mps, paths
        speed_mps *= _SLOWER
    return 0.0, []


def allowed_mps(flown_mps: float, force_mps2: float, in_force: Prior) -> float:
    """How fast the next round may be: the certificate knows what was felt, grown with the square of the speed."""
    most = in_force.force_g * STANDARD_GRAVITY_MPS2
    within = flown_mps * math.sqrt(most / force_mps2) if force_mps2 > 0.0 else math.inf
    return min(GROWTH * flown_mps, within, in_force.speed_mps, MOST_MPS)


def is_worth(speed_mps: float, flown_mps: float) -> bool:
    """Whether a round at that speed would show more than was flown."""
    return speed_mps >= _CALM * flown_mps
