"""The condition: against motion integrated exactly under the worst disturbances, and against a grid of commands."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flightstack.barrier.condition import Reach, Setting, coefficients, interval
from flightstack.barrier.published import on_the_vertical
from flightstack.barrier.records import Authority
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping, piece_at
from flightstack.types import F64

SHAPES = [
    on_the_vertical(0.6, 0.8),
    Quadratic(0.05, -0.9, 3.33, 0.35, 0.21),
    Quadratic(0.0, 0.4, 4.0, -0.9, 0.6),
    Stopping(-0.58, 0.59, 0.06, 2.6, 9.0),
]


def _random_case(rng: np.random.Generator, shape: Barrier) -> tuple[float, float, Setting, Reach]:
    e_low, e_high, v_low, v_high = shape.box
    e, v = rng.uniform(e_low - 0.1, e_high + 0.1), rng.uniform(v_low - 0.2, v_high + 0.2)
    setting = Setting(rng.uniform(0.5, 8.0), rng.uniform(0.0, 0.03), rng.uniform(0.0, 0.3), rng.uniform(0.004, 0.02))
    low = rng.uniform(-6.0, -0.5)
    return e, v, setting, Reach(low, low + rng.uniform(1.0, 14.0), *rng.uniform(0.0, 0.8, 2))


def _with_offsets(rng: np.random.Generator, setting: Setting) -> Setting:
    """The same, the state known to a centimetre or two and some cm/s."""
    return setting._replace(
        off_m=rng.uniform(0.0, 0.02), off_mps=rng.uniform(0.0, 0.1), inside_ps=rng.uniform(0.0, 20.0)
    )


def _after(e: float, v: float, u: float, parts: list[tuple[float, float]]) -> tuple[float, float]:
    """Exact motion under u + d, d constant over each part (time, d)."""
    for time, d in parts:
        e, v = e + v * time + 0.5 * (u + d) * time * time, v + (u + d) * time
    return e, v


def _q(row: F64, e: float, v: float, setting: Setting, reach: Reach, u: F64 | float) -> Any:
    a, b, c, k, m, l, n = coefficients(row, e, v, setting, reach)  # noqa: E741
    return (a * u + b) * u + c - abs(k + m * u) - abs(l + n * u)


def _surely(row: F64, e: float, v: float, setting: Setting) -> float:
    """h less what the true state's may be below it: by slopes and curvature, found as differences of the piece's h."""
    x, y, step = setting.off_m, setting.off_mps, 1e-4
    h, he, hv = piece_at(row, e, v)
    if row[0] == 0.0:
        bend = np.array(
            [[2.0 * piece_at(row, e, v)[0] - piece_at(row, e + a, v + b)[0] - piece_at(row, e - a, v - b)[0]
              for a, b in ((step, 0.0), (0.0, step), (step, step))]]
        )[0] / step**2  # fmt: skip
        kee, kvv, kev = bend[0], bend[1], 0.5 * (bend[2] - bend[0] - bend[1])
    else:
        kee, kev, kvv = 0.0, 0.0, 1.0 / (row[4] * row[5])
    return float(h - abs(he) * x - abs(hv) * y - 0.5 * (kee * x * x + kvv * y * y) - abs(kev) * x * y)


@pytest.mark.parametrize("shape", SHAPES)
def test_h_is_never_below_the_bound_at_any_time_of_the_hold(shape: Barrier) -> None:
    """Whatever d does within |d| <= E, bang-bang included, and whenever the next command comes."""
    rng = np.random.default_rng(3)
    closest = np.inf
    for _ in range(1500):
        e, v, setting, reach = _random_case(rng, shape)
        u = rng.choice([reach.u_low, reach.u_high, rng.uniform(reach.u_low, reach.u_high)])
        share = (u - reach.u_low) / (reach.u_high - reach.u_low)
        error = reach.error_low + share * (reach.error_high - reach.error_low)
        time = rng.choice([setting.dt_s, rng.uniform(0.0, setting.dt_s)])
        first = rng.uniform(0.0, time)
        for one, two in ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), rng.uniform(-1.0, 1.0, 2)):
            there = _after(e, v, u, [(first, one * error), (time - first, two * error)])
            for row in shape.rows:
                h = piece_at(row, e, v)[0]
                rate = _q(row, e, v, setting, reach, u) - setting.gamma_ps * h + setting.rate_ps
                gap = piece_at(row, *there)[0] - (h + time * rate)
                assert gap >= -1e-12
                closest = min(closest, gap / max(time, 1e-6))
    assert closest < 0.05  # 1/s: the bound is not simply far away


@pytest.mark.parametrize("shape", SHAPES)
def test_h_falls_by_no_more_than_its_share(shape: Barrier) -> None:
    """A command that meets the condition: from h >= 0, h stays above it at every moment."""
    rng = np.random.default_rng(4)
    met = 0
    for _ in range(1500):
        e, v, setting, reach = _random_case(rng, shape)
        h = min(piece_at(row, e, v)[0] for row in shape.rows)
        low, high, margin = interval(shape.rows, e, v, setting, reach)
        if margin < 0.0 or h < 0.0:
            continue
        met += 1
        worst = max(reach.error_low, reach.error_high) if reach.error_low == reach.error_high else 0.0
        for u in (low, high):
            share = (u - reach.u_low) / (reach.u_high - reach.u_low)
            error = worst or reach.error_low + share * (reach.error_high - reach.error_low)
            for time in setting.dt_s * np.array([0.1, 0.5, 1.0]):
                for d in (-error, error):
                    there = _after(e, v, u, [(time, d)])
                    least = min(piece_at(row, *there)[0] for row in shape.rows)
                    assert least >= (1.0 - setting.gamma_ps * time) * h - 1e-9
    assert met > 150


@pytest.mark.parametrize("shape", SHAPES)
def test_a_state_that_is_off_by_what_is_stated_moves_no_worse_than_the_bound(shape: Barrier) -> None:
    """The true state anywhere in its box about the known one, integrated exactly under the worst disturbances."""
    rng = np.random.default_rng(6)
    closest = np.inf
    for _ in range(1500):
        e, v, setting, reach = _random_case(rng, shape)
        setting = _with_offsets(rng, setting)._replace(inside_ps=0.0)
        u = rng.choice([reach.u_low, reach.u_high, rng.uniform(reach.u_low, reach.u_high)])
        share = (u - reach.u_low) / (reach.u_high - reach.u_low)
        error = reach.error_low + share * (reach.error_high - reach.error_low)
        time = rng.choice([setting.dt_s, rng.uniform(1e-4, setting.dt_s)])
        corners = [(x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
        for x, y in (*corners, tuple(rng.uniform(-1.0, 1.0, 2))):
            true_e, true_v = e + x * setting.off_m, v + y * setting.off_mps
            for d in (-error, error):
                there = _after(true_e, true_v, u, [(time, d)])
                for row in shape.rows:
                    surely = _surely(row, e, v, setting)
                    assert piece_at(row, true_e, true_v)[0] >= surely - 1e-9
                    rate = _q(row, e, v, setting, reach, u) - setting.gamma_ps * surely + setting.rate_ps
                    gap = piece_at(row, *there)[0] - (piece_at(row, true_e, true_v)[0] + time * rate)
                    assert gap >= -1e-10
                    closest = min(closest, gap / time)
    assert closest < 0.1


def test_an_early_next_command_is_allowed_for() -> None:
    """At the end of a full hold this command would do; half-way h has fallen further than the share of that time."""
    shape = Quadratic(0.0, -0.88, 3.284, 0.313, 0.194)
    setting, reach = Setting(2.0, 0.0, 0.0, 0.02), Reach(-2.8, 9.81, 0.0, 0.0)
    e, v, u = -0.59571, -0.1656, 5.0933
    h = piece_at(shape.rows[0], e, v)[0]

    def short(time: float) -> float:
        """What is left of h's share of that time, as a rate."""
        there = _after(e, v, u, [(time, 0.0)])
        return float((piece_at(shape.rows[0], *there)[0] - (1.0 - setting.gamma_ps * time) * h) / time)

    assert short(0.02) >= -1e-3
    assert short(0.005) < -0.05
    assert _q(shape.rows[0], e, v, setting, reach, u) < 0.0


