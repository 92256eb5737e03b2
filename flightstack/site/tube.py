"""How far a vehicle that follows a known way can be from it: exact for the linear loop, whatever the disturbance does.

Across, the loop is a chain: position error p, its rate v, the acceleration a that lean gives, its rate j, which follows
what is asked for with the rate loop's lag L and the rotors' T (`turning`); the observer's o follows what the
accelerometer shows beyond the model:

    p' = v,   v' = a + d + r,   a' = j,   j' = s,   tau_o o' = d - o
    T s' = (-(k_a (a + o SEEN_SHARE) + k_v (v + n_v) + k_p (p + n_p)) - j) / L - s

with the lags that the rate's lead leaves (`law`).  Here d is a force that the accelerometer shows (at most D), r what
it does not (R); n_p and n_v are the estimate's errors, at most eps_p and eps_v, from the first moment on (the way
begins where the vehicle is believed to be).  Up and down thrust answers at once but for one lag.  Bounded inputs of any
shape move p by at most the L1 norms of the answers,

    |p(t)| <= D int |g_d| + R int |g_r| + eps_p (|x_p(t)| + int |g_p|) + eps_v (|x_v(t)| + int |g_v|)

and the demand that the loop makes is bounded the same way.  o may start anywhere in [-D, D], a at -o: the way
begins with the vehicle as it is.
Norms are worked out by integrating the answers over HORIZON_S in steps of STEP_S (matrix exponential).  For vectors the
same bound holds: the loop is alike in all directions.
Source: C. Desoer, M. Vidyasagar, "Feedback Systems", 1975, section VI (gain of a linear system for bounded inputs).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from flightstack.site.law import PLACE_SHARE, SEEN_SHARE, TURN_PER_POLE, led_lags
from flightstack.types import F64

STEP_S, HORIZON_S = 0.01, 8.0
OBSERVER_S = 0.1
"""tau_o."""
MOST_MPS2 = 9.0
"""The loop asks for no more, the estimate's errors included: thrust and lean give no more."""
_ALONG_POLES = tuple(0.75 + 0.25 * k for k in range(18))


_JERK, _SNAP, _SEEN, _SEEN_ALONG = 3, 4, 5, 3
"""Of a loop's state, after position, velocity and acceleration; and what the observer saw."""


class LoopBounds(NamedTuple):
    """Bounds of what moves a loop."""

    force_mps2: float
    """D."""
    rest_mps2: float
    """R."""
    eps_p_m: float
    eps_v_mps: float


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


def across(pole_ps: float, lags_s: tuple[float, float], doubts: LoopBounds) -> Tube | None:
    """The lateral loop of a pole (`law`); lags_s: L and T, without the lead; None where it does not settle."""
    turn_ps = TURN_PER_POLE * pole_ps
    gains = Gains(turn_ps, turn_ps * pole_ps, turn_ps * PLACE_SHARE * pole_ps**2)
    return of_gains(gains, led_lags(*lags_s), doubts)


def along(lag_s: float, doubts: LoopBounds) -> Tube:
    """The vertical loop with the least tube that asks for no more than there is."""
    return _best([of_gains(Gains(0.0, 2.0 * pole, pole**2), (lag_s, 0.0), doubts) for pole in _ALONG_POLES])


def of_gains(gains: Gains, lags_s: tuple[float, float], doubts: LoopBounds) -> Tube | None:
    """The tube of a loop; None where it does not settle well within the horizon."""
    lag_s, rotors_s = lags_s
    if gains.acc_ps > 0.0:
        matrix = np.zeros((6, 6))
        matrix[[0, 1, 2, _JERK], [1, 2, _JERK, _SNAP]] = 1.0
        asked = np.array([-gains.pos_ps3, -gains.vel_ps2, -gains.acc_ps, -1.0, 0.0, -SEEN_SHARE * gains.acc_ps])
        matrix[_SNAP] = asked / (lag_s * rotors_s)
        matrix[_SNAP, _SNAP] = -1.0 / rotors_s
        matrix[_SEEN, _SEEN] = -1.0 / OBSERVER_S
        demand = np.array([gains.pos_ps3, gains.vel_ps2, 0.0, 0.0, 0.0, SEEN_SHARE * gains.acc_ps]) / gains.acc_ps
    else:
        matrix = np.zeros((4, 4))
        matrix[[0, 1], [1, 2]] = 1.0
        matrix[2] = np.array([-gains.pos_ps3, -gains.vel_ps2, -1.0, -1.0]) / lag_s
        matrix[_SEEN_ALONG, _SEEN_ALONG] = -1.0 / OBSERVER_S
        demand = np.array([gains.pos_ps3, gains.vel_ps2, 0.0, 1.0])
    return _tube(gains, matrix, demand, doubts)


def _best(found: list[Tube | None]) -> Tube:
    """The least tube among those that ask for little enough; else the one that asks for least."""
    tubes = [tube for tube in found if tube is not None]
    return min(tubes, key=lambda tube: (max(tube.demand_mps2, MOST_MPS2), float(tube.radius_m[-1])))


def _tube(gains: Gains, matrix: F64, demand: F64, doubts: LoopBounds) -> Tube | None:
    """Of one loop; None where it does not settle well within the horizon."""
    if float(np.linalg.eigvals(matrix).real.max()) > -4.0 / HORIZON_S:
        return None
    order, count = len(matrix), round(HORIZON_S / STEP_S) + 1
    step, answers = expm(STEP_S * matrix), np.empty((count, order, order))
    answers[0] = np.eye(order)
    for k in range(1, count):
        answers[k] = step @ answers[k - 1]
    into = np.zeros((order, 4))  # d, r, n_p, n_v
    into[1, :2] = 1.0
    into[-1, 0] = 1.0 / OBSERVER_S
    into[-2, 2:] = matrix[-2, :2]
    sizes = np.array(doubts)
    begun = np.zeros((order, 3))
    begun[0, 0] = begun[1, 1] = begun[-1, 2] = 1.0
    begun[2, 2] = -1.0
    started = np.array([doubts.eps_p_m, doubts.eps_v_mps, doubts.force_mps2])

    def bound(row: F64) -> F64:
        """Of row @ state over time."""
        forced = np.abs(row @ answers @ into)
        grown = np.concatenate([np.zeros((1, 4)), np.cumsum(0.5 * STEP_S * (forced[1:] + forced[:-1]), axis=0)])
        highest: F64 = np.maximum.accumulate(grown @ sizes + np.abs(row @ answers @ begun) @ started)
        return highest

    asked = float(bound(demand)[-1]) + demand[0] * doubts.eps_p_m + demand[1] * doubts.eps_v_mps
    return Tube(gains, bound(np.eye(order)[0]), float(asked))
