"""The design: against the known largest ellipses, the exact kernel, and areas counted on a grid."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from barriers import PAPER, changing, constant, cross_term, h, in_kernel

from flightstack.barrier import viability
from flightstack.barrier.condition import Setting
from flightstack.barrier.cover import cover
from flightstack.barrier.design import (
    RegionDesign,
    SafeSet,
    at_level,
    at_speed,
    grow,
    largest,
    slice_area,
    worst_slice_area,
)  # fmt: skip
from flightstack.barrier.design_search import sized
from flightstack.barrier.published import on_the_vertical
from flightstack.barrier.records import Response
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping

STRIP = SafeSet(0.6)
AT_ONCE = Response(0.0, 0.0, 0.0)
LATE = Response(0.05, 0.0, 0.02)
"""Rotor lag 50 ms, delay 20 ms."""
MARGINS = Setting(2.0, 0.02, 0.1, 0.004)
ERRORS = (0.1, 0.15)


def _barrier(design: RegionDesign) -> Barrier:
    assert design.barrier is not None
    assert design.cover is not None
    assert design.cover.closed
    return design.barrier


@pytest.mark.parametrize(
    ("family", "rate_ps", "area"),
    [("centred", 0.0, 3.033), ("quadratic", 0.0, 4.286), ("centred", 0.5, 2.780), ("quadratic", 0.5, 3.983)],
)
def test_known_largest_ellipses(family: str, rate_ps: float, area: float) -> None:
    """Without hold, lag and doubt; h must rise by `rate_ps` on the boundary, and gamma is large inside."""
    barrier = _barrier(largest(STRIP, Setting(10.0, 0.0, rate_ps, 0.0), constant(*PAPER), AT_ONCE, family=family))
    assert 0.995 * area <= barrier.area_m2ps <= 1.001 * area


def test_published_form_has_no_certifiable_size() -> None:
    assert largest(STRIP, Setting(2.0, 0.0, 0.0, 0.0), constant(*PAPER), AT_ONCE, family="mu").barrier is None


def test_stopping_shapes_come_close_to_the_kernel_without_margins() -> None:
    kernel = viability.area(-0.6, 0.6, *PAPER)
    found = largest(STRIP, Setting(2.0, 0.0, 0.0, 0.0), constant(*PAPER), AT_ONCE, family="stopping")
    assert 0.98 * kernel <= _barrier(found).area_m2ps <= kernel


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize(("family", "share"), [("quadratic", 0.68), ("stopping", 0.80)])
def test_share_of_the_kernel_of_the_same_reduced_system(error: float, family: str, share: float) -> None:
    """The kernel pays for the error alone; hold, doubt about h and rate margin are the certificate's own."""
    kernel = viability.area(-0.6, 0.6, PAPER[0] + error, PAPER[1] - error)
    barrier = _barrier(largest(STRIP, MARGINS, constant(*PAPER, error), LATE, family=family))
    assert share * kernel <= barrier.area_m2ps <= kernel
    e_low, e_high, v_low, v_high = barrier.box
    for e, v in np.random.default_rng(1).uniform((e_low, v_low), (e_high, v_high), (3000, 2)):
        if h(barrier, e, v) >= 0.0:
            assert in_kernel(e, v, -0.6, 0.6, PAPER[0] + error, PAPER[1] - error)


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("family", ["quadratic", "stopping"])
def test_area_on_the_slice_of_zero_acceleration(error: float, family: str) -> None:
    barrier = _barrier(largest(STRIP, MARGINS, constant(*PAPER, error), LATE, family=family))
    assert slice_area(barrier, LATE) >= 2.8
    assert worst_slice_area(barrier, LATE, *PAPER) >= 2.8


