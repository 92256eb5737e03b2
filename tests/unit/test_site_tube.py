"""The tube of a loop against the worst that a disturbance can do, by another integration (SciPy's)."""

from __future__ import annotations

import numpy as np
from scipy.signal import StateSpace, lsim

from flightstack.site.tube import OBSERVER_S, STEP_S, LoopBounds, Tube, across
from flightstack.types import F64

LAG_S, ROTORS_S = 0.06, 0.03
LAGS_S = LAG_S, ROTORS_S
LEAD_S, POLE_PS = 0.05, 2.2
T = np.arange(0.0, 6.0, STEP_S)


def loop(tube: Tube) -> StateSpace:
    """p, v, a, j, s, o, written down anew; inputs d, r, n_p, n_v.  The rate that is asked for leads by LEAD_S:
    T s' = (1 + LEAD_S / L) (c - j) / L - (LEAD_S T / L^2 + 1) s; of the force that is seen 0.85 is leant against."""
    k, lead = tube.gains, (1.0 + LEAD_S / LAG_S) / (LAG_S * ROTORS_S)
    asked = [-k.pos_ps3, -k.vel_ps2, -k.acc_ps, -1.0, 0.0, -0.85 * k.acc_ps]
    snap = [lead * each for each in asked]
    snap[4] = -LEAD_S / LAG_S**2 - 1.0 / ROTORS_S
    a = np.array([
        [0, 1, 0, 0, 0, 0],
        [0, 0, 1, 0, 0, 0],
        [0, 0, 0, 1, 0, 0],
        [0, 0, 0, 0, 1, 0],
        snap,
        [0, 0, 0, 0, 0, -1 / OBSERVER_S],
    ])  # fmt: skip
    none = [0, 0, 0, 0]
    b = np.array([
        none, [1, 1, 0, 0], none, none, [0, 0, *snap[:2]], [1 / OBSERVER_S, 0, 0, 0],
    ])  # fmt: skip
    return StateSpace(a, b, np.eye(1, 6), np.zeros((1, 4)))


def tube_of(doubts: LoopBounds) -> Tube:
    tube = across(POLE_PS, LAGS_S, doubts)
    assert tube is not None
    return tube


def moved(tube: Tube, inputs: F64, start: F64) -> F64:
    return lsim(loop(tube), inputs, T, start, interp=False)[1]


def test_nothing_within_the_doubts_leaves_the_tube() -> None:
    doubts = LoopBounds(1.5, 0.3, 0.02, 0.05)
    tube = tube_of(doubts)
    rng = np.random.default_rng(0)
    for _ in range(60):
        held = rng.integers(1, 120)
        signs = np.repeat(rng.choice([-1.0, 1.0], (len(T) // held + 1, 4)), held, axis=0)[: len(T)]
        start = np.array([0.02, 0.05, 0.0, 0.0, 0.0, 1.5]) * rng.choice([-1.0, 1.0], 6)
        assert np.all(np.abs(moved(tube, signs * np.array(doubts), start)) <= tube.radius_m[: len(T)] * 1.005)


def test_the_worst_disturbance_comes_to_its_rim() -> None:
    """Bang-bang by the sign of the answer, backwards in time: the bound is tight, so half of it would be broken."""
    doubts = LoopBounds(1.5, 0.0, 0.0, 0.0)
    tube = tube_of(doubts)
    pulse = np.zeros((len(T), 4))
    pulse[0, 0] = 1.0 / STEP_S
    answer = moved(tube, pulse, np.zeros(6))
    inputs = np.zeros((len(T), 4))
    inputs[:, 0] = 1.5 * np.sign(answer[::-1])
    start = np.array([0.0, 0.0, 0.0, 0.0, 0.0, inputs[0, 0]])
    worst = float(np.abs(moved(tube, inputs, start))[-1])
    assert 0.9 * tube.radius_m[-1] - 0.05 < worst <= tube.radius_m[-1] * 1.01
    assert worst > 0.5 * tube.radius_m[-1]


def test_less_doubt_is_a_narrower_tube() -> None:
    wide, narrow = tube_of(LoopBounds(1.5, 0.3, 0.02, 0.05)), tube_of(LoopBounds(0.75, 0.15, 0.01, 0.025))
    assert narrow.radius_m[-1] <= 0.55 * wide.radius_m[-1]
    assert np.all(np.diff(wide.radius_m) >= 0.0)
