"""How far a vehicle that follows a known way can be from it: exact for the linear loop, whatever the disturbance does.

Across, the loop is a chain: position error p, its rate v, the lean's acceleration a, its rate j, which follows what
is asked for with the rate loop's lag:

    p' = v,   v' = a + d,   a' = j,   tau j' = -(k_a a + k_v (v + n_v) + k_p (p + n_p)) - j

d is what the model does not know, at most E; n_p and n_v are the estimate's errors, at most eps_p and eps_v, from the
first moment on (the way begins where the vehicle is believed to be).  Up and down the chain is shorter: thrust follows
what is asked for with one lag.  Bounded inputs of any shape move p by at most the L1 norms of the answers,

    |p(t)| <= E int |g_d| + eps_p (|x_p(t)| + int |g_p|) + eps_v (|x_v(t)| + int |g_v|)

and the demand that the loop makes is bounded the same way.  Norms are worked out by integrating the answers over
HORIZON_S in steps of STEP_S, exactly (matrix exponential).  For a vector d the same bound holds: the loop is alike in
all directions.  Source: C. Desoer, M. Vidyasagar, "Feedback Systems", 1975, section VI (BIBO gain of a linear system).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from flightstack.types import F64

STEP_S, HORIZON_S = 0.01, 8.0


class Gains(NamedTuple):
    """Of the feedback; for a chain of thrust alone `acc_ps` is 0."""

    acc_ps: float
    vel_ps2: float
    pos_ps3: float


class Tube(NamedTuple):
    """What a loop keeps to."""

    gains: Gains
    radius_m: F64
    """(n,) bound of the position's error at STEP_S k; the last holds from then on."""
    demand_mps2: float
    """Greatest acceleration that the feedback asks for."""
    answer_mps2: float
    """The part of it that answers d."""
    rate_mps: float
    """Greatest error of velocity."""


def across(lag_s: float, error_mps2: float, eps_p_m: float, eps_v_mps: float, most_mps2: float) -> Tube:
    """The lateral loop with the least tube that answers d with `most` at most: the triple pole for it is searched."""
    best: Tube | None = None
    for pole in np.arange(0.7, 4.51, 0.2).tolist():
        gains = Gains(3.0 * pole, 3.0 * pole**2, pole**3)
        matrix = np.array(
            [
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
                [-gains.pos_ps3 / lag_s, -gains.vel_ps2 / lag_s, -gains.acc_ps / lag_s, -1.0 / lag_s],
            ]
        )
        demand = np.array([gains.pos_ps3, gains.vel_ps2, 0.0, 0.0]) / gains.acc_ps
        best = _better(best, _tube(gains, matrix, demand, (error_mps2, eps_p_m, eps_v_mps)), most_mps2)
    assert best is not None
    return best


def along(lag_s: float, error_mps2: float, eps_p_m: float, eps_v_mps: float, most_mps2: float) -> Tube:
    """The vertical loop with the least tube that answers d with `most` at most."""
    best: Tube | None = None
    for pole in np.arange(0.7, 6.01, 0.25).tolist():
        gains = Gains(0.0, 2.0 * pole, pole**2)
        matrix = np.array(
            [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-gains.pos_ps3 / lag_s, -gains.vel_ps2 / lag_s, -1.0 / lag_s]]
        )
        demand = np.array([gains.pos_ps3, gains.vel_ps2, 0.0])
        best = _better(best, _tube(gains, matrix, demand, (error_mps2, eps_p_m, eps_v_mps)), most_mps2)
    assert best is not None
    return best


MOST_MPS2 = 9.0
"""The loop asks for no more, the estimate's errors included: thrust and lean give no more."""


def _better(one: Tube | None, other: Tube | None, most_mps2: float) -> Tube | None:
    """The one with the lesser tube among those that ask for little enough; else the one that asks for less."""
    if one is None or other is None:
        return one or other
    ends = [
        (
            max(tube.answer_mps2 - most_mps2, tube.demand_mps2 - max(MOST_MPS2, most_mps2), 0.0),
            float(tube.radius_m[-1]),
        )
        for tube in (one, other)
    ]
    return one if ends[0] <= ends[1] else other


def _tube(gains: Gains, matrix: F64, demand: F64, doubts: tuple[float, float, float]) -> Tube | None:
    """Of one loop; None where it does not settle well within the horizon."""
    if float(np.linalg.eigvals(matrix).real.max()) > -4.0 / HORIZON_S:
        return None
    order, count = len(matrix), round(HORIZON_S / STEP_S) + 1
    step, answers = expm(STEP_S * matrix), np.empty((count, order, order))
    answers[0] = np.eye(order)
    for k in range(1, count):
        answers[k] = step @ answers[k - 1]
    error, eps_p, eps_v = doubts
    into = np.zeros((order, 3))  # d enters at v; n_p and n_v where what is asked for does
    into[1, 0] = 1.0
    into[-1, 1:] = matrix[-1, 0], matrix[-1, 1]

    def bound(row: F64, error: float, eps_p: float, eps_v: float) -> F64:
        """Of row @ state over time."""
        free = np.abs(row @ answers[:, :, :2])
        forced = np.abs(row @ answers @ into)
        grown = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * STEP_S * (forced[1:] + forced[:-1]), axis=0)])
        total = grown @ np.array([error, eps_p, eps_v]) + free @ np.array([eps_p, eps_v])
        highest: F64 = np.maximum.accumulate(total)
        return highest

    place, rate = np.eye(order)[0], np.eye(order)[1]
    answer = float(bound(demand, error, 0.0, 0.0)[-1])
    asked = float(bound(demand, *doubts)[-1]) + demand[0] * eps_p + demand[1] * eps_v
    return Tube(gains, bound(place, *doubts), float(asked), answer, float(bound(rate, *doubts)[-1]))
