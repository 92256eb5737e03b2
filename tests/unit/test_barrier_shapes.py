"""Shapes: against finite differences, random steps and areas counted on a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from barriers import h

from flightstack.barrier.published import on_the_vertical
from flightstack.barrier.shapes import K_EE, K_EV, K_VV, Barrier, Quadratic, Stopping, gradient, piece_at, value
from flightstack.types import InputError

SHAPES = [
    on_the_vertical(0.6, 0.6),
    Quadratic(0.1, -0.88, 3.284, 0.313, 0.194),
    Stopping(-0.6, 0.5, 0.05, 2.6, 9.0),
    Stopping(-0.2, 0.9, 0.3, 1.0, 0.7),
]


@pytest.mark.parametrize("shape", SHAPES)
def test_value_is_the_definition(shape: Barrier) -> None:
    rng = np.random.default_rng(7)
    for e, v in rng.uniform((-1.0, -4.0), (1.0, 2.0), (100, 2)):
        assert value(shape, e, v) == pytest.approx(float(h(shape, e, v)), abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_gradient_is_the_slope_of_the_value(shape: Barrier) -> None:
    rng = np.random.default_rng(1)
    step = 1e-6
    checked = 0
    for e, v in rng.uniform((-1.0, -4.0), (1.0, 2.0), (200, 2)):
        pieces = sorted(piece_at(row, e, v)[0] for row in shape.rows)
        if len(pieces) > 1 and pieces[1] - pieces[0] < 1e-4:
            continue  # on the ridge between two pieces there is no gradient
        along_e = (value(shape, e + step, v) - value(shape, e - step, v)) / (2 * step)
        along_v = (value(shape, e, v + step) - value(shape, e, v - step)) / (2 * step)
        assert gradient(shape, e, v) == pytest.approx((along_e, along_v), abs=2e-5)
        checked += 1
    assert checked > 150


@pytest.mark.parametrize("shape", SHAPES)
def test_curvature_is_bounded_by_the_constant(shape: Barrier) -> None:
    rng = np.random.default_rng(2)
    for row in shape.rows:
        bound = np.array([[row[K_EE], row[K_EV]], [row[K_EV], row[K_VV]]])
        for e, v, de, dv in rng.uniform((-1.0, -4.0, -1.0, -4.0), (1.0, 2.0, 1.0, 4.0), (300, 4)):
            step = np.array([de, dv])
            here, h_e, h_v = piece_at(row, e, v)
            plane = here + h_e * de + h_v * dv
            there = piece_at(row, e + de, v + dv)[0]
            assert plane - 0.5 * step @ bound @ step - 1e-9 <= there <= plane + 1e-9  # the right side: concave


@pytest.mark.parametrize("shape", SHAPES)
def test_area_and_box_against_a_count_on_a_grid(shape: Barrier) -> None:
    e_low, e_high, v_low, v_high = shape.box
    e, v = np.linspace(e_low - 0.05, e_high + 0.05, 601), np.linspace(v_low - 0.05, v_high + 0.05, 601)
    inside = h(shape, *np.meshgrid(e, v, indexing="ij")) >= 0.0
    counted = inside.sum() * (e[1] - e[0]) * (v[1] - v[0])
    assert shape.area_m2ps == pytest.approx(counted, rel=3e-3)
    at_e, at_v = e[inside.any(axis=1)], v[inside.any(axis=0)]
    assert e_low <= at_e[0]
    assert at_e[-1] <= e_high
    assert v_low <= at_v[0]
    assert at_v[-1] <= v_high


def test_published_form() -> None:
    shape = on_the_vertical(0.6, 6.3)
    for e, v in [(0.0, 0.0), (0.3, -0.1), (-0.6, 0.0), (0.1, 0.5)]:
        assert value(shape, e, v) == pytest.approx(1.0 - e * e / 0.36 - 6.3 * v * v, abs=1e-12)
    assert on_the_vertical(0.6, 0.594631).area_m2ps == pytest.approx(2.444, abs=5e-4)


def test_areas_of_the_known_ellipses() -> None:
    centred = Quadratic(0.0, 0.0, 3.122, 0.365, 0.386)
    free = Quadratic(0.0, -0.88, 3.284, 0.313, 0.194)
    assert centred.area_m2ps == pytest.approx(3.033, rel=3e-3)
    assert free.area_m2ps == pytest.approx(4.286, rel=3e-3)


def test_stopping_distance_is_what_the_brakes_need() -> None:
    """On the upper edge: after the reaction time, full braking comes to rest exactly at the limit."""
    shape = Stopping(-5.0, 0.6, 0.1, 2.0, 3.0)
    for v in (0.2, 1.0, 1.7):
        e = 0.6 - 0.1 * v - v * v / 4.0
        assert value(shape, e, v) == pytest.approx(0.0, abs=1e-12)
        assert e + 0.1 * v + v * v / (2 * 2.0) == pytest.approx(0.6)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Quadratic(0.0, 0.0, 1.0, 2.0, 1.0),
        lambda: Quadratic(0.0, 0.0, -1.0, 0.0, 1.0),
        lambda: Quadratic(0.0, 0.0, math.nan, 0.0, 1.0),
        lambda: Stopping(0.5, -0.5, 0.1, 1.0, 1.0),
        lambda: Stopping(-0.5, 0.5, 0.0, 1.0, 1.0),
    ],
)
def test_what_is_no_barrier_is_refused(make: object) -> None:
    with pytest.raises(InputError):
        make()  # type: ignore[operator]
