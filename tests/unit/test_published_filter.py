"""The published filter: its row against finite differences, its answer, and how it lets a sampled vehicle creep out."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measured import measured as measured_at

from flightstack.barrier.published import Basis, certificate, with_mu
from flightstack.barrier.published_filter import LinearConstraint, PublishedFilter, nearest
from flightstack.barrier.records import Authority, AxisCertificate, Budget, Certificate
from flightstack.barrier.shapes import Quadratic, Stopping
from flightstack.frames import quat_from_euler, quat_to_matrix
from flightstack.model import Limits, Model
from flightstack.region import Region
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, Learned, Measurement, changed

G = STANDARD_GRAVITY_MPS2
REGION = with_mu(Region("ellipsoid", (0.0, 0.0, -0.8), (0.4, 0.4, 0.6), (0.5, 0.5, 0.4)), 0.6)
MODEL = Model(1.4, 60.0, 0.0, 0.02, 0.05, 0.0, (0.0, 0.0, 0.0), 0.1, ())
LIMITS = Limits(thrust_max_weights=1.8 / 1.4, thrust_min_weights=0.0)
BRAKING = (1.8 / 1.4 - 1.0) * G
UNKNOWN = Authority(*(np.zeros(2) for _ in range(7)))
BASIS = Basis(2.0, 2.0, 0.05, (UNKNOWN,) * 3, Budget.square(0.0, 0.0, 0.0, 0.0))
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
ORIGIN = np.array([1.0, 2.0, 3.0])


def measured(t_us: int, e: F64, vel: F64, q: F64 = LEVEL) -> Measurement:
    """At e from the region's centre."""
    pos = ORIGIN + np.array(REGION.centre_ned_m) + e
    return measured_at(t_us, pos, vel, q, np.zeros(3), np.zeros(3), np.full(4, np.nan), 0, 0, 0)


def wanted(thrust_n: float) -> Command:
    """With this thrust."""
    return Command(0, thrust_n, MODEL.norm_of(thrust_n), np.array([0.1, 0.2, 0.3]))


def vertical(cross: float, mu: float) -> Certificate:
    """The vertical line alone, |e| <= 0.6."""
    made = certificate(with_mu(REGION, mu), BASIS)
    down = made.axes[2]
    barrier = Quadratic(0.0, 0.0, 1.0 / 0.36 + cross * cross / mu, cross, mu)
    axis = AxisCertificate(2, barrier, down.setting, down.response, UNKNOWN, (), down.cells)
    return Certificate(made.mode, made.centre_ned_m, (axis,), made.budget, 0.05, 2.0)


def test_thrust_has_no_hold_on_the_sides() -> None:
    """Level, sideways out and at no climb: the published row cannot be met, at -1.25 /s, -4.03 /s in 0.1 g."""
    e, vel = np.array([0.283, 0.0, 0.0]), np.array([0.354, 0.0, 0.0])
    made = certificate(REGION, BASIS)
    row = PublishedFilter(MODEL, LIMITS).row(made, ORIGIN, measured(0, e, vel), Learned.nothing())
    assert row.h == pytest.approx(0.0, abs=2e-3)
    assert row.slope == 0.0
    assert row.rest - 2.0 * row.h == pytest.approx(-1.25, abs=5e-3)
    wind = changed(Learned.nothing(), residual_frd_mps2=np.array([0.981, 0.0, 0.0]), sigma_frd_mps2=np.zeros(3))
    row = PublishedFilter(MODEL, LIMITS).row(made, ORIGIN, measured(0, e, vel), wind)
    assert row.rest - 2.0 * row.h == pytest.approx(-4.03, abs=5e-3)
    assert nearest(10.0, row, (0.0, 20.0)) == (10.0, False)


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(-0.3, 0.3), min_size=9, max_size=9), st.floats(0.0, 20.0), st.floats(0.0, 0.5))
def test_the_row_is_the_rate_of_h_under_the_model(numbers: list[float], thrust: float, sigma: float) -> None:
    e, vel, angles = np.array(numbers[:3]), np.array(numbers[3:6]), numbers[6:9]
    q = quat_from_euler(*angles)
    body = quat_to_matrix(q)
    residual = np.array([0.3, -0.2, 0.5])
    drag = np.array([0.2, 0.3, 0.1])
    model = Model(1.4, 60.0, 0.0, 0.02, 0.05, 0.0, (0.2, 0.3, 0.1), 0.1, ())
    learned = changed(Learned.nothing(), residual_frd_mps2=residual, sigma_frd_mps2=np.array([sigma, 0.0, 0.0]))
    row = PublishedFilter(model, LIMITS).row(certificate(REGION, BASIS), ORIGIN, measured(0, e, vel, q), learned)
    force = body @ (np.array([0.0, 0.0, -thrust / 1.4]) + residual - drag / 1.4 * (body.T @ vel))
    acc = np.array([0.0, 0.0, G]) + force
    pos = np.array(REGION.centre_ned_m) + e
    step = 1e-6
    rate = (REGION.value(pos + step * vel, vel + step * acc) - REGION.value(pos - step * vel, vel - step * acc)) / (
        2.0 * step
    )
    by_v = 2.0 * np.abs(vel) / np.square(REGION.semi_axes_mps)
    doubt = float(by_v @ (2.0 * sigma * np.abs(body[:, 0])))
    h = REGION.value(pos, vel)
    assert row.h == pytest.approx(h, abs=1e-12)
    assert row.slope * thrust + row.rest == pytest.approx(rate - doubt + 2.0 * h, abs=1e-6)


