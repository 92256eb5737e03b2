"""How far the loop across swings where turning runs into what the governor lets through: by the worst of many forces.

The tube (`tube`) takes the loop for linear.  Its answer to a force that turns at once asks for more snap than torque
gives, and a loop that waits for its turning swings on: by metres, with poles that are right without that.  So lean that
is asked for grows with less than the speed to be taken back (`asked`): what snap S can do in the time that it takes,

    S^(1/3) e^(2/3) SHARE at most, for e = v + p_pole/3 p       (three integrals from the snap to the place)

and the same loop, at rest, with the snap that is sure, the lean that thrust has, the rates that are let through and
lags as `turning` has them, is run against forces of full size: square waves of any period, with and against the
observer's first belief, and one along the velocity; the estimate errs by all that it may.  The largest distance counts
where it is more than the linear tube's.  That is a search, no proof: a force of another course may do more, and so may
one that meets the vehicle while its way turns it.  Compiled.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flightstack.jit import njit, njit_called
from flightstack.types import F64

ASKED_SHARE, SNAP_SHARE = 0.5, 0.7
"""Of S^(1/3) e^(2/3), what is asked for; of the sure snap, what turning towards the way may take, as the way itself
takes some.  Set: the least swings of eight vehicles (docs/site.md)."""
_DT_S = 0.01
_PERIODS_S = tuple(np.geomspace(0.5, 12.0, 24).tolist())


class Held(NamedTuple):
    """What the loop has to turn with, and against what."""

    snap_mps4: float
    """`Turning.sure_mps4`."""
    lean_mps2: float
    fastest_mps3: float
    """Turning that is let through."""
    force_mps2: float
    """Half of the greatest step of force, as an acceleration."""


@njit
def asked(lin_mps2: float, pole_ps: float, snap_mps4: float) -> float:
    """Of a lean that the linear loop asks for, the share that is asked for."""
    most = ASKED_SHARE * snap_mps4 ** (1.0 / 3.0) * (lin_mps2 / pole_ps) ** (2.0 / 3.0)
    return min(1.0, most / max(lin_mps2, 1e-9))  # type: ignore[no-any-return]


@njit
def turn_towards(short_mps2: float, pole_ps: float, snap_mps4: float, late_s: float) -> float:
    """Rate of turning (m/s^3) towards a lean that is so far away: it can be stopped again, although it is late."""
    snap = SNAP_SHARE * snap_mps4
    late = snap * late_s
    return min(3.0 * pole_ps * short_mps2, math.sqrt(late * late + 2.0 * snap * short_mps2) - late)


@njit_called
def swing(
    pole_ps: float, lags_s: tuple[float, float], held: tuple[float, float, float, float],
    rest: tuple[float, float, float], periods_s: F64, out: F64,
) -> None:  # fmt: skip
    """The greatest distance until each step of the tube, into `out`; rest: acceleration, place, velocity (doubts)."""
    snap, lean, fastest, force = held
    follows = 1.0 - math.exp(-_DT_S / lags_s[1])
    for lane in range(2 * len(periods_s) + 1):
        p, v, a, j, s, o, most = rest[1], rest[2], -force, 0.0, 0.0, force, 0.0
        for k in range(len(out)):
            most = max(most, abs(p))
            out[k] = max(out[k], most)
            if lane == 2 * len(periods_s):
                d = math.copysign(force, v)
            else:
                d = force if (2.0 * k * _DT_S / periods_s[lane // 2]) % 2.0 >= 1.0 else -force
                d = d if lane % 2 == 0 else -d
            seen_p, seen_v = p - math.copysign(rest[1], p), v - math.copysign(rest[2], v)
            back = -(pole_ps * seen_v + pole_ps * pole_ps / 3.0 * seen_p)
            back *= asked(abs(back), pole_ps, snap)
            short = min(max(back - o, -lean), lean) - a
            turn = min(turn_towards(abs(short), pole_ps, snap, lags_s[0] + lags_s[1]), fastest)
            s += follows * (min(max((math.copysign(turn, short) - j) / lags_s[0], -snap), snap) - s)
            o += _DT_S / 0.1 * (d - o)
            p += _DT_S * v
            v += _DT_S * (a + d + math.copysign(rest[0], d))
            a += _DT_S * j
            j += _DT_S * s


def radii(
    pole_ps: float, lags_s: tuple[float, float], held: Held, rest: tuple[float, float, float], count: int
) -> F64:  # fmt: skip
    """(count,) of `swing`."""
    out = np.zeros(count)
    numbers = held.snap_mps4, held.lean_mps2, held.fastest_mps3, held.force_mps2
    swing(pole_ps, lags_s, numbers, rest, np.array(_PERIODS_S), out)
    return np.maximum.accumulate(out)
