"""Where the exploration flies and when it ends, against brute force and kinematics."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from axis_certificates import axis_of, certificate_of
from scipy.integrate import cumulative_simpson
from scipy.optimize import brentq, minimize_scalar

from flightstack import arcs, targets
from flightstack.barrier.condition import coefficients, margin_at
from flightstack.barrier.design import at_speed
from flightstack.barrier.records import AxisCertificate, reach_between
from flightstack.barrier.shapes import Barrier, Quadratic, Stopping, gradient, value
from flightstack.cli.compiled import CERTIFY, compile_part
from flightstack.explore import FALSIFIED, ExploreConfig, Explorer, ExploreState
from flightstack.targets import TargetSearch, boundary, limits, reachable, transit
from flightstack.trajectory import Polynomial
from flightstack.types import F64
from tests.thorough import THOROUGH, thorough

STOPPING = Stopping(-0.5, 0.5, 0.2, 1.2, 3.0)
ELLIPSE = Quadratic(0.0, -0.1, 3.4, 0.5, 1.5)
CENTRE = np.array([0.3, -0.2, -0.8])


def worst_q(axis: AxisCertificate, e: float, v: float, u: float) -> float:
    """The condition's least margin over the pieces, at a given command."""
    reach = axis.authority.reach(v)
    return min(margin_at(coefficients(row, e, v, axis.setting, reach), u) for row in axis.barrier.rows)


# ------------------------------------------------------------------ arcs


@pytest.mark.parametrize("speed", [0.8, -1.1])
@pytest.mark.parametrize(("up", "down", "turn"), [(1.0, 2.5, 0.2), (3.0, 0.6, 0.5)])
def test_an_arc_goes_from_rest_to_rest_through_the_state_it_was_asked_for(
    speed: float, up: float, down: float, turn: float
) -> None:
    good, arc = arcs.fly_through(0.1, speed, up, down, 0.05, turn)
    assert good
    t = np.linspace(0.0, arcs.duration_s(arc), 40_001)
    p, v, a = np.array([arcs.at(arc, float(x)) for x in t]).T
    assert v[[0, -1]] == pytest.approx(0.0, abs=1e-9)
    assert a[[0, -1]] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(cumulative_simpson(a, x=t, initial=0.0), v, atol=1e-7)
    np.testing.assert_allclose(cumulative_simpson(v, x=t, initial=0.0), p - p[0], atol=1e-7)
    fastest = int(np.argmax(np.abs(v)))
    assert (p[fastest], v[fastest]) == pytest.approx((0.1, speed), abs=1e-4)
    assert arcs.peak(arc) == pytest.approx((0.1, speed), abs=1e-6)
    way = math.copysign(1.0, speed)
    assert ((way * a).max(), (way * a).min()) == pytest.approx((up, -down), abs=1e-9)


def test_an_arc_too_slow_for_its_ramps_is_none() -> None:
    assert not arcs.fly_through(0.0, 0.05, 3.0, 3.0, 0.2, 0.2)[0]


def _states(path: Polynomial, axis: int, count: int = 2001) -> F64:
    points = [path.at(float(t)) for t in np.linspace(0.0, path.duration_s, count)]
    return np.array([[p.pos_ned_m[axis], p.vel_ned_mps[axis], p.acc_ned_mps2[axis]] for p in points])


def test_arcs_become_a_path_that_is_smooth_up_to_snap_and_moves_on_one_axis_only() -> None:
    _, arc = arcs.fly_through(0.05, 0.7, 1.5, 2.0, 0.2, 0.3)
    end = arcs.at(arc, arcs.duration_s(arc))[0]
    path = arcs.path([arcs.at_rest(float(arc[0, 4]), 0.2), arc, arcs.at_rest(end, 0.4)], 2, CENTRE, 0.3)
    assert path.duration_s == pytest.approx(0.6 + arcs.duration_s(arc))
    for knot in path.knots_s[1:-1]:
        before, after = path.at(float(knot) - 1e-9), path.at(float(knot) + 1e-9)
        np.testing.assert_allclose(before.row[:17], after.row[:17], atol=2e-5)
    for t in np.linspace(0.0, path.duration_s, 50):
        point = path.at(float(t))
        assert point.pos_ned_m[:2] == pytest.approx(CENTRE[:2])
        assert point.pos_ned_m[2] - CENTRE[2] == pytest.approx(arcs.at(arc, float(t) - 0.2)[0])
        assert point.yaw_rad == pytest.approx(0.3)


# ------------------------------------------------------------------ targets


