"""The published barrier against figures computed independently, closed forms and brute force."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flightstack.barrier.physics import PhysicalPlant, farthest, mu_physics, overshoot_m, state_only
from flightstack.barrier.published import (
    MU_INITIAL,
    Basis,
    accepted,
    certificate,
    constant,
    grid,
    learned,
    least_mu,
    left_side,
    lipschitz,
    of_authority,
    on_the_vertical,
    right_side,
    tip,
    with_mu,
)
from flightstack.barrier.records import Authority, Budget
from flightstack.barrier.shapes import Quadratic
from flightstack.gp import Constant, RecursiveGP, SquaredExponential, affine_in
from flightstack.region import Region
from flightstack.types import InputError

G = 9.81
REGION = Region("ellipsoid", (0.0, 0.0, -0.8), (0.4, 0.4, 0.6), (0.5, 0.5, 0.4))
HEAVY = PhysicalPlant(1.4)
EXACT = constant(G - 1.8 * G / 1.4, G)
HALF = 0.1 / math.sqrt(2.0)
NOTHING_KNOWN = Authority(*(np.zeros(2) for _ in range(7)))


@pytest.mark.parametrize(
    ("plant", "doubt", "mu"),
    [
        (HEAVY, 0.0, 0.594631),
        (PhysicalPlant(1.4, gravity_mps2=9.80665), 0.0, 0.594834),
        (PhysicalPlant(1.4, gravity_mps2=10.0), 0.0, 0.583333),
        (PhysicalPlant(1.4, (0.0, 0.0, 0.1)), 0.0, 0.914817),
        (PhysicalPlant(1.4, (0.0, 0.0, -0.1)), 0.0, 0.440468),
        (PhysicalPlant(1.4, (0.1, 0.0, 0.0)), 0.0, 0.602849),
        (PhysicalPlant(1.4, (0.15, 0.0, 0.0)), 0.0, 0.6137),
        (PhysicalPlant(1.4, (0.0, 0.15, 0.0)), 0.0, 0.6137),
        (PhysicalPlant(1.4, (HALF, 0.0, HALF)), 0.0, 0.7975),
        (HEAVY, 0.05, 0.6054),
        (HEAVY, 0.1, 0.6166),
        (HEAVY, 0.2, 0.6403),
        (HEAVY, 0.3, 0.6659),
        (HEAVY, 0.5, 0.7237),
        (HEAVY, 1.0, 0.9245),
        (PhysicalPlant(1.0), 0.0, 0.2124),
        (state_only(HEAVY), 0.0, 0.4247),
        (PhysicalPlant(1.4, (0.1, 0.0, 0.0), tilt_max_rad=math.radians(11.0)), 0.0, 0.6029),
        (PhysicalPlant(1.4, (0.1, 0.0, 0.0), tilt_max_rad=math.radians(10.0)), 0.0, 0.7127),
        (PhysicalPlant(1.4, (0.1, 0.0, 0.0), tilt_max_rad=math.radians(9.5)), 0.0, 1.3031),
        (PhysicalPlant(1.4, (0.1, 0.0, 0.0), tilt_max_rad=math.radians(9.25)), 0.0, math.inf),
        (PhysicalPlant(1.4, tilt_max_rad=math.radians(11.0)), 0.0, 0.594631),
        (PhysicalPlant(2.0), 0.0, math.inf),
    ],
)
def test_the_least_mu_of_the_table(plant: PhysicalPlant, doubt: float, mu: float) -> None:
    assert mu_physics(plant, REGION, (0.0, 0.0, doubt)) == pytest.approx(mu, abs=1e-4)


def test_on_the_vertical_line_the_least_mu_is_the_closed_form() -> None:
    for north in (0.0, 0.1, 0.15):
        braking = math.hypot(1.8 / 1.4, 0.0) ** 2 - north**2
        expected = 1.0 / (0.6 * (math.sqrt(braking) - 1.0) * G)
        assert mu_physics(PhysicalPlant(1.4, (north, 0.0, 0.0)), REGION, lateral=False) == pytest.approx(
            expected, rel=1e-10
        )


@settings(deadline=None, max_examples=25)
@given(
    st.floats(0.8, 1.6),
    st.tuples(*(st.floats(-0.15, 0.15) for _ in range(3))),
    st.tuples(*(st.floats(0.0, 0.5) for _ in range(3))),
    st.floats(0.2, 1.5),
)
def test_just_above_the_least_mu_thrust_suffices_and_just_below_it_does_not(
    ratio: float, wind: tuple[float, float, float], doubt: tuple[float, float, float], tilt: float
) -> None:
    plant = PhysicalPlant(ratio, wind, tilt_max_rad=tilt)
    mu = mu_physics(plant, REGION, doubt)

    def excess(mu: float) -> float:
        """How far the worst required thrust lies outside ball and cone, over a dense sphere of states."""
        polar, turn = np.meshgrid(np.linspace(0.0, np.pi, 181), np.linspace(0.0, 2.0 * np.pi, 121))
        sphere = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1)
        need = sphere * [0.625, 0.625, 1.0 / (0.6 * mu)] + G * np.add(wind, (0.0, 0.0, 1.0))
        worst = -math.inf
        for corner in np.stack(np.meshgrid(*([-1.0, 1.0],) * 3), axis=-1).reshape(-1, 3):
            t = need + corner * doubt
            ball = np.linalg.norm(t, axis=-1) - plant.thrust_max_mps2
            cone = np.hypot(t[..., 0], t[..., 1]) * math.cos(tilt) - t[..., 2] * math.sin(tilt)
            worst = max(worst, float(np.max(ball)), float(np.max(cone)))
        return worst

    if math.isfinite(mu):
        assert excess(mu) <= 1e-6
        assert excess(0.98 * mu) > 0.0
    else:
        assert excess(1e4) > -2e-3


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4), st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0)))
def test_the_farthest_point_of_an_ellipse(shape: list[float], centre: tuple[float, float]) -> None:
    matrix = np.array(shape).reshape(2, 2)
    angle = np.linspace(0.0, 2.0 * np.pi, 20001)
    points = matrix @ np.stack([np.cos(angle), np.sin(angle)]) + np.array(centre)[:, None]
    found = farthest(matrix, np.array(centre))
    assert found == pytest.approx(float(np.max(np.linalg.norm(points, axis=0))), abs=2e-5)


def test_a_residual_learned_as_of_the_state_alone_claims_too_much_and_overshoots() -> None:
    claimed = mu_physics(state_only(HEAVY), REGION)
    assert claimed == pytest.approx(0.4247, abs=1e-4)
    braking = 1.8 * G / 1.4 - G
    assert overshoot_m(claimed, 0.6, braking) == pytest.approx(0.034, abs=5e-4)
    assert overshoot_m(mu_physics(HEAVY, REGION), 0.6, braking) == pytest.approx(0.0, abs=1e-12)
    e = np.linspace(-0.6, 0.6, 100_001)
    stop = e + (1.0 - (e / 0.6) ** 2) / claimed / (2.0 * braking)
    assert overshoot_m(claimed, 0.6, braking) == pytest.approx(float(stop.max()) - 0.6, abs=1e-9)


@pytest.mark.parametrize(("affine", "mu"), [(True, 0.594631), (False, 0.4247)])
def test_learning_the_gain_of_thrust_gives_what_physics_allows_and_learning_the_state_does_not(
    affine: bool, mu: float
) -> None:
    """Noise-free hover of the 1.4 times heavier vehicle, and for the affine form some thrust about it."""
    columns = (0,)
    kernel = SquaredExponential(100.0, (5.0,), columns=columns)
    full = affine_in(1, kernel, Constant(1.0)) if affine else kernel
    gp = RecursiveGP(full, 1e-4, input_dim=2, output_dim=1, capacity=100)
    for speed in np.linspace(-0.5, 0.5, 7):
        for share in (0.8, 1.0, 1.2) if affine else (1.0,):
            thrust = 1.4 * G * share
            gp.add(np.array([speed, thrust]), np.array([(1.0 - 1.0 / 1.4) * thrust]))

    def acceleration(v: np.ndarray, thrust: float) -> tuple[np.ndarray, np.ndarray]:
        mean, var = gp.predict(np.stack([v, np.full_like(v, thrust)], axis=1))
        return G - thrust + mean[:, 0], np.sqrt(var[:, 0])

    bounds = learned(acceleration, (0.0, 1.8 * G), 0.0, np.linspace(-2.5, 2.5, 51))
    assert least_mu(0.6, 2.0, bounds, 0.05) == pytest.approx(mu, rel=0.01)


@pytest.mark.parametrize("doubt", [0.0, 0.3])
@pytest.mark.parametrize("tau", [0.2, 0.05, 0.02])
def test_the_search_ends_where_physics_does_and_never_below(tau: float, doubt: float) -> None:
    bounds = constant(float(EXACT.braking_mps2[0]) + doubt, G - doubt)
    found = least_mu(0.6, 2.0, bounds, tau)
    allowed = mu_physics(HEAVY, REGION, (0.0, 0.0, doubt))
    assert allowed <= found <= allowed + 1e-5
    barrier = on_the_vertical(0.6, found)
    assert np.all(left_side(barrier, 2.0, bounds, *grid(barrier, 0.1 * tau)) >= -1e-9)


def test_a_plain_grid_would_accept_less_than_physics_allows() -> None:
    mu, tau = 0.58, 0.05
    assert mu < mu_physics(HEAVY, REGION)
    line = tau / math.sqrt(2.0) * np.arange(-60, 61)
    e, v = (each.ravel() for each in np.meshgrid(line, line))
    inside = e**2 / 0.36 + mu * v**2 <= 1.0
    assert np.all(left_side(on_the_vertical(0.6, mu), 2.0, EXACT, e[inside], v[inside]) >= 0.0)
    assert not accepted(0.6, mu, 2.0, EXACT, tau)


def test_the_start_must_be_accepted_and_unknown_speeds_are_not() -> None:
    assert least_mu(0.6, 2.0, constant(-0.2, G), 0.05) == math.inf  # 1 / (0.6 * 0.2) = 8.3 is above the start
    slow = Authority(
        np.array([-0.7, 0.0, 0.7]), *(np.zeros(3),) * 2, np.full(3, -2.8), np.full(3, G), np.zeros(3), np.zeros(3)
    )
    found = least_mu(0.6, 2.0, of_authority(slow), 0.05)
    assert found == pytest.approx(1.0 / 0.7**2, rel=1e-4)  # as fast as the bounds reach, no faster
    assert least_mu(0.6, 2.0, EXACT, 0.05) < MU_INITIAL


@settings(deadline=None, max_examples=50)
@given(st.floats(0.1, 20.0), st.floats(0.01, 10.0), st.floats(0.005, 0.3))
def test_at_the_tips_no_mu_meets_the_right_side(mu: float, gamma: float, tau: float) -> None:
    found = tip(0.6, mu, gamma, EXACT, tau)
    assert math.hypot(found.e_m - 0.6, found.v_mps) <= 0.5 * tau
    assert found.left <= 0.5 * found.right * (1.0 + 1e-12)
    assert found.right == pytest.approx(right_side(on_the_vertical(0.6, mu), gamma, EXACT, tau))


def test_lipschitz_constants_are_the_greatest_gradients_over_the_region() -> None:
    for barrier in (on_the_vertical(0.6, 0.6), Quadratic(0.05, -0.4, 3.3, 0.4, 0.3)):
        e, v = (
            a.reshape(801, 801)
            for a in np.meshgrid(np.linspace(*barrier.box[:2], 801), np.linspace(*barrier.box[2:], 801))
        )
        rate = left_side(barrier, 0.0, EXACT, e, v)
        h = left_side(barrier, 1.0, EXACT, e, v) - rate
        inside = h >= 0.0
        spans = (v[1, 0] - v[0, 0], e[0, 1] - e[0, 0])
        of_h, of_rate = lipschitz(barrier, EXACT)
        for values, most in ((h, of_h), (rate, of_rate)):
            steep = float(np.max(np.hypot(*np.gradient(values, *spans))[inside]))
            assert 0.97 * most <= steep <= most * 1.005


def test_left_side_is_the_worst_rate_of_h_at_the_best_thrust() -> None:
    barrier = Quadratic(0.1, -0.3, 3.0, 0.5, 0.4)
    rng = np.random.default_rng(1)
    e, v = rng.uniform(-0.5, 0.5, 200), rng.uniform(-1.0, 1.0, 200)
    bounds = constant(-2.0, 8.0)
    thrusts = np.linspace(-2.0, 8.0, 101)[:, None]
    de, dv = e - 0.1, v + 0.3
    h = 1.0 - 3.0 * de**2 - 2.0 * 0.5 * de * dv - 0.4 * dv**2
    rate = -2.0 * (3.0 * de + 0.5 * dv) * v - 2.0 * (0.5 * de + 0.4 * dv) * thrusts
    assert left_side(barrier, 2.0, bounds, e, v) == pytest.approx(rate.max(axis=0) + 2.0 * h)


def test_bounds_of_an_authority_hold_between_its_nodes() -> None:
    rng = np.random.default_rng(2)
    v = np.linspace(-2.0, 2.0, 9)
    low, high = -3.0 + rng.uniform(0.0, 0.5, 9), 9.0 - rng.uniform(0.0, 0.5, 9)
    authority = Authority(v, np.zeros(9), np.ones(9), low, high, rng.uniform(0.0, 0.3, 9), rng.uniform(0.0, 0.3, 9))
    bounds = of_authority(authority)
    for speed in rng.uniform(-2.0, 2.0, 200):
        braking, falling = bounds.at(np.array([speed]))
        i = int(np.searchsorted(v, speed))  # what each node says holds up to its neighbours
        assert braking[0] >= max(low[i - 1 : i + 1]) + max(authority.error_low_mps2[i - 1 : i + 1]) - 1e-12
        assert falling[0] <= min(high[i - 1 : i + 1]) - max(authority.error_high_mps2[i - 1 : i + 1]) + 1e-12
    assert np.isnan(bounds.at(np.array([2.1]))[0][0])


def test_the_certificate_says_the_ellipsoid_and_that_it_is_not_robust() -> None:
    region = with_mu(REGION, 0.6)
    basis = Basis(2.0, 2.0, 0.05, (NOTHING_KNOWN,) * 3, Budget.square(0.0, 0.0, 0.0, 0.0), {"kernel": "none"})
    made = certificate(region, basis, 3)
    assert (made.mode, made.version, made.centre_ned_m) == ("as-published", 3, (0.0, 0.0, -0.8))
    assert "not robustly certified" in str(made.knowledge["note"])
    down = made.axes[2].barrier
    assert isinstance(down, Quadratic)
    assert (down.p11, down.p12, down.p22) == pytest.approx((1.0 / 0.36, 0.0, 0.6))


def test_bad_numbers_are_refused_in_words() -> None:
    with pytest.raises(InputError, match="mu"):
        with_mu(REGION, 0.0)
    with pytest.raises(InputError, match="plant"):
        PhysicalPlant(mass_ratio=-1.0)
    with pytest.raises(InputError, match="equal semi-axes"):
        mu_physics(HEAVY, Region("ellipsoid", (0.0, 0.0, 0.0), (0.4, 0.3, 0.6), (0.5, 0.5, 0.4)))
