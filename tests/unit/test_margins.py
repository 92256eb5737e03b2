"""The ledger against suprema found by brute force on a fine grid."""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.barrier import margins
from flightstack.barrier.condition import Reach, Setting, coefficients, margin_at
from flightstack.barrier.margins import USUAL, Accuracy, Doubts, Ledger, Slopes, _sources
from flightstack.barrier.records import MARGINS, Authority, Response
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping, piece_at
from tests.thorough import ONLY_THEN

FINE = Accuracy(0.002, 0.01, 0.035)
SHAPES = [
    Quadratic(0.0, 0.0, 1 / 0.36, 0.0, 0.6),
    Quadratic(0.0, 0.0, 3.122, 0.365, 0.386),
    Quadratic(0.05, -0.88, 3.284, 0.313, 0.194),
    Stopping(-0.6, 0.6, 0.1, 2.0, 5.0),
]
LOW, HIGH, ERROR, DT = -2.5, 4.0, 0.4, 0.004


def authority() -> Authority:
    v, one = np.array([-4.0, 4.0]), np.ones(2)
    return Authority(v, 9.8 * one, 0.7 * one, LOW * one, HIGH * one, ERROR * one, ERROR * one)


def slopes(barrier: Barrier, low_mps2: float, high_mps2: float, error_mps2: float, dt_s: float) -> Slopes:
    """For commands and accelerations from low to high and errors up to `error`."""
    given = np.zeros(7)
    given[:4] = low_mps2, high_mps2, error_mps2, dt_s
    found = margins._slopes(barrier.rows, margins._fastest(barrier), given, 0.0, margins._CIRCLE)
    return Slopes(*found[:5])