def _best_q(axis: AxisCertificate, e: float, v: float) -> float:
    """The margin of the best command, by SciPy; the least over the pieces is concave in the command."""
    reach = axis.authority.reach(v)
    ends = (reach.u_low, reach.u_high)
    best = minimize_scalar(lambda u: -worst_q(axis, e, v, u), bounds=ends, method="bounded")
    return max(-float(best.fun), *(worst_q(axis, e, v, u) for u in ends))


def _edge(barrier: Barrier, e0: float, v0: float, de: float, dv: float) -> float:
    """How many times (de, dv) the boundary is away."""
    return float(brentq(lambda s: value(barrier, e0 + s * de, v0 + s * dv), 0.0, 1.5))


@pytest.mark.parametrize("barrier", [STOPPING, ELLIPSE])
def test_the_first_limit_is_the_worst_state_of_a_boundary_ten_times_finer(barrier: Barrier) -> None:
    axis, search = axis_of(barrier), TargetSearch()
    candidate = at_speed(barrier, search.grow)
    candidate_axis = axis_of(candidate)
    first = limits(axis, search)[0]
    e_low, e_high, v_low, v_high = candidate.box
    found = []
    for angle in np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False):
        de, dv = 0.5 * (e_high - e_low) * math.cos(angle), 0.5 * (v_high - v_low) * math.sin(angle)
        middle = 0.5 * (e_low + e_high), 0.5 * (v_low + v_high)
        share = _edge(candidate, *middle, de, dv)
        e, v = middle[0] + share * de, middle[1] + share * dv
        reach = axis.authority.reach(v)
        q = _best_q(candidate_axis, e, v)
        slope = gradient(candidate, e, v)[1]
        if abs(v) > search.moving * max(-v_low, v_high):
            found.append(abs(slope) * (reach.error_low if slope < 0.0 else reach.error_high) - q)
    assert first.score_ps == pytest.approx(max(found), rel=0.05, abs=0.05)
    assert first.score_ps <= max(found) + 0.05
    assert value(candidate, first.e_m, first.v_mps) == pytest.approx(0.0, abs=1e-6)


def _passes(axis: AxisCertificate, arc: F64, keep_h: float, count: int = 601) -> bool:
    """Brute force: every state keeps h, its acceleration meets the condition and is at hand."""
    for t in np.linspace(0.0, arcs.duration_s(arc), count):
        e, v, a = arcs.at(arc, float(t))
        reach = axis.authority.reach(v)
        if value(axis.barrier, e, v) < keep_h or not reach.u_low <= a <= reach.u_high or worst_q(axis, e, v, a) < 0.0:
            return False
    return True


@pytest.mark.parametrize("barrier", [STOPPING, thorough(ELLIPSE)])
def test_the_arc_is_the_first_in_order_that_the_filter_would_let_pass(barrier: Barrier) -> None:
    axis, search = axis_of(barrier), TargetSearch(shares=(0.9, 0.4, 0.15), ramp_s=(0.3, 0.2))
    limit = limits(axis, search)[0]
    arc = reachable(axis, limit, search)
    assert arc is not None
    assert _passes(axis, arc, search.keep_h - 2e-3)
    speed, ramp = abs(arcs.peak(arc)[1]), search.ramp_s[1]
    reach = [axis.authority.reach(float(s) * limit.v_mps) for s in np.linspace(0.0, 1.0, 9)]
    low, high = max(r.u_low + r.error_low for r in reach), min(r.u_high - r.error_high for r in reach)
    push, brake = (min(high, 3.0), -low) if limit.v_mps > 0.0 else (min(-low, 3.0), high)
    e_low, e_high, _, _ = barrier.box
    for k, place in product(range(15), np.linspace(e_low, e_high, 13 if THOROUGH else 9)[1:-1]):
        v = limit.v_mps * (1.0 - 0.06 * k)
        if abs(v) <= speed * 1.001:
            continue  # only faster ones come before it
        for b, p, turn in product(search.shares, search.shares, range(1, 5)):
            # The shares are of what is at hand up to this speed: with a bound that grows with speed at least these.
            good, other = arcs.fly_through(float(place), v, p * push, b * brake, ramp, ramp * turn)
            assert not (good and _passes(axis, other, search.keep_h + 2e-3)), (place, v, b, p, turn)