def test_without_doubts_and_hold_it_is_the_published_condition() -> None:
    shape, reach = on_the_vertical(0.6, 0.6), Reach(-2.80286, 9.81, 0.2, 0.2)
    for e, v, u in [(0.1, 0.3, -2.0), (-0.5, 0.2, 5.0), (0.3, -1.0, 9.0)]:
        h = 1.0 - e * e / 0.36 - 0.6 * v * v
        slope = -2.0 * 0.6 * v
        expected = -2.0 * e / 0.36 * v + slope * u - abs(slope) * 0.2 + 3.0 * h
        assert _q(shape.rows[0], e, v, Setting(3.0, 0.0, 0.0, 0.0), reach, u) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_interval_against_a_grid_of_commands(shape: Barrier) -> None:
    rng = np.random.default_rng(5)
    some = none = 0
    for _ in range(600):
        e, v, setting, reach = _random_case(rng, shape)
        setting = _with_offsets(rng, setting)
        u = np.linspace(reach.u_low, reach.u_high, 2001)
        q = np.min([_q(row, e, v, setting, reach, u) for row in shape.rows], axis=0)
        low, high, margin = interval(shape.rows, e, v, setting, reach)
        step = u[1] - u[0]
        good = u[q >= 0.0]
        if margin < 0.0:
            none += 1
            assert good.size <= 1  # the grid may touch the single point that rounding misses
            assert reach.u_low <= low == high <= reach.u_high
        else:
            some += 1
            assert reach.u_low <= low <= high <= reach.u_high
            assert high - low <= (good[-1] - good[0] if good.size else 0.0) + 2.001 * step
            if good.size:
                assert low <= good[0] + 1e-9
                assert high >= good[-1] - 1e-9
    assert min(some, none) > 50


