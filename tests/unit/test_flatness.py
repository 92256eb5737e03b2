"""Flatness against the paper's own formulas, away from and at the places where they fail."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flightstack.flatness import BodyMotion, to_body, to_flat
from flightstack.frames import euler_from_quat, quat_from_euler, quat_to_matrix
from flightstack.trajectory import sinusoid
from flightstack.types import F64, FlatOutput

G = 9.80665
PATH = sinusoid((0.0, 0.0, -1.5), (1.5, 1.0, 0.5), (1.6, 1.9, 2.6))


def point(acc: F64, jerk: F64, snap: F64 | None = None, yaw: float = 0.0, yaw_rate: float = 0.0) -> FlatOutput:
    zero = np.zeros(3)
    return FlatOutput.of(
        zero, zero, np.array(acc), np.array(jerk), zero if snap is None else np.array(snap), yaw, yaw_rate
    )


def paper_angles(acc: F64, yaw: float) -> tuple[float, float]:
    """theta_d and phi_d of Section IV.A."""
    c, s = math.cos(yaw), math.sin(yaw)
    beta_a = -acc[0] * c - acc[1] * s
    beta_b = -acc[2] + G
    beta_c = -acc[0] * s + acc[1] * c
    return math.atan2(beta_a, beta_b), math.atan2(beta_c, math.hypot(beta_a, beta_b))


def paper_rates(acc: F64, jerk: F64, yaw: float, yaw_rate: float) -> F64:
    """omega_FF of Section IV.A; the angles' rates by central differences along the jerk."""
    h = 1e-6
    after, before = paper_angles(acc + h * jerk, yaw + h * yaw_rate), paper_angles(acc - h * jerk, yaw - h * yaw_rate)
    theta, phi = paper_angles(acc, yaw)
    theta_rate, phi_rate = ((a - b) / (2 * h) for a, b in zip(after, before, strict=True))
    ct, st, cp, sp = math.cos(theta), math.sin(theta), math.cos(phi), math.sin(phi)
    turn = np.array([[1.0, 0.0, -st], [0.0, cp, sp * ct], [0.0, -sp, cp * ct]])
    return turn @ np.array([phi_rate, theta_rate, yaw_rate])


@pytest.mark.parametrize("t", np.linspace(0.0, 9.0, 10).tolist())
@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5])
def test_thrust_attitude_and_rates_are_the_papers(t: float, yaw: float) -> None:
    p = PATH.at(t)
    flat = point(p.acc_ned_mps2, p.jerk_ned_mps3, yaw=yaw, yaw_rate=0.4)
    body = to_body(flat, mass_kg=1.3)
    assert body.thrust_n == pytest.approx(1.3 * np.linalg.norm(p.acc_ned_mps2 - [0.0, 0.0, G]))
    theta, phi = paper_angles(p.acc_ned_mps2, yaw)
    np.testing.assert_allclose(euler_from_quat(body.q_ned_frd), [phi, theta, yaw], atol=1e-9)
    np.testing.assert_allclose(body.rate_frd_radps, paper_rates(p.acc_ned_mps2, p.jerk_ned_mps3, yaw, 0.4), atol=1e-7)


def test_learned_accelerations_are_fed_forward_as_in_the_paper_with_the_derivative_it_leaves_out() -> None:
    """What is learned counts as an acceleration less to produce: the paper's formulas at r'' - m(q), r''' - m'(q)."""
    acc, jerk = np.array([1.0, -2.0, 0.5]), np.array([0.3, 1.0, -0.7])
    learned, learned_rate = np.array([0.98, 0.1, 2.0]), np.array([-0.2, 0.4, 0.1])
    body = to_body(point(acc, jerk), mass_kg=1.0, learned_acc_ned_mps2=learned, learned_jerk_ned_mps3=learned_rate)
    assert body.thrust_n == pytest.approx(np.linalg.norm(acc - learned - [0.0, 0.0, G]))
    theta, phi = paper_angles(acc - learned, 0.0)
    np.testing.assert_allclose(euler_from_quat(body.q_ned_frd), [phi, theta, 0.0], atol=1e-9)
    np.testing.assert_allclose(
        body.rate_frd_radps, paper_rates(acc - learned, jerk - learned_rate, 0.0, 0.0), atol=1e-7
    )