def inside(barrier: Barrier, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A grid over the region of all pieces."""
    e_low, e_high, v_low, v_high = barrier.box
    e, v = (each.ravel() for each in np.meshgrid(np.linspace(e_low, e_high, 301), np.linspace(v_low, v_high, 301)))
    held = np.array([min(piece_at(r, a, b)[0] for r in barrier.rows) >= 0.0 for a, b in zip(e, v, strict=True)])
    return e[held], v[held]


def q(row: np.ndarray, e: float, v: float, u: float, off_m: float = 0.0, off_mps: float = 0.0) -> float:
    setting = Setting(0.0, 0.0, 0.0, DT, off_m, 0.0, 0.0, off_mps)
    return margin_at(coefficients(row, e, v, setting, Reach(LOW, HIGH, ERROR, ERROR)), u)


@pytest.mark.parametrize("barrier", SHAPES, ids=["mu", "centred", "free", "stopping"])
def test_slopes_hold_over_the_region_and_are_not_far_above(barrier: Barrier) -> None:
    at = slopes(barrier, LOW, HIGH, ERROR, DT)
    h_e = h_v = flow_h = speed = 0.0
    for row in barrier.rows:
        es, vs = inside(barrier, row)
        for e, v in list(zip(es, vs, strict=True))[::211]:
            _, he, hv = piece_at(row, e, v)
            h_e, h_v, speed = max(h_e, abs(he)), max(h_v, abs(hv)), max(speed, abs(v))
            flow_h = max(flow_h, abs(he * v + hv * LOW), abs(he * v + hv * HIGH))
    for ours, brute in ((at.h_e, h_e), (at.h_v, h_v), (at.flow_h, flow_h), (at.speed, speed)):
        assert brute <= ours * (1.0 + 1e-6)
        assert ours <= 2.0 * brute


ASKED = {(0, "free"), (0, "stopping"), (2, "mu"), (2, "stopping")}
"""Every shape once, the one of two pieces on both kinds of axis."""


@pytest.mark.parametrize(
    ("axis", "barrier"),
    [
        pytest.param(axis, barrier, id=f"{axis}-{name}", marks=[] if (axis, name) in ASKED else [ONLY_THEN])
        for axis in (0, 2)
        for name, barrier in zip(("mu", "centred", "free", "stopping"), SHAPES, strict=True)
    ],
)
def test_no_error_within_the_stated_doubts_costs_more_than_the_condition_takes(barrier: Barrier, axis: int) -> None:
    """Known states and true ones, each doubt at one of its ends: q and h as known are never above what is true."""
    response = Response(0.03, 0.0, 0.02) if axis == 2 else Response(0.15, 0.15 * 0.03, 0.02)
    accuracy, doubts = Accuracy(0.002, 0.01, 0.03), Doubts(0.004, 0.2, 0.2, 0.03, 0.0)
    setting, _ = Ledger(
        axis, authority(), response, gamma_ps=2.0, dt_s=DT, accuracy=accuracy, doubts=doubts
    )(barrier)  # fmt: skip
    rng, worst_h, tightest = np.random.default_rng(4), 0.0, 0.0
    for row in barrier.rows:
        es, vs = inside(barrier, row)
        for _ in range(4_000):
            i = rng.integers(len(es))
            e, v, u, a = float(es[i]), float(vs[i]), rng.uniform(LOW, HIGH), rng.choice([LOW, HIGH])
            late = doubts.delay_s * rng.choice([-1.0, 1.0])
            late += (0.0 if axis == 2 else doubts.lag_share * doubts.rotor_lag_s) * rng.choice([-1.0, 1.0])
            shift_e, shift_v = (
                scale * rng.choice([-1.0, 1.0])
                for scale in (
                    accuracy.pos_m + (response.c1_s + response.delay_s) * accuracy.vel_mps,
                    accuracy.vel_mps + response.c1_s * (ERROR - accuracy.acc_mps2),
                )
            )
            known_e, known_v = e + late * v + shift_e, v + late * a + shift_v
            plain, held = q(row, known_e, known_v, u), q(row, known_e, known_v, u, setting.off_m, setting.off_mps)
            true = q(row, e, v, u)
            assert held <= true + 1e-9
            tightest = max(tightest, (plain - true) / (plain - held))
            worst_h = max(worst_h, piece_at(row, known_e, known_v)[0] - piece_at(row, e, v)[0])
    ellipse = isinstance(barrier, Quadratic)  # a stopping way has its greatest slopes at speeds that few samples reach
    assert (0.3 if ellipse else 0.2) < tightest <= 1.0
    assert (0.2 if ellipse else 0.1) * setting.eta < worst_h <= setting.eta


@pytest.mark.parametrize("share", [-0.2, 0.2])
def test_a_lag_and_the_delay_that_was_fitted_with_it_put_the_state_off_by_no_more_than_stated(share: float) -> None:
    """Thrust from end to end at the worst times, integrated: a lag off by a fifth, the sum of lag and delay right."""
    lag, delay, dt = 0.05, 0.03, 1e-5
    true_lag, true_delay = lag * (1.0 + share), delay - share * lag
    x = np.arange(0.0, 1.0, dt)  # age of a command
    true, model = (np.where(x > d, 1.0 - np.exp(-(x - d) / t), 0.0) for t, d in ((true_lag, true_delay), (lag, delay)))
    speed = true - model  # weight of a command of that age in what z's speed is off by; z's own is the same for both
    place = np.cumsum(speed) * dt
    _, margins = Ledger(2, authority(), Response(lag, 0.0, delay), gamma_ps=2.0, dt_s=DT)(SHAPES[1])
    assert any(each.name == "rotor_lag" for each in margins)
    worst_v = 0.5 * (HIGH - LOW) * float(np.abs(speed).sum()) * dt
    worst_e = max(-LOW, HIGH) * float(np.abs(place).sum()) * dt
    source = _sources(2, Response(lag, 0.0, delay), HIGH - LOW, max(-LOW, HIGH), 0.0, FINE, USUAL, 0.0)[2]
    assert source.name == "rotor_lag"
    assert source.eps_v == pytest.approx(worst_v, rel=0.02)
    assert 0.8 * source.eps_e < worst_e <= source.eps_e * 1.001


def test_every_margin_is_named_once_and_grows_with_its_own_doubt() -> None:
    barrier, response = SHAPES[1], Response(0.03, 0.0, 0.02)

    def lines(**changes: object) -> dict[str, float]:
        given = {"gamma_ps": 2.0, "dt_s": DT, "gain_part_mps2": 0.1, "accuracy": FINE, **changes}
        _, margins = Ledger(2, authority(), response, **given)(barrier)  # type: ignore[arg-type]
        assert tuple(each.name for each in margins) == MARGINS
        assert all(each.because for each in margins)
        return {each.name: each.mps2 for each in margins}

    plain = lines()
    assert plain["gp_error"] + plain["thrust_gain"] == pytest.approx(ERROR - FINE.acc_mps2)
    for name, changes in (
        ("delay", {"doubts": Doubts(delay_s=0.008)}), ("rotor_lag", {"doubts": Doubts(lag_share=0.4)}),
        ("age", {"doubts": Doubts(age_s=0.004)}),
        ("estimate_error", {"accuracy": Accuracy(*(2.0 * each for each in FINE))}),
        ("zero_order_hold", {"dt_s": 0.02}), ("thrust_gain", {"gain_part_mps2": 0.2}),
    ):  # fmt: skip
        changed = lines(**changes)
        assert changed[name] > 1.2 * plain[name], name


def test_a_perfect_vehicle_costs_nothing() -> None:
    v, one = np.array([-4.0, 4.0]), np.ones(2)
    exact = Authority(v, 9.8 * one, one, LOW * one, HIGH * one, 0.0 * one, 0.0 * one)
    setting, margins = Ledger(
        2, exact, Response(0.0, 0.0, 0.0), gamma_ps=2.0, dt_s=0.0, accuracy=Accuracy(0.0, 0.0, 0.0),
        doubts=Doubts(0.0, 0.0, 0.0, age_s=0.0),
    )(SHAPES[1])  # fmt: skip
    assert setting == (2.0, *(7 * [0.0]))
    assert all(each.mps2 == 0.0 for each in margins)


NOTHING = Doubts(0.0, 0.0, 0.0, age_s=0.0)
C1, DELAY, FASTEST, HARDEST, SPAN = 0.1, 0.02, 1.0 / np.sqrt(0.6), 4.0, 6.5
"""Of SHAPES[0] and `authority`; the error is 0.4."""


@pytest.mark.parametrize(
    ("axis", "c2_s2", "accuracy", "doubts", "coupling", "off_m", "off_mps"),
    [
        # E over the delay: 1/2 E t^2, which z (position and C1 times speed) moves by C1 t E beside; z apart by C1 E
        (2, 0.0, (0, 0, 0), NOTHING, 0.0, (0.01 + C1) * 0.02 * 0.4, 0.02 * 0.4 + C1 * 0.4),
        (2, 0.0, (0, 0, 0), NOTHING, 0.3, 0.00088, 0.048 + 0.3),
        # an estimate that is off, seen C1 + delay ahead; of E as much is the attitude's own
        (2, 0.0, (0.01, 0.02, 0), NOTHING, 0.0, 0.00088 + 0.01 + 0.12 * 0.02, 0.048 + 0.02),
        (2, 0.0, (0, 0, 0.1), NOTHING, 0.0, 0.11 * 0.02 * 0.3 + 0.11 * 0.02 * 0.1, 0.12 * 0.3 + 0.12 * 0.1),
        (0, 0.003, (0, 0, 0.1), NOTHING, 0.0, 0.11 * 0.02 * 0.3 + (0.003 + 0.0022) * 0.1, 0.048),
        # 8 ms more or less of delay: along the motion at its fastest, and by the hardest command
        (2, 0.0, (0, 0, 0), NOTHING._replace(delay_s=0.008), 0.0, 0.00088 + 0.008 * FASTEST,
         0.048 + 0.008 * 0.4 + 0.008 * HARDEST),
        # the rotors' constant off by a fifth, dC: hardest (C1 + dC / 2) dC, and dC / e of the span between two lags
        (2, 0.0, (0, 0, 0), NOTHING._replace(lag_share=0.2), 0.0, 0.00088 + HARDEST * 0.11 * 0.02,
         0.048 + 0.02 * SPAN / np.e),
        # sideways the rotors' doubt is one of delay; the rate loop's is of its lag, C2 / C1 = 30 ms
        (0, 0.003, (0, 0, 0), NOTHING._replace(lag_share=0.2, rotor_lag_s=0.05), 0.0, 0.00088 + 0.01 * FASTEST,
         0.048 + 0.01 * 0.4 + 0.01 * HARDEST),
        (0, 0.003, (0, 0, 0), NOTHING._replace(rate_lag_share=0.2), 0.3, 0.00088 + 0.5 * C1 * 0.006 * SPAN,
         0.048 + 0.3 + 0.006 * SPAN),
        # a sample 50 ms old: E and the attitude's error over them and over what is ahead
        (2, 0.0, (0, 0.02, 0.1), NOTHING._replace(age_s=0.05), 0.0,
         0.11 * 0.02 * 0.4 + 0.12 * 0.02 + 0.05 * (0.02 + 0.145 * 0.4), 0.12 * 0.4 + 0.02 + 0.05 * 0.4),
    ],
)  # fmt: skip
def test_by_how_much_the_state_may_be_off_is_the_sum_worked_out_by_hand(
    axis: int, c2_s2: float, accuracy: tuple[float, ...], doubts: Doubts, coupling: float, off_m: float, off_mps: float
) -> None:
    setting, _ = Ledger(
        axis, authority(), Response(C1, c2_s2, DELAY), gamma_ps=2.0, dt_s=DT,
        accuracy=Accuracy(*accuracy), doubts=doubts, coupling_mps=coupling,
    )(SHAPES[0])  # fmt: skip
    late = doubts.delay_s + (doubts.lag_share * doubts.rotor_lag_s if axis != 2 else 0.0)
    grown = late * FASTEST * (np.sqrt(1.0 + setting.eta) - 1.0)  # at the edge of the region with its eta, nearly
    assert setting.off_m == pytest.approx(off_m + grown, rel=1e-3 if late else 1e-9)
    assert setting.off_mps == pytest.approx(off_mps, rel=1e-9)
