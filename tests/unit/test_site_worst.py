"""The search for the worst force against closed forms, and what its courses do to an integration written down anew."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flightstack.site import backup as b
from flightstack.site.tube import OBSERVER_S, LoopBounds, Tube, across
from flightstack.site.worst import STEP_S, Held, Loop, course_of, worst
from flightstack.types import F64

LAG_S, ROTORS_S = 0.06, 0.03
LAGS_S = LAG_S, ROTORS_S
LEAD_S, POLE_PS = 0.05, 2.2
DOUBTS = LoopBounds(1.5, 0.3, 0.02, 0.05)
SNAP_MPS4 = 60.0
"""As quad-x has it."""
STILL = course_of(np.zeros((1, b.ROW)), 4.0)


def tube_of() -> Tube:
    tube = across(POLE_PS, LAGS_S, DOUBTS)
    assert tube is not None
    return tube


def held(snap_mps4: float) -> Held:
    """Lean and rates as without any bound, where the snap has none."""
    much = 1e3 if snap_mps4 > 1e5 else 1.0
    return Held(snap_mps4, 5.0 * much, 30.0 * much, *DOUBTS)


def test_with_all_the_snap_it_ends_at_the_linear_tube() -> None:
    """The exact bound of a linear loop is attained by a course, which the search has to find, and by none passed."""
    tube = tube_of()
    found = worst(Loop.of(tube.gains, LAGS_S), held(1e7), STILL, (1.0, 2.0, 3.5))[0]
    assert 0.97 * tube.radius_m[-1] < found < 1.01 * tube.radius_m[-1]


def test_with_the_snap_that_there_is_the_linear_tube_is_left() -> None:
    """What a site claimed before it was searched for: the tube of the linear loop, wherever turning is bounded."""
    tube = tube_of()
    assert worst(Loop.of(tube.gains, LAGS_S), held(SNAP_MPS4), STILL, (1.0, 2.0, 3.5))[0] > 1.1 * tube.radius_m[-1]


@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_a_course_that_is_found_does_it(speed: float) -> None:
    """The same loop, integrated by another rule, under the force alone that was found, ends as far away."""
    tube, loop = tube_of(), Loop.of(tube_of().gains, LAGS_S)
    way = STILL.copy()
    way[:, 0], way[:, 2] = speed * STEP_S * np.arange(len(way)), speed
    bounds = held(SNAP_MPS4)._replace(rest_mps2=0.0, eps_p_m=0.0, eps_v_mps=0.0)
    begun = np.array([0.0, 0.0, speed, *np.zeros(9)])
    found, force = worst(loop, bounds, way, (2.0,), here=begun)
    assert np.all(np.hypot(*force.T) <= bounds.force_mps2 * (1.0 + 1e-9))

    def moved(t: float, x: F64) -> F64:
        p, v, a, j, s, o = x.reshape(6, 2)
        at = way[min(int(t / STEP_S), len(way) - 1)]
        place = at[:2] + (t - STEP_S * min(int(t / STEP_S), len(way) - 1)) * at[2:4]
        d = force[min(int(t / STEP_S), len(force) - 1)]
        k = tube.gains
        back = (k.vel_ps2 * (at[2:4] - v) + k.pos_ps3 * (place - p)) / k.acc_ps
        size = math.hypot(*back)
        back *= min(1.0, 0.5 * math.cbrt(SNAP_MPS4) * (size * k.acc_ps / k.vel_ps2) ** (2 / 3) / max(size, 1e-9))
        lean = back - 0.85 * o
        lean *= min(1.0, bounds.lean_mps2 / max(math.hypot(*lean), 1e-9))
        short = lean - a
        size = max(math.hypot(*short), 1e-9)
        more = 1.0 + LEAD_S * ROTORS_S / LAG_S**2
        late = LAG_S * more / (1.0 + LEAD_S / LAG_S) + ROTORS_S / more
        turns = min(
            k.acc_ps * size, math.sqrt((0.5 * SNAP_MPS4 * late) ** 2 + SNAP_MPS4 * size) - 0.5 * SNAP_MPS4 * late,
            bounds.fastest_mps3,
        )  # fmt: skip
        asked = (1.0 + LEAD_S / LAG_S) * (turns / size * short - j) / LAG_S - LEAD_S * ROTORS_S / LAG_S**2 * s
        asked *= min(1.0, SNAP_MPS4 / max(math.hypot(*asked), 1e-9))
        return np.concatenate([v, a + d, j, s, (asked - s) / ROTORS_S, (d - o) / OBSERVER_S])

    ended = solve_ivp(moved, (0.0, 2.0), begun, max_step=0.5 * STEP_S).y[:2, -1]
    away = float(np.min(np.hypot(*(ended - way[:, :2]).T)))
    assert 0.88 * found < away < 1.02 * found  # steps of 10 ms make it a little worse than it is
    assert found > 0.3