@given(st.floats(-5.0, 25.0), st.floats(-3.0, 3.0), st.floats(-20.0, 20.0))
def test_the_answer_is_the_nearest_thrust_that_meets_the_row(want: float, slope: float, rest: float) -> None:
    low, high = 1.0, 18.0
    thrust, feasible = nearest(want, LinearConstraint(slope, rest, 0.0), (low, high))
    assert low <= thrust <= high
    every = np.linspace(low, high, 17001)
    meets = every[slope * every + rest >= 1e-9]
    if len(meets):
        assert feasible
        assert slope * thrust + rest >= -1e-9
        assert abs(thrust - want) <= np.min(np.abs(meets - want)) + 1e-9
    elif max(slope * low, slope * high) + rest < 0.0:
        assert not feasible
        if slope != 0.0:
            assert slope * thrust == pytest.approx(max(slope * low, slope * high))


def test_it_engages_where_h_has_been_high_for_a_while_and_passes_what_is_safe() -> None:
    flt = PublishedFilter(MODEL, LIMITS)
    state = flt.init(ORIGIN)
    here = measured(0, np.zeros(3), np.zeros(3))
    state, command, filtered = flt.step(state, here, wanted(13.0), wanted(13.0), Learned.nothing())
    assert (filtered.status, command.thrust_n) == (0.0, 13.0)
    state = flt.adopt(state, certificate(REGION, BASIS, 7))
    far = np.array([0.0, 0.0, 0.59])
    seen = []
    for k, e in [(0, far), (1, np.zeros(3)), (60, far), (61, np.zeros(3)), (110, np.zeros(3)), (111, np.zeros(3))]:
        at = measured(10_000 * k, e, np.zeros(3))
        state, command, filtered = flt.step(state, at, wanted(13.0), wanted(13.0), Learned.nothing())
        assert command.thrust_n == 13.0
        seen.append(filtered.status)
    assert seen == [1.0, 1.0, 1.0, 1.0, 1.0, 2.0]
    assert (filtered.h, filtered.version, filtered.intervened) == (1.0, 7.0, 0.0)