def test_hover_needs_the_weight_and_no_rotation() -> None:
    body = to_body(point(np.zeros(3), np.zeros(3), yaw=1.0), mass_kg=1.2)
    assert body.thrust_n == pytest.approx(1.2 * G)
    np.testing.assert_allclose(body.q_ned_frd, quat_from_euler(0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(body.rate_frd_radps, 0.0, atol=1e-12)


def test_accelerating_north_pitches_the_nose_down_and_east_rolls_right() -> None:
    """FRD: a nose below the horizon is a negative pitch, right side down a positive roll."""
    roll, pitch, _ = euler_from_quat(to_body(point(np.array([2.0, 0, 0]), np.zeros(3)), mass_kg=1.0).q_ned_frd)
    assert pitch == pytest.approx(-math.atan2(2.0, G))
    assert roll == pytest.approx(0.0)
    roll, pitch, _ = euler_from_quat(to_body(point(np.array([0, 2.0, 0]), np.zeros(3)), mass_kg=1.0).q_ned_frd)
    assert roll == pytest.approx(math.atan2(2.0, G))


def test_climbing_needs_more_thrust() -> None:
    assert to_body(point(np.array([0, 0, -1.0]), np.zeros(3)), mass_kg=2.0).thrust_n == pytest.approx(2.0 * (G + 1.0))


@pytest.mark.parametrize("drag", [(0.4, 0.4, 0.4), (0.5, 0.5, 0.1), (0.2, 0.2, 0.9)])
def test_drag_is_compensated_exactly_where_x_and_y_are_alike(drag: tuple[float, float, float]) -> None:
    """Newton's law with the full R D R^T v gives back the acceleration that was asked for."""
    p = PATH.at(1.3)
    body = to_body(p, mass_kg=1.1, drag_kgps=drag)
    r = quat_to_matrix(body.q_ned_frd)
    force = -body.thrust_n * r[:, 2] - r @ np.diag(drag) @ r.T @ p.vel_ned_mps
    np.testing.assert_allclose(force / 1.1 + [0.0, 0.0, G], p.acc_ned_mps2, atol=1e-12)


def test_a_loop_through_pitch_90_keeps_its_heading_axis_and_its_rates() -> None:
    """The thrust axis turns about body y at 3 rad/s, through horizontal and upside down: rates stay (0, 3, 0)."""
    for angle in np.linspace(-3.0, 3.0, 61):
        z = np.array([math.sin(angle), 0.0, math.cos(angle)])
        dz, ddz = 3.0 * np.array([math.cos(angle), 0.0, -math.sin(angle)]), -9.0 * z
        flat = point(np.array([0.0, 0.0, G]) - 12.0 * z, -12.0 * dz, -12.0 * ddz)
        hint = quat_from_euler(0.0, float(angle), 0.0)
        body = to_body(flat, mass_kg=1.0, hint_q_ned_frd=hint)
        np.testing.assert_allclose(quat_to_matrix(body.q_ned_frd), quat_to_matrix(hint), atol=1e-9)
        np.testing.assert_allclose(body.rate_frd_radps, [0.0, 3.0, 0.0], atol=1e-9)
        np.testing.assert_allclose(body.angular_acceleration_frd_radps2, 0.0, atol=1e-9)


def test_a_roll_through_90_degrees_is_continuous_with_the_bodys_own_axis_as_hint() -> None:
    """There the paper's angles jump by half a turn; here body x stays north all the way round."""
    for angle in np.linspace(-3.1, 3.1, 621):
        z = np.array([0.0, -math.sin(angle), math.cos(angle)])
        dz = 2.0 * np.array([0.0, -math.cos(angle), -math.sin(angle)])
        flat = point(np.array([0.0, 0.0, G]) - 12.0 * z, -12.0 * dz, 48.0 * z)
        hint = quat_from_euler(float(angle), 0.0, 0.0)
        body = to_body(flat, mass_kg=1.0, hint_q_ned_frd=hint)
        np.testing.assert_allclose(quat_to_matrix(body.q_ned_frd), quat_to_matrix(hint), atol=1e-9)
        np.testing.assert_allclose(body.rate_frd_radps, [2.0, 0.0, 0.0], atol=1e-9)


def test_upright_the_heading_asked_for_wins_over_the_hint() -> None:
    hint = quat_from_euler(0.0, 0.0, math.pi)
    body = to_body(point(np.array([1.0, 1.0, 0.0]), np.zeros(3), yaw=0.3), mass_kg=1.0, hint_q_ned_frd=hint)
    assert euler_from_quat(body.q_ned_frd)[2] == pytest.approx(0.3)


def test_free_fall_asks_for_no_thrust_no_rotation_and_the_present_thrust_axis() -> None:
    hint = quat_from_euler(0.2, -0.3, 0.0)
    body = to_body(point(np.array([0.0, 0.0, G]), np.ones(3)), mass_kg=1.0, hint_q_ned_frd=hint)
    assert body.thrust_n == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(quat_to_matrix(body.q_ned_frd)[:, 2], quat_to_matrix(hint)[:, 2], atol=1e-12)
    np.testing.assert_allclose(body.rate_frd_radps[:2], 0.0, atol=1e-12)


def test_the_way_back_reads_yaw_and_its_rate_from_a_turning_body() -> None:
    turning = BodyMotion(9.0, 0.0, quat_from_euler(0.1, 0.2, 1.5), np.array([0.0, 0.0, 0.5]), np.zeros(3))
    flat = to_flat(turning, mass_kg=1.0)
    assert flat.yaw_rad == pytest.approx(1.5)
    assert flat.yaw_rate_radps == pytest.approx(0.5 * math.cos(0.1) / math.cos(0.2))
