"""What the paper's formulas are worth: derived anew here, or against figures computed independently."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import erf
from shipped import load_scenario

from flightstack.barrier.published import constant
from flightstack.barrier.sampling import Claim, ClaimSamples, crossed
from flightstack.frames import quat_from_euler, quat_to_matrix
from flightstack_paper import theory
from flightstack_paper.exact import ExactPolynomial
from flightstack_paper.example import level_set_area, solved_area
from flightstack_paper.exploration import density
from flightstack_paper.rows_example import _NAMES

G = 9.81


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    return theory.measure()


def test_the_printed_bordered_inverse_is_none_and_the_corrected_one_is() -> None:
    """One kept point and one added: M = [[a, k], [k, c]], whose inverse everybody knows."""
    a, k, c = 1.3, 0.7, 1.1
    inverse = np.array([[c, -k], [-k, a]]) / (a * c - k * k)
    s = c - k * k / a
    corrected = np.array([[1 / a + k * k / (a * a * s), -k / (a * s)], [-k / (a * s), 1 / s]])
    printed = np.array([[1 / a + k * k / (a * a * s), k / (a * s)], [-k / (a * s), s]])
    np.testing.assert_allclose(corrected, inverse, rtol=1e-12)
    assert np.abs(np.array([[a, k], [k, c]]) @ printed - np.eye(2)).max() > 0.1
    many = theory.block_inverse()
    assert many["printed"] > 10.0
    assert many["right"] < 1e-9


def test_mu_and_what_it_leaves_are_the_known_ones(found: dict[str, Any]) -> None:
    mu = found["mu"]
    assert mu["exact"] == pytest.approx((0.6 / 0.36) / ((1.8 / 1.4 - 1.0) * G), rel=1e-9)
    expected = {"wind_north": 0.602849, "wind_down": 0.914817, "wind_up": 0.440468, "state_only": 0.4247}
    for name, value in expected.items():
        assert mu[name] == pytest.approx(value, abs=1e-4)
    assert mu["slack_mps2"] == pytest.approx(0.0251, abs=1e-4)
    assert mu["state_only_overshoot_m"] == pytest.approx(0.034, abs=5e-4)


def test_the_five_term_barrier_falls_whatever_thrust_does(found: dict[str, Any]) -> None:
    """h = 1 - x^2/0.16 - vx^2/0.25 there: hdot = -2 x vx / 0.16 - 2 vx ax / 0.25, thrust has no part in it."""
    five, x, v = found["five_terms"], 0.283, 0.354
    assert five["slope"] == 0.0
    assert five["rate_ps"] == pytest.approx(-2.0 * x * v / 0.16, rel=1e-9)
    assert five["rate_wind_ps"] == pytest.approx(-2.0 * x * v / 0.16 - 2.0 * v * 0.1 * G / 0.25, rel=1e-9)


def test_sampled_it_creeps_out_and_with_a_cross_term_it_does_not(found: dict[str, Any]) -> None:
    sampled = found["sampled"]
    printed = (0.621, 0.695, 0.838, 1.08)  # other adversaries, same order
    for most, other, period_s in zip(sampled["published"]["most_m"], printed, sampled["periods_s"], strict=True):
        assert 0.5 <= (most - 0.6) / (other - 0.6) <= 2.0
        assert most - 0.6 <= 0.5 * G * period_s * 12.0
    assert min(sampled["published"]["infeasible"]) > 0.5
    assert sampled["cross"]["most_m"] == pytest.approx([0.538] * 4, abs=0.005)
    assert sampled["cross"]["infeasible"] == [0.0] * 4


def test_no_sampling_closes_over_the_published_barrier(found: dict[str, Any]) -> None:
    assert 0.0 < found["lemma"]["greatest_share"] <= 0.5
    assert all(4 <= count <= 40 for count in found["cover"]["open"].values())
    assert found["cover"]["strict_open"] == 0
    assert found["cover"]["strict_margin_ps"] == pytest.approx(1.29, abs=0.02)


def test_confidence_of_six_outputs_at_once(found: dict[str, Any]) -> None:
    for k in (2, 3):
        assert found["joint"][str(k)] == pytest.approx(erf(k / math.sqrt(2.0)) ** 6, rel=1e-12)
    assert found["joint"]["2"] == pytest.approx(0.756, abs=1e-3)


def test_the_printed_areas_follow_from_the_digits_alone() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-2.0, 2.0, (2, 1_000_000))
    inside = {
        "lyapunov": 1.343 * x**2 + 0.5155 * x * y + 1.152 * y**2 <= 1.0,
        "barrier": 1 - 0.4254 * x - 0.3248 * y - 0.7549 * y**2 - 0.8616 * x**2 - 0.2846 * x * y >= 0.0,
    }
    for name, where in inside.items():
        share = float(where.mean())
        assert 16.0 * share == pytest.approx(_NAMES[name][1], abs=5.0 * 16.0 * math.sqrt(share / len(x)))


def test_a_smaller_trace_is_not_a_larger_region() -> None:
    """1 - x' M x >= 0 has the area pi / sqrt(det M); the paper minimises the trace in its stead."""
    rng = np.random.default_rng(6)
    x = rng.uniform(-1.5, 1.5, (400_000, 2))
    shares, traces = [], []
    for m in (np.diag([1.0, 4.0]), np.diag([2.4, 2.4])):
        shares.append(float((np.einsum("ni,ij,nj->n", x, m, x) <= 1.0).mean()))
        traces.append(np.trace(m))
        assert 9.0 * shares[-1] == pytest.approx(math.pi / math.sqrt(np.linalg.det(m)), rel=0.02)
    assert traces[1] < traces[0]
    assert shares[1] < shares[0]


