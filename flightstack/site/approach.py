"""A reference that goes to where another one is, no faster than can be flown; compiled.

Its speed falls with the distance that is left, its acceleration and jerk are bounded: a jump of what is asked for
becomes a way.  Without the bound of jerk a jump asks for body rates that the governor does not let through, and the
loop that waits for them swings.
"""

from __future__ import annotations

import math

from flightstack.jit import njit
from flightstack.types import F64

PLACE, SPEED, ACC, SIZE = 0, 3, 6, 9
"""Of the memory: place (3, NED), velocity (3), acceleration (3)."""
ACC_MOST_MPS2, JERK_MOST_MPS3 = 3.0, 12.0
"""Of any vehicle; where jerk is bounded to less, acceleration is to as much less."""
_CATCH_UP_S, _FOLLOW_S = 0.5, 0.25


@njit
def towards(n: F64, to: F64, to_mps: F64, fastest_mps: float, jerk_mps3: float, dt: float, v: F64) -> None:
    """The velocity (3,) of the next step, into `v`; `n` (SIZE,) is left as it is."""
    most = min(ACC_MOST_MPS2, _FOLLOW_S * jerk_mps3)
    away = math.sqrt((to[0] - n[0]) ** 2 + (to[1] - n[1]) ** 2 + (to[2] - n[2]) ** 2)
    rate = min(1.0 / _CATCH_UP_S, math.sqrt(most / max(away, 1e-9)))
    size = 0.0
    for i in range(3):
        v[i] = to_mps[i] + rate * (to[i] - n[PLACE + i])
        size += v[i] * v[i]
    share = min(1.0, fastest_mps / max(math.sqrt(size), 1e-9))
    size = 0.0
    for i in range(3):
        v[i] = (share * v[i] - n[SPEED + i]) / _FOLLOW_S
        size += v[i] * v[i]
    share = min(1.0, most / max(math.sqrt(size), 1e-9))
    size = 0.0
    for i in range(3):
        v[i] = share * v[i] - n[ACC + i]
        size += v[i] * v[i]
    share = min(1.0, jerk_mps3 * dt / max(math.sqrt(size), 1e-9))
    for i in range(3):
        v[i] = n[SPEED + i] + dt * (n[ACC + i] + share * v[i])


@njit
def advance(n: F64, v: F64, jerk_mps3: float, dt: float) -> None:
    """Go on with a velocity (3,), which may have been changed since `towards`; acceleration follows by its jerk."""
    size = 0.0
    for i in range(3):
        size += ((v[i] - n[SPEED + i]) / dt - n[ACC + i]) ** 2
    share = min(1.0, jerk_mps3 * dt / max(math.sqrt(size), 1e-9))
    for i in range(3):
        n[ACC + i] += share * ((v[i] - n[SPEED + i]) / dt - n[ACC + i])
        n[SPEED + i] = v[i]
        n[PLACE + i] += dt * v[i]
