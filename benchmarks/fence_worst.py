"""The force that knows the loop: against the velocity, and while a way out is followed the course that a search of the
model's loop (`flightstack.site.worst`) finds to drive it furthest from that way, from the true state, every 0.2 s."""

from __future__ import annotations

from typing import Any

import numpy as np

from flightstack.frames import quat_to_matrix
from flightstack.site import backup as b
from flightstack.site.decide import COMMITTED, FORCE, KEPT, SINCE_US
from flightstack.site.worst import STEP_S, Held, Loop, course_of, worst
from flightstack.types import F64
from flightstack.types import STANDARD_GRAVITY_MPS2 as G

_UNTIL_S, _ANEW_S = 1.2, 0.2
_LEVEL = np.array([1.0, 1.0, 0.0])


class WorstForce:
    """Its direction at every moment of a flight (`FenceFlight`)."""

    def __init__(self) -> None:
        self._course, self._begun_s, self.found = np.zeros((0, 2)), 0.0, 0
        """How often a course was searched for."""

    def way(self, flight: Any, time_s: float) -> F64:
        """(3,), of any length."""
        if flight.timed.numbers[KEPT] == 0.0:
            self._course = self._course[:0]
        elif len(self._course) == 0 or time_s - self._begun_s >= _ANEW_S:
            self._course, self._begun_s = _found(flight), time_s
            self.found += 1
        at = int((time_s - self._begun_s) / STEP_S)
        if at < len(self._course):
            return np.append(self._course[at], 0.0)
        against: F64 = -flight.vehicle.plant.vel_ned_mps * _LEVEL
        return against


def _state(flight: Any) -> F64:
    """What the search begins with, from the truth and from what the observer saw."""
    plant, numbers = flight.vehicle.plant, flight.timed.numbers
    r, (roll, pitch) = quat_to_matrix(plant.q_ned_frd), plant.rate_frd_radps[:2]
    force = G / max(r[2, 2], 0.3)
    place = plant.pos_ned_m[:2] - flight.start_ned_m[:2]
    lean, rate = -force * r[:2, 2], -force * (pitch * r[:2, 0] - roll * r[:2, 1])
    return np.concatenate([place, plant.vel_ned_mps[:2], lean, rate, np.zeros(2), numbers[FORCE : FORCE + 2]])


def _found(flight: Any) -> F64:
    """The worst course from now on, for the way that is followed."""
    numbers, made = flight.timed.numbers, flight.plan_of.certificate
    course = course_of(flight.state.filter.committed[: int(numbers[COMMITTED])])
    gone = round(1e-6 * (flight.vehicle.t_us - numbers[SINCE_US]) / STEP_S)
    row = made.rows[made.row_of(1.0 / flight.world.mass_ratio)]
    held = Held(
        made.turning.sure_mps4, float(row[b.LEAN]), min(made.turning.rate_radps * G, 2.0 * float(row[b.JERK])),
        float(np.hypot(*(line.across_mps2 for line in made.ledger[:2]))), *made.doubts[0][1:],
    )  # fmt: skip
    loop = Loop.of(made.across.gains, made.lags_s[0])
    gone = min(max(gone, 0), len(course) - 2)
    return worst(loop, held, course, (_UNTIL_S,), here=_state(flight), gone=gone)[1]
