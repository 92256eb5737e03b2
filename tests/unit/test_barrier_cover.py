"""The cover: against grids ten times finer than its cells, and against regions known not to be certifiable."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from barriers import PAPER, changing, constant, cross_term, h

from flightstack.barrier.condition import Setting, coefficients
from flightstack.barrier.cover import Cover, _insert, bands, cover, region_box
from flightstack.barrier.design import at_speed
from flightstack.barrier.published import on_the_vertical
from flightstack.barrier.records import Authority
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping
from flightstack.types import F64
from tests.thorough import thorough


def at(q: tuple[float, ...], u: F64 | float) -> Any:
    """q(u) from its coefficients."""
    a, b, c, k, m, l, n = q  # noqa: E741
    return (a * u + b) * u + c - abs(k + m * u) - abs(l + n * u)


def brute(barrier: Barrier, setting: Setting, authority: Authority, e: F64, v: F64) -> F64:
    """(n,) max over u of min over pieces of q, by 101 commands, point by point, with plain numpy."""
    best = []
    for x, y in zip(e, v, strict=True):
        reach = authority.reach(y)
        u = np.linspace(reach.u_low, reach.u_high, 101)
        q = np.full(u.shape, np.inf)
        for row in barrier.rows:
            q = np.minimum(q, at(coefficients(row, x, y, setting, reach), u))
        best.append(q.max())
    return np.array(best)


def inside_points(barrier: Barrier, eta: float, n: int) -> tuple[F64, F64]:
    """Grid points of {h >= -eta}, on n x n points of its box."""
    e_low, e_high, v_low, v_high = region_box(barrier, eta)
    e, v = (x.ravel() for x in np.meshgrid(np.linspace(e_low, e_high, n), np.linspace(v_low, v_high, n)))
    keep = h(barrier, e, v) >= -eta
    return e[keep], v[keep]


CASES = [
    (cross_term(0.8, 0.82), Setting(2.0, 0.02, 0.1, 0.004), constant(*PAPER, 0.1)),
    (Quadratic(0.0, -0.9, 3.40, 0.37, 0.225), Setting(2.0, 0.02, 0.1, 0.004), constant(*PAPER, 0.1)),
    (Quadratic(0.0, -0.794, 3.4245, 0.4102, 0.2604), Setting(2.0, 0.02, 0.1, 0.02), changing()),
    (Stopping(-0.56, 0.56, 0.1, 2.2, 7.0), Setting(2.0, 0.02, 0.1, 0.01), changing()),
    (Stopping(-0.585, 0.595, 0.06, 2.5, 9.0), Setting(2.0, 0.02, 0.1, 0.004), constant(*PAPER, 0.1)),
    (
        Quadratic(0.0, -0.6, 3.6, 0.6, 0.35),
        Setting(1.0, 0.05, 0.0, 0.004, 0.006, 0.02, 10.0, 0.05),
        constant(*PAPER, 0.1),
    ),
    (Stopping(-0.55, 0.55, 0.15, 2.0, 7.0), Setting(1.0, 0.05, 0.0, 0.004, 0.006, 0.02, 10.0, 0.05), changing()),
]


@pytest.mark.parametrize(("barrier", "setting", "authority"), CASES)
def test_what_closes_is_true_on_a_finer_grid(barrier: Barrier, setting: Setting, authority: Authority) -> None:
    found = cover(barrier, setting, authority)
    assert found.closed
    assert found.failed is None
    assert found.worst_q == found.cells[:, 5].min() >= 0.0
    e, v = inside_points(barrier, setting.eta, 10 * math.isqrt(len(found.cells)))
    assert len(e) > 10 * len(found.cells)
    assert brute(barrier, setting, authority, e, v).min() >= found.worst_q - 1e-9
    for x, y in zip(e, v, strict=True):
        c = found.cells
        held = (c[:, 0] <= x) & (x <= c[:, 1]) & (c[:, 2] <= y) & (y <= c[:, 3])
        assert held.any()
        reach = authority.reach(y)
        for cell in c[held]:
            u = cell[4]
            assert reach.u_low <= u <= reach.u_high
            for row in barrier.rows:
                assert at(coefficients(row, x, y, setting, reach), u) >= cell[5]


@pytest.mark.parametrize(("barrier", "setting", "authority"), CASES)
def test_cells_tile_without_overlap(barrier: Barrier, setting: Setting, authority: Authority) -> None:
    cells = cover(barrier, setting, authority).cells
    for i, (e0, e1, v0, v1) in enumerate(cells[:, :4]):
        over_e = np.minimum(e1, cells[:, 1]) - np.maximum(e0, cells[:, 0])
        over_v = np.minimum(v1, cells[:, 3]) - np.maximum(v0, cells[:, 2])
        assert np.flatnonzero((over_e > 0.0) & (over_v > 0.0)).tolist() == [i]


def test_worst_margins_of_the_known_cross_terms() -> None:
    """mu = 0.6, c = 0.617: 1.29 / s; mu = 0.8, c = 0.82: 2.0, both at gamma = 2; and c = 0.88: 2.19 at 2.2."""
    at = constant(*PAPER)
    for barrier, gamma, margin in [
        (cross_term(0.6, 0.617), 2.0, 1.29), (cross_term(0.8, 0.82), 2.0, 2.0), (cross_term(0.8, 0.88), 2.2, 2.19),
    ]:  # fmt: skip
        assert cover(barrier, Setting(gamma, 0.0, margin - 0.01, 0.0), at).closed
        assert not cover(barrier, Setting(gamma, 0.0, margin + 0.01, 0.0), at).closed


def test_few_cells_where_there_is_margin() -> None:
    """About 230 to 250 cells were enough elsewhere for this very region."""
    assert len(cover(cross_term(0.6, 0.617), Setting(2.0, 0.0, 0.0, 0.0), constant(*PAPER)).cells) < 230


@pytest.mark.parametrize("mu", [0.6, 0.8, 2.0, 6.3])
@pytest.mark.parametrize("gamma", [0.5, 2.0, 10.0])
def test_published_form_never_closes(mu: float, gamma: float) -> None:
    """At its tips (|e| = 0.6, v = 0) every term of the condition vanishes, whatever mu and gamma: no margin at all."""
    found = cover(on_the_vertical(0.6, mu), Setting(gamma, 0.0, 0.0, 0.0), constant(*PAPER))
    assert not found.closed
    assert found.failed is not None
    assert abs(found.failed[0]) == pytest.approx(0.6, abs=1e-3)
    assert found.failed[1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(("barrier", "setting", "authority"), [*(thorough(*case) for case in CASES[:2]), *CASES[2:]])
def test_a_region_slightly_too_large_never_closes(barrier: Barrier, setting: Setting, authority: Authority) -> None:
    """Sizes around the limit that brute force finds: below it closes, above it never."""

    def truly(by: float) -> float:
        shape = at_speed(barrier, by)
        return float(brute(shape, setting, authority, *inside_points(shape, setting.eta, 40)).min())

    sizes = np.linspace(1.0, 1.5, 8)
    margins = [truly(by) for by in sizes]
    assert margins[0] > 0.0 > margins[-1]
    for by, margin in zip(sizes, margins, strict=True):
        if margin < 0.0:
            found = cover(at_speed(barrier, by), setting, authority)
            assert not found.closed
            assert found.failed is not None


def test_where_it_failed_there_is_no_command() -> None:
    barrier, setting, authority = Quadratic(0.0, -0.9, 3.3, 0.33, 0.18), Setting(2.0, 0.02, 0.1, 0.004), changing()
    found = cover(barrier, setting, authority)
    assert not found.closed
    assert found.failed is not None
    e, v = found.failed
    assert h(barrier, np.array(e), np.array(v)) >= -setting.eta - 1e-4
    assert brute(barrier, setting, authority, np.array([e]), np.array([v]))[0] < 1e-3


def test_beyond_the_nodes_nothing_is_certified() -> None:
    barrier, setting = cross_term(0.8, 0.82), Setting(2.0, 0.02, 0.1, 0.004)
    fastest = region_box(barrier, setting.eta)[3]
    for share, closes in ((1.01, True), (0.99, False)):
        nodes = np.array([-share * fastest, 0.0, share * fastest])
        assert cover(barrier, setting, constant(*PAPER, 0.0, nodes)).closed is closes


def test_cells_run_out() -> None:
    barrier, setting, authority = CASES[1]
    whole = cover(barrier, setting, authority)
    cut = cover(barrier, setting, authority, most_cells=len(whole.cells) - 1)
    assert not cut.closed
    assert cut.failed is not None
    assert len(cut.cells) == len(whole.cells) - 1


def test_same_input_same_bytes() -> None:
    one, two = (cover(*CASES[2]) for _ in range(2))
    assert one.cells.tobytes() == two.cells.tobytes()


@pytest.mark.parametrize("bad", ["nan", "empty", "one node"])
def test_unusable_authority_is_not_certified(bad: str) -> None:
    at = {
        "nan": constant(math.nan, 9.81),
        "empty": constant(3.0, 2.0),
        "one node": constant(*PAPER, 0.0, np.array([0.0])),
    }[bad]
    found: Cover = cover(cross_term(0.8, 0.82), Setting(2.0, 0.0, 0.0, 0.0), at)
    assert not found.closed


def test_bands_are_the_reach_between_the_nodes() -> None:
    authority = changing()
    for row in bands(authority):
        for v in np.linspace(row[0] + 1e-9, row[1], 7):
            assert tuple(row[2:]) == authority.reach(v)


def test_speeds_at_which_boxes_begin_rise_and_come_once() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        given = np.round(rng.normal(size=rng.integers(1, 12)), 1)
        held, count = np.empty(len(given)), 0
        for v in given.tolist():
            count = _insert(held, count, v)
        np.testing.assert_array_equal(held[:count], np.unique(given))