def test_the_way_to_the_start_of_an_arc_is_calm_and_inside() -> None:
    axis, search = axis_of(STOPPING), TargetSearch()
    way = transit(axis, -0.35, 0.3, search)
    assert way is not None
    assert arcs.at(way, 0.0) == pytest.approx((-0.35, 0.0, 0.0))
    assert arcs.at(way, arcs.duration_s(way)) == pytest.approx((0.3, 0.0, 0.0), abs=1e-12)
    assert _passes(axis, way, search.keep_h - 2e-3)
    assert transit(axis, 0.0, 0.49, search) is None  # ends closer to the limit than an arc may come


# ------------------------------------------------------------------ rounds


def _begun(explorer: Explorer) -> ExploreState:
    """The identification has been flown."""
    return replace(explorer.init(10.0, CENTRE), identified=explorer.config.identify_first, next_s=15.0)


def _at_rest() -> Polynomial:
    return arcs.path([arcs.at_rest(0.0, 1.0)], 2, CENTRE, 0.0)


def test_the_identification_moves_inside_the_conservative_region_until_something_is_certified() -> None:
    """h_mu with mu = 6.3 and the paper's lateral semi-axes, at every state of every leg; it begins and ends at rest."""
    explorer = Explorer()
    state, t, reference = explorer.init(10.0, CENTRE), 10.0, _at_rest().at(0.0)
    legs = 0
    while True:
        state, leg = explorer.step(state, t, None, reference)
        if leg is None:
            break
        legs += 1
        np.testing.assert_allclose(leg.at(0.0).row, reference.row, atol=1e-9)
        for time in np.linspace(0.0, leg.duration_s, 400):
            point = leg.at(float(time))
            e, v = point.pos_ned_m - CENTRE, point.vel_ned_mps
            lateral = (e[0] ** 2 + e[1] ** 2) / 0.16 + (v[0] ** 2 + v[1] ** 2) / 0.25
            assert 1.0 - lateral - e[2] ** 2 / 0.36 - 6.3 * v[2] ** 2 > 0.1
        assert explorer.step(state, state.next_s - 0.01, None, reference)[1] is None  # nothing changes under way
        t, reference = state.next_s, leg.at(leg.duration_s)
    assert legs == len(explorer.config.identify_at)
    assert state.failed
    assert "could be certified" in state.ended


def test_a_certificate_ends_the_identification_once_every_axis_was_leaned_along() -> None:
    explorer, certificate = Explorer(), certificate_of(axis_of(STOPPING))
    state, reference, moved = explorer.init(10.0, CENTRE), _at_rest().at(0.0), []
    for number in range(3):
        state, leg = explorer.step(state, state.next_s, certificate, reference)
        assert leg is not None
        assert leg.duration_s >= 4.0
        assert state.identified == number + 1
        assert not state.rounds
        moved.append(int(np.argmax([np.ptp(_states(leg, axis)[:, 0]) for axis in range(3)])))
        reference = leg.at(leg.duration_s)
    assert moved == [2, 0, 1]
    state, leg = explorer.step(state, state.next_s, certificate, reference)
    assert leg is not None
    assert state.identified == 3
    assert len(state.rounds) == 1


def test_legs_follow_one_another_without_a_step_and_stay_inside() -> None:
    explorer, axis = Explorer(ExploreConfig(rounds_max=60)), axis_of(STOPPING)
    state, t, reference = _begun(explorer), 15.0, _at_rest().at(0.0)
    flown = 0
    while not state.ended:
        state, leg = explorer.step(state, t, certificate_of(axis), reference)
        if leg is None:
            break
        flown += 1
        np.testing.assert_allclose(leg.at(0.0).row, reference.row, atol=1e-9)
        for e, v, a in _states(leg, 2, 126 if THOROUGH else 13) - [CENTRE[2], 0.0, 0.0]:
            assert value(axis.barrier, e, v) >= 0.098
            assert worst_q(axis, e, v, a) >= -0.05
        assert state.next_s == pytest.approx(t + leg.duration_s)
        t, reference = state.next_s, leg.at(leg.duration_s)
    assert flown >= 2
    assert state.rounds[0].target is not None
    # Nothing became better: no speed is flown more often than `repeats` allows, and it ends by itself.
    assert "nothing is left" in state.ended
    assert not state.failed


def _fly(explorer: Explorer, areas: list[float], error: float) -> tuple[ExploreState, int]:
    """Rounds with regions that grow as given; how many legs were flown."""
    state, t, reference, legs = _begun(explorer), 15.0, _at_rest().at(0.0), 0
    for version, area in enumerate(areas):
        axis = axis_of(at_speed(STOPPING, area), error_mps2=error * 0.85**version, slope_ps=0.0)
        state, leg = explorer.step(state, t, certificate_of(axis, version=version), reference)
        if leg is None:
            break
        legs += 1
        t, reference = state.next_s, leg.at(leg.duration_s)
    return state, legs


