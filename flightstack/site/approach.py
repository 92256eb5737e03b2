"""A reference that goes to where another one is, no faster than can be flown; compiled.

It is the other one and what lies between them, which shrinks: its speed falls with the distance that is left, its
acceleration and jerk are bounded.  A jump of what is asked for becomes a way, and one that moves is caught up with.
Without the bound of jerk a jump asks for body rates that the governor does not let through, and the loop that waits
for them swings.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.jit import njit
from flightstack.types import F64

PLACE, SPEED, ACC, SIZE = 0, 3, 6, 9
"""Of the memory: place (3, NED), velocity (3), acceleration (3)."""
ACC_MOST_MPS2, JERK_MOST_MPS3 = 3.0, 12.0
"""Of any vehicle, beyond what the other reference does itself; where jerk is bounded to less, all takes longer."""
_MOST_MPS = 3.0
_CATCH_UP_S, _FOLLOW_S = 0.8, 0.25


@njit
def towards(n: F64, to: F64, jerk_mps3: float, dt: float, v: F64) -> None:
    """The velocity (3,) of the next step, into `v`; `n` (SIZE,) is left as it is.

    to (12,): position, velocity, acceleration and jerk of the other.  With an eighth of the jerk the same distance is
    gone in twice the time, with a quarter of the acceleration: times by the cube root, or it would swing.
    """
    longer = (JERK_MOST_MPS3 / jerk_mps3) ** (1.0 / 3.0)
    most, follow_s = ACC_MOST_MPS2 / longer**2, _FOLLOW_S * longer
    left, wanted, change = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        left[i] = to[i] - n[PLACE + i]
    away = _size(left)
    rate = min(1.0 / (_CATCH_UP_S * longer), math.sqrt(most / max(away, 1e-9)), _MOST_MPS / max(away, 1e-9))
    for i in range(3):
        wanted[i] = (rate * left[i] + to[3 + i] - n[SPEED + i]) / follow_s
    _shorten(wanted, most)
    for i in range(3):
        change[i] = wanted[i] + to[6 + i] - n[ACC + i]
    _shorten(change, jerk_mps3 * dt)
    share = dt * min(1.0, JERK_MOST_MPS3 / max(_size(to[9:12]), 1e-9))
    for i in range(3):
        v[i] = n[SPEED + i] + dt * (n[ACC + i] + share * to[9 + i] + change[i])


@njit
def advance(n: F64, v: F64, jerk_mps3: float, dt: float) -> None:
    """Go on with a velocity (3,), which may have been changed since `towards`; acceleration follows by its jerk."""
    change = np.empty(3)
    for i in range(3):
        change[i] = (v[i] - n[SPEED + i]) / dt - n[ACC + i]
    _shorten(change, jerk_mps3 * dt)
    for i in range(3):
        n[ACC + i] += change[i]
        n[SPEED + i] = v[i]
        n[PLACE + i] += dt * v[i]


@njit
def _size(x: F64) -> float:
    return math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])


@njit
def _shorten(x: F64, most: float) -> None:
    share = min(1.0, most / max(_size(x), 1e-9))
    for i in range(3):
        x[i] *= share
