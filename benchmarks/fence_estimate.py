"""An estimate that errs by all that is declared of it, so that what is near seems further away than it is.

Position, velocity and attitude are the truth's, each off by its declared bound, away from what is nearest: the vehicle
believes itself further off, slower towards it and leaning away from it.  The errors turn within _TURN_S where another
edge becomes the nearest: bounds are declared, jumps are not.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.rows import ATTITUDE, VEL_N
from flightstack.site.clearance import clear_of
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Measurement

_TURN_S, _PROBE_M, _MOST_M, _LAST = 0.1, 0.02, 100.0, 64


class Truth(NamedTuple):
    """The vehicle at a time; NED, of the world."""

    t_us: int
    pos_ned_m: F64
    vel_ned_mps: F64
    q_ned_frd: F64


class ErringEstimate:
    """Remembers the truth and makes the worst of it."""

    def __init__(self, declared: EstimateBounds, site: F64) -> None:
        """`site` packed, relative to the true start."""
        self._sizes = [np.array(part) for part in (declared.pos_m, declared.vel_mps, declared.acc_mps2)]
        self._site, self._seen, self._away = site, deque[Truth](maxlen=_LAST), np.zeros(3)
        self._at_us = -1

    def saw(self, truth: Truth) -> None:
        """The vehicle now."""
        self._seen.append(truth)

    def made(self, measured: Measurement, start_ned_m: F64, origin_ned_m: F64) -> Measurement:
        """The measurement with the truth of its time and all that may be wrong with it.

        `start_ned_m` (3,) the true place of the start, `origin_ned_m` (3,) the believed one.
        """
        truth = min(self._seen, key=lambda each: abs(each.t_us - measured.t_us))
        self._turn(truth.pos_ned_m - start_ned_m, measured.t_us)
        row, (eps_p, eps_v, eps_a) = measured.row.copy(), self._sizes
        row[:3] = truth.pos_ned_m + (origin_ned_m - start_ned_m) + self._away * eps_p
        row[VEL_N : VEL_N + 3] = truth.vel_ned_mps + self._away * eps_v
        lean = self._away[:2] * eps_a[:2] / STANDARD_GRAVITY_MPS2
        row[ATTITUDE : ATTITUDE + 4] = _turned(truth.q_ned_frd, np.array([lean[1], -lean[0], 0.0]))
        return Measurement(
            measured.t_us, row, measured.position_age_us, measured.attitude_age_us, measured.imu_age_us,
            measured.battery_v,
        )  # fmt: skip

    def _turn(self, place: F64, t_us: int) -> None:
        """The direction away from what is nearest, a little later."""
        away = np.array([self._clear(place, axis, 1.0) - self._clear(place, axis, -1.0) for axis in range(3)])
        size = float(np.linalg.norm(away))
        if size > 0.0:
            passed_s = 1e-6 * (t_us - self._at_us) if self._at_us >= 0 else _TURN_S
            self._away += min(passed_s / _TURN_S, 1.0) * (away / size - self._away)
            self._at_us = t_us

    def _clear(self, place: F64, axis: int, sign: float) -> float:
        disc = np.array([[place[0], place[1], -place[2], 0.0, 0.0]])
        disc[0, axis] += sign * _PROBE_M * (-1.0 if axis == 2 else 1.0)
        return clear_of(self._site, disc, 1, _MOST_M)[0]


def _turned(q: F64, turn_rad: F64) -> F64:
    """A quaternion (w, x, y, z) turned by a small vector of the world's axes."""
    angle = float(np.linalg.norm(turn_rad))
    if angle == 0.0:
        return q.copy()
    w, (x, y, z) = math.cos(0.5 * angle), math.sin(0.5 * angle) * turn_rad / angle
    by = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    turned: F64 = by @ q
    return turned
