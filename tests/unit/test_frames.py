"""Frames and attitude against SciPy's rotations and hand-written axes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from flightstack import frames

ANGLE = st.floats(-3.1, 3.1)
PITCH = st.floats(-1.5, 1.5)


def _scipy(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(q[[1, 2, 3, 0]])  # SciPy wants the scalar last


@settings(deadline=None, max_examples=60)
@given(ANGLE, PITCH, ANGLE)
def test_euler_quaternion_and_matrix_agree_with_scipy(roll: float, pitch: float, yaw: float) -> None:
    q = frames.quat_from_euler(roll, pitch, yaw)
    oracle = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    np.testing.assert_allclose(frames.quat_to_matrix(q), oracle.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(frames.euler_from_quat(q), [roll, pitch, yaw], atol=1e-9)
    back = frames.matrix_to_quat(oracle.as_matrix())
    assert back[0] >= 0.0
    assert abs(float(back @ q)) == pytest.approx(1.0, abs=1e-12)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.floats(-1, 1), min_size=11, max_size=11))
def test_products_rotations_and_inverses_agree_with_scipy(numbers: list[float]) -> None:
    a, b, v = np.array(numbers[:4]), np.array(numbers[4:8]), np.array(numbers[8:])
    if np.linalg.norm(a) < 0.1 or np.linalg.norm(b) < 0.1:
        return
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    product = frames.quat_multiply(a, b)
    np.testing.assert_allclose(frames.quat_to_matrix(product), (_scipy(a) * _scipy(b)).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(frames.rotate(a, v), _scipy(a).apply(v), atol=1e-12)
    np.testing.assert_allclose(frames.rotate_inverse(a, v), _scipy(a).inv().apply(v), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-3, 1.0, 3.0])
def test_the_exponential_map_is_scipys(angle: float) -> None:
    phi = angle * np.array([0.6, -0.48, 0.64])
    q = frames.quat_from_rotation_vector(phi)
    np.testing.assert_allclose(q[1:], Rotation.from_rotvec(phi).as_quat()[:3], atol=1e-15)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)


def test_hand_computed_attitudes() -> None:
    nose_up = frames.quat_from_euler(0.0, math.pi / 2, 0.0)
    np.testing.assert_allclose(frames.rotate(nose_up, np.array([1.0, 0.0, 0.0])), [0.0, 0.0, -1.0], atol=1e-15)
    east = frames.quat_from_euler(0.0, 0.0, math.pi / 2)
    np.testing.assert_allclose(frames.rotate(east, np.array([1.0, 0.0, 0.0])), [0.0, 1.0, 0.0], atol=1e-15)
    right_wing_down = frames.quat_from_euler(math.pi / 2, 0.0, 0.0)
    np.testing.assert_allclose(frames.rotate(right_wing_down, np.array([0.0, 1.0, 0.0])), [0.0, 0.0, 1.0], atol=1e-15)


def test_viewers_see_the_same_body_in_enu_and_flu() -> None:
    """A body vector turned to the world in NED/FRD and then shown must be the one shown and then turned in ENU/FLU."""
    rng = np.random.default_rng(5)
    q = rng.normal(size=(50, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    body = rng.normal(size=(50, 3))
    for attitude, shown, vector in zip(q, frames.q_ned_frd_to_enu_flu(q), body, strict=True):
        expected = frames.ned_to_enu(frames.rotate(attitude, vector))
        np.testing.assert_allclose(_scipy(shown).apply(frames.frd_to_flu(vector)), expected, atol=1e-12)
    np.testing.assert_allclose(frames.ned_to_enu(np.array([1.0, 2.0, 3.0])), [2.0, 1.0, -3.0])