def test_it_stops_when_the_bound_is_narrow_and_some_rounds_brought_no_growth() -> None:
    state, legs = _fly(Explorer(ExploreConfig(axes=(2,), calm_rounds=3)), [0.9, 0.95, 1.0, 1.0, 1.0, 1.0, 1.0], 0.2)
    assert legs == 5  # growth at the 1st, 2nd and 3rd look, none at the 4th, 5th and 6th
    assert "brought no growth" in state.ended
    assert [row.version for row in state.rounds] == [0, 1, 2, 3, 4, 5]


def test_growth_starts_the_count_anew_and_a_wide_bound_goes_on() -> None:
    state, legs = _fly(Explorer(ExploreConfig(axes=(2,), calm_rounds=2)), [0.9, 0.9, 1.0, 1.0, 1.0], 0.2)
    assert legs == 4
    assert "brought no growth" in state.ended
    state, legs = _fly(Explorer(ExploreConfig(axes=(2,), calm_rounds=2, epsilon_mps2=0.05)), [1.0] * 5, 0.2)
    assert legs == 5
    assert not state.ended


def test_it_stops_after_the_most_rounds() -> None:
    state, legs = _fly(Explorer(ExploreConfig(axes=(2,), rounds_max=2)), [0.8, 0.9, 1.0, 1.1], 0.4)
    assert legs == 2
    assert "2 rounds were flown" in state.ended


def test_after_the_vertical_axis_the_lateral_ones_are_flown() -> None:
    explorer = Explorer(ExploreConfig(rounds_max=1))
    lateral = axis_of(Stopping(-0.3, 0.3, 0.3, 0.9, 0.9), axis=0, u_mps2=(-2.0, 2.0))
    certificate = certificate_of(axis_of(STOPPING), lateral)
    state, leg = explorer.step(_begun(explorer), 15.0, certificate, _at_rest().at(0.0))
    assert leg is not None
    state, leg = explorer.step(state, state.next_s, certificate, leg.at(leg.duration_s))
    assert [row.axis for row in state.rounds] == [2, 2, 0]
    assert leg is not None
    assert np.ptp(_states(leg, 0)[:, 0]) > 0.05
    assert np.ptp(_states(leg, 2)[:, 0]) < 1e-9


def test_another_axis_is_flown_from_where_the_vehicle_rests() -> None:
    explorer = Explorer(ExploreConfig(rounds_max=1))
    lateral = axis_of(Stopping(-0.3, 0.3, 0.3, 0.9, 0.9), axis=0, u_mps2=(-2.0, 2.0))
    certificate = certificate_of(axis_of(STOPPING), lateral)
    state, first = explorer.step(_begun(explorer), 15.0, certificate, _at_rest().at(0.0))
    assert first is not None
    rest = first.at(first.duration_s)
    _, second = explorer.step(state, state.next_s, certificate, rest)
    assert second is not None
    np.testing.assert_allclose(second.at(0.0).row, rest.row, atol=1e-9)


def test_what_an_exploration_calls_is_compiled_ahead() -> None:
    """`warmup certify`; it was 27 s in the middle of the flight."""
    compile_part(CERTIFY)
    called = (arcs.fly_through, arcs.from_rest, arcs.at, targets._first, targets.admissible, reach_between)
    ahead = [list(function.signatures) for function in called]
    assert all(ahead)
    assert _fly(Explorer(), [0.9, 0.95], 0.2)[1] == 2
    assert [list(function.signatures) for function in called] == ahead


def test_a_falsified_bound_ends_it_at_once() -> None:
    explorer = Explorer()
    certificate = certificate_of(axis_of(STOPPING), **{FALSIFIED: "seen"})
    state, leg = explorer.step(_begun(explorer), 11.0, certificate, _at_rest().at(0.0))
    assert leg is None
    assert state.failed
    assert "beyond its bound" in state.ended


def test_the_same_flight_is_planned_twice() -> None:
    first, second = (_fly(Explorer(), [0.9, 0.95, 1.0], 0.2)[0] for _ in range(2))
    assert first.rounds == second.rounds


def test_boundary_points_lie_on_the_boundary() -> None:
    for e, v in boundary(STOPPING, 24):
        assert value(STOPPING, e, v) == pytest.approx(0.0, abs=1e-9)