@pytest.mark.parametrize("family", ["quadratic", "centred", "stopping"])
@pytest.mark.parametrize("safe", [STRIP, SafeSet(0.6, 1.5)])
def test_region_lies_in_the_safe_set(family: str, safe: SafeSet) -> None:
    barrier = _barrier(largest(safe, MARGINS, changing(), LATE, family=family))
    e_low, e_high, v_low, v_high = barrier.box
    e, v = np.meshgrid(np.linspace(e_low, e_high, 801), np.linspace(v_low, v_high, 801))
    inside = h(barrier, e, v) >= 0.0
    far = (e / safe.limit_m) ** 2 + (0.0 if safe.limit_mps is None else (v / safe.limit_mps) ** 2)
    assert far[inside].max() <= 1.0 + 1e-9
    assert safe.holds(barrier)


def test_safe_set_against_the_farthest_point_of_a_grid() -> None:
    """Shapes at random: what `holds` says and what a fine grid say differ only at the edge."""
    rng = np.random.default_rng(2)
    seen = set()
    for _ in range(300):
        if rng.random() < 0.5:
            half_e, half_v, r = rng.uniform(0.2, 0.6), rng.uniform(0.3, 1.5), rng.uniform(-0.9, 0.9)
            inverse = np.linalg.inv([[half_e**2, r * half_e * half_v], [r * half_e * half_v, half_v**2]])
            shape: Barrier = Quadratic(
                rng.uniform(-0.1, 0.1), rng.uniform(-0.3, 0.3), inverse[0, 0], inverse[0, 1], inverse[1, 1]
            )
        else:
            shape = Stopping(
                -rng.uniform(0.2, 0.5), rng.uniform(0.2, 0.5), *rng.uniform((0.02, 0.3, 0.3), (0.3, 3.0, 3.0))
            )
        e_low, e_high, v_low, v_high = shape.box
        v, share = np.linspace(v_low, v_high, 301), np.linspace(0.0, 1.0, 301)
        e, v = np.meshgrid(e_low + (e_high - e_low) * share, v)
        inside = h(shape, e, v) >= 0.0
        far = ((e / 0.6) ** 2 + (v / 1.5) ** 2)[inside].max()
        held = SafeSet(0.6, 1.5).holds(shape)
        seen.add(held)
        if held:
            assert far <= 1.0 + 1e-9
        else:
            assert far >= 0.97
    assert seen == {True, False}


@pytest.mark.parametrize("shape", [Quadratic(0.0, -0.88, 3.284, 0.313, 0.194), Stopping(-0.58, 0.59, 0.06, 2.6, 9.0)])
@pytest.mark.parametrize(("a", "under_way"), [(0.0, 0.0), (-2.8, 9.8), (9.8, 9.8)])
def test_slice_area_against_a_count(shape: Barrier, a: float, under_way: float) -> None:
    """z by steps of the response itself: low pass and then the delay, integrated in small steps."""
    e_low, e_high, v_low, v_high = shape.box
    p, v = np.meshgrid(np.linspace(e_low, e_high, 601), np.linspace(v_low, v_high, 601))
    e_z, v_z = p + LATE.c1_s * v, v + LATE.c1_s * a
    step = LATE.delay_s / 50
    for _ in range(50):
        e_z, v_z = e_z + step * (v_z + 0.5 * step * under_way), v_z + step * under_way
    inside = (h(shape, p, v) >= 0.0) & (h(shape, e_z, v_z) >= 0.0)
    counted = inside.sum() * (e_high - e_low) * (v_high - v_low) / 600**2
    assert slice_area(shape, LATE, a, under_way) == pytest.approx(counted, rel=4e-3)


def test_worst_slice_is_at_a_corner() -> None:
    shape = Quadratic(0.0, -0.88, 3.284, 0.313, 0.194)
    areas = [slice_area(shape, LATE, a, w) for a in np.linspace(*PAPER, 9) for w in np.linspace(*PAPER, 9)]
    assert worst_slice_area(shape, LATE, *PAPER) == pytest.approx(min(areas), abs=1e-12)
    assert slice_area(shape, AT_ONCE) == pytest.approx(shape.area_m2ps, rel=1e-6)