@pytest.mark.parametrize("where", ["e", "reach", "setting"])
def test_what_is_no_number_meets_nothing(where: str) -> None:
    for shape in SHAPES:
        e = np.nan if where == "e" else 0.0
        reach = Reach(-2.8, np.nan if where == "reach" else 9.8, 0.1, 0.1)
        setting = Setting(np.nan if where == "setting" else 2.0, 0.0, 0.0, 0.004)
        assert interval(shape.rows, e, 0.1, setting, reach)[2] < 0.0


def test_reach_holds_everywhere_between_two_nodes() -> None:
    """The doubt is a chord between the ends of each range; drawn inwards, an end may have more than its own node's."""
    nodes = Authority(
        np.array([-2.0, 0.0, 3.0]), np.zeros(3), np.ones(3), np.array([-3.0, -2.0, -2.5]), np.array([9.0, 8.0, 9.5]),
        np.array([0.1, 0.2, 0.6]), np.array([0.5, 0.4, 0.2]),
    )  # fmt: skip
    for v in np.linspace(-2.0, 3.0, 101):
        reach = nodes.reach(v)
        low, high = np.interp(v, nodes.v_mps, nodes.u_low_mps2), np.interp(v, nodes.v_mps, nodes.u_high_mps2)
        assert low - 1e-12 <= reach.u_low < reach.u_high <= high + 1e-12
        i = 0 if v <= 0.0 else 1
        at_low, at_high = nodes.error_low_mps2[i : i + 2].max(), nodes.error_high_mps2[i : i + 2].max()
        for u in np.linspace(reach.u_low, reach.u_high, 21):
            true = np.interp(u, [low, high], [at_low, at_high])
            ours = np.interp(u, [reach.u_low, reach.u_high], [reach.error_low, reach.error_high])
            assert ours >= true - 1e-12