@pytest.mark.parametrize("yaw", [0.0, 0.5 * math.pi, math.pi, -2.0])
def test_feedback_of_position_on_roll_and_pitch_is_right_at_yaw_zero_only(yaw: float) -> None:
    """The printed roll (y_d - y) and pitch (x - x_d), and the same with the error turned by yaw: do they lead back?"""
    error = np.array([0.6, -0.8])  # r_d - r, north and east
    c, s = math.cos(yaw), math.sin(yaw)
    turned = np.array([[c, s], [-s, c]]) @ error

    def pull(ahead: float, aside: float) -> float:
        """Acceleration along the error, of a little roll `aside` and pitch `-ahead`."""
        body = quat_to_matrix(quat_from_euler(0.01 * aside, -0.01 * ahead, yaw))
        return float(-body[:2, 2] @ error) * G

    assert pull(*turned) == pytest.approx(0.01 * G, rel=1e-3)
    assert pull(*error) == pytest.approx(0.01 * G * c, abs=1e-3)


def test_the_boundary_of_the_papers_region_is_where_the_captions_should_have_it() -> None:
    """(z + 0.8)^2 / 0.36 <= 1: z from -1.4 to -0.2, centre -0.8; the text says -1.2 and 0."""
    region = load_scenario("paper-barrier").region
    assert region is not None
    centre, semi = region.centre_ned_m[2], region.semi_axes_m[2]
    assert (centre - semi, centre, centre + semi) == pytest.approx((-1.4, -0.8, -0.2))
    rest = np.zeros(3)
    for down, h in ((-1.4, 0.0), (-0.2, 0.0), (-0.8, 1.0), (-1.2, 1.0 - 0.16 / 0.36)):
        assert region.value(np.array([0.0, 0.0, down]), rest) == pytest.approx(h, abs=1e-12)


def test_density_counts_samples_on_their_own_area() -> None:
    """A thousand samples evenly over the region are as dense everywhere; those of one half are twice as dense there."""
    claim = Claim(crossed(0.6, 0.6, 0.3), 2.0, constant(-2.8, 9.81))
    rng = np.random.default_rng(7)
    low_e, high_e, low_v, high_v = claim.barrier.box
    points = np.stack([rng.uniform(low_e, high_e, 60_000), rng.uniform(low_v, high_v, 60_000)], axis=1)
    b = claim.barrier
    e, v = points.T
    points = points[b.p11 * e * e + 2.0 * b.p12 * e * v + b.p22 * v * v <= 1.0]
    even = len(points) / claim.barrier.area_m2ps
    none = np.zeros(0)
    for each in density(claim, ClaimSamples(points, none, none, 0, np.zeros((0, 2)), points)).values():
        assert each == pytest.approx(even, rel=0.05)
    half = density(claim, ClaimSamples(points[points[:, 1] > 0.0], none, none, 0, np.zeros((0, 2)), points))
    assert half["down"] == pytest.approx(even, rel=0.05)
    assert half["up"] == 0.0


def test_an_area_of_a_level_set_is_counted_along_rays() -> None:
    """A shifted ellipse of semi-axes 0.5 and 2: pi; and a curve that is none, x^4 + y^4 <= 1 (Gamma functions)."""
    shifted = ExactPolynomial({(0, 0): "0.96", (1, 0): "0.8", (2, 0): -4, (0, 2): "-0.25"})
    assert level_set_area(shifted) == pytest.approx(math.pi * 0.5 * 2.0, rel=1e-6)
    quartic = ExactPolynomial({(0, 0): 1, (4, 0): -1, (0, 4): -1})
    assert level_set_area(quartic) == pytest.approx(4.0 * math.gamma(1.25) ** 2 / math.gamma(1.5), rel=1e-6)


@pytest.mark.parametrize(("name", "least", "most"), [("lyapunov", 2.5818, 2.592), ("barrier", 4.2529, 4.335)])
def test_example_1_is_solved_from_its_dynamics(name: str, least: float, most: float) -> None:
    """Between what the paper prints and the limit of the programme without a rate (an independent search's)."""
    found = solved_area(name)
    assert found["anew"] is True
    assert least < found["area"] <= most