@pytest.mark.parametrize("change", [at_level, at_speed])
@pytest.mark.parametrize("shape", [cross_term(2.0, 1.0), Stopping(-0.4, 0.4, 0.1, 2.0, 5.0)])
def test_growth_stops_where_the_next_size_fails(change: object, shape: Barrier) -> None:
    """Within 2 % of the largest size that closes, by trying sizes one after the other."""
    authority, sizes = constant(*PAPER, 0.1), np.geomspace(0.3, 4.0, 261)
    grown = _barrier(grow(shape, STRIP, MARGINS, authority, change=change))  # type: ignore[arg-type]
    made = [change(shape, size) for size in sizes]  # type: ignore[operator]
    closing = [b.area_m2ps for b in made if STRIP.holds(b) and cover(b, MARGINS, authority).closed]
    assert 0.98 * max(closing) <= grown.area_m2ps <= 1.02 * max(closing)


@pytest.mark.parametrize("change", [at_level, at_speed])
@pytest.mark.parametrize("shape", [Quadratic(0.1, -0.9, 3.4, 0.37, 0.225), Stopping(-0.3, 0.4, 0.1, 2.0, 5.0)])
def test_compiled_sizes_are_the_shapes_own(change: Callable[[Barrier, float], Barrier], shape: Barrier) -> None:
    for size in (0.013, 0.85, 1.0, 3.7):
        found = sized(shape.rows, change is at_speed, size, np.empty_like(shape.rows))
        np.testing.assert_array_equal(found, change(shape, size).rows)


def test_growth_with_knowledge() -> None:
    """Less doubt, larger region; too much of it, none."""
    shape, margins = cross_term(2.0, 1.0), MARGINS._replace(off_m=0.005, off_mps=0.01)
    areas = []
    for error in (0.8, 0.4, 0.2, 0.1, 0.0):
        areas.append(_barrier(grow(shape, STRIP, margins, constant(*PAPER, error), change=at_speed)).area_m2ps)
    assert areas == sorted(areas)
    assert areas[-1] > 1.1 * areas[0]
    assert grow(shape, STRIP, margins, constant(*PAPER, 2.79), change=at_speed).barrier is None


def test_a_shape_too_wide_at_any_speed_does_not_grow() -> None:
    wide = Stopping(-0.585, 0.61, 0.06, 2.5, 9.0)
    assert grow(wide, STRIP, MARGINS, constant(*PAPER), change=at_speed) == RegionDesign(None, None)


def test_sizes_are_what_they_say() -> None:
    shape = on_the_vertical(0.6, 6.3)
    faster = at_speed(shape, 2.0)
    assert isinstance(faster, Quadratic)
    assert faster.p22 == pytest.approx(6.3 / 4.0)
    assert faster.box[:2] == pytest.approx((-0.6, 0.6))
    wider = at_level(shape, 4.0)
    assert wider.box == pytest.approx(tuple(2.0 * x for x in shape.box))
    stop = Stopping(-0.4, 0.4, 0.1, 2.0, 5.0)
    quick = at_speed(stop, 1.5)
    for e, v in [(0.1, 0.6), (-0.3, -1.2), (0.39, -0.15)]:
        assert float(h(quick, np.array(e), np.array(1.5 * v))) == pytest.approx(
            float(h(stop, np.array(e), np.array(v)))
        )


def test_nothing_without_authority() -> None:
    found = largest(STRIP, MARGINS, constant(-0.05, 9.81, 0.1), LATE, family="quadratic")
    assert found == RegionDesign(None, None)
    assert largest(STRIP, MARGINS, constant(math.nan, 9.81), LATE, family="stopping") == RegionDesign(None, None)


def test_same_input_same_design() -> None:
    one, two = (largest(STRIP, MARGINS, changing(), LATE, family="quadratic") for _ in range(2))
    assert one.barrier == two.barrier
    assert one.cover is not None
    assert two.cover is not None
    assert one.cover.cells.tobytes() == two.cover.cells.tobytes()