def test_it_changes_only_the_thrust_and_says_where_it_cannot() -> None:
    flt = PublishedFilter(MODEL, LIMITS)
    state = flt.adopt(flt.init(ORIGIN), certificate(REGION, BASIS))._replace(engaged=True)
    falling = measured(0, np.array([0.0, 0.0, 0.3]), np.array([0.0, 0.0, 0.9]))
    _, command, filtered = flt.step(state, falling, wanted(5.0), wanted(5.0), Learned.nothing())
    assert filtered.status == 3.0
    assert filtered.margin_ps == pytest.approx(0.0, abs=1e-9)
    assert command.thrust_n > 5.0
    assert command.thrust_norm == pytest.approx(MODEL.norm_of(command.thrust_n))
    assert command.rate_frd_radps.tolist() == [0.1, 0.2, 0.3]
    assert filtered.safe_acc_ned_mps2[2] == pytest.approx(G - command.thrust_n / 1.4)
    lost = measured(0, np.array([0.0, 0.0, 0.7]), np.array([0.0, 0.0, 0.9]))
    _, command, filtered = flt.step(state, lost, wanted(5.0), wanted(5.0), Learned.nothing())
    assert (filtered.status, command.thrust_n) == (4.0, pytest.approx(1.8 * G))
    assert filtered.margin_ps < 0.0


def test_what_is_not_a_number_is_left_to_the_guard() -> None:
    flt = PublishedFilter(MODEL, LIMITS)
    state = flt.adopt(flt.init(ORIGIN), certificate(REGION, BASIS))._replace(engaged=True)
    here, lost = (measured(0, np.full(3, e), np.zeros(3)) for e in (0.0, np.nan))
    for at, thrust in ((lost, 5.0), (here, math.nan)):
        _, command, filtered = flt.step(state, at, wanted(thrust), wanted(5.0), Learned.nothing())
        assert filtered.status == 5.0
        assert command.thrust_n == thrust or (math.isnan(command.thrust_n) and math.isnan(thrust))


def fly(made: Certificate, dt_s: float, duration_s: float = 12.0) -> tuple[float, float]:
    """Pushed down for ever, through the filter, on an exact double integrator: max |e|, share of infeasible steps."""
    flt = PublishedFilter(MODEL, LIMITS)
    state = flt.adopt(flt.init(ORIGIN), made)._replace(engaged=True)
    e = v = most = 0.0
    failed = 0
    steps, learned, push = round(duration_s / dt_s), Learned.nothing(), wanted(0.0)
    for _ in range(steps):
        at = measured(0, np.array([0.0, 0.0, e]), np.array([0.0, 0.0, v]))
        state, command, filtered = flt.step(state, at, push, push, learned)
        failed += filtered.status == 4.0
        a = G - command.thrust_n / MODEL.mass_kg
        if a < 0.0 < v < -a * dt_s:  # it turns within the step
            most = max(most, e + v * v / (-2.0 * a))
        e, v = e + v * dt_s + 0.5 * a * dt_s * dt_s, v + a * dt_s
        most = max(most, abs(e))
    return most, failed / steps


@pytest.mark.parametrize(("dt_s", "published"), [(0.0005, 0.621), (0.004, 0.695), (0.010, 0.838), (0.020, 1.08)])
def test_sampled_and_with_an_exact_model_it_creeps_out(dt_s: float, published: float) -> None:
    most, infeasible = fly(vertical(0.0, 0.6), dt_s)
    assert most > 0.6
    assert 0.5 <= (most - 0.6) / (published - 0.6) <= 2.0  # the order; the rest depends on the adversary
    assert most - 0.6 <= 0.5 * G * dt_s * 12.0  # no faster than g dt / 2
    assert infeasible > 0.5


@pytest.mark.parametrize("dt_s", [0.004, 0.010, 0.020])
def test_the_same_row_with_a_cross_term_holds(dt_s: float) -> None:
    most, infeasible = fly(vertical(0.617, 0.6), dt_s)
    assert most == pytest.approx(0.538, abs=0.005)
    assert infeasible == 0.0


def test_what_is_no_quadratic_is_not_adopted() -> None:
    made = vertical(0.0, 0.6)
    axis = made.axes[0]
    other = AxisCertificate(2, Stopping(-0.6, 0.6, 0.1, 2.0, 2.0), axis.setting, axis.response, UNKNOWN, (), axis.cells)
    flt = PublishedFilter(MODEL, LIMITS)
    state = flt.init(ORIGIN)
    assert flt.adopt(state, Certificate(made.mode, made.centre_ned_m, (other,), made.budget, 0.05, 2.0)) is state
    assert math.isnan(
        flt.step(state, measured(0, np.zeros(3), np.zeros(3)), wanted(1.0), wanted(1.0), Learned.nothing())[2].h
    )
