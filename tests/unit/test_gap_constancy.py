"""A drag is the same all the time though something else pushes differently in each stretch; one that changes is not."""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.gap.decisions import FICKLE_P, TENTH
from flightstack.gap.naming.estimate import by_segment, same
from flightstack.types import F64

RATE_HZ, STRETCH_S, STRETCHES = 100.0, 8.0, 6
DRAG_PER_S, TILT_RAD, NOISE_MPS2 = 0.38, 0.0175, 0.1
"""A Crazyflie's in hover; a degree between camera and vehicle; an accelerometer's noise."""


def _flown(drag_per_s: F64, seed: int) -> tuple[F64, F64, F64]:
    """Velocity (R,) of laps of 12 s, what is felt beyond the model (R,), and each row's stretch (R,)."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, STRETCHES * STRETCH_S, 1.0 / RATE_HZ)
    number = (t_s // STRETCH_S).astype(int)
    velocity = np.sin(2.0 * np.pi * t_s / 12.0 + rng.uniform(0.0, 6.28))
    push = 9.80665 * TILT_RAD * rng.choice([-1.0, 1.0], STRETCHES)
    felt = -drag_per_s[number] * velocity + push[number] + NOISE_MPS2 * rng.normal(size=len(t_s))
    return velocity, felt, number


def _p_value(drag_per_s: F64, seed: int, beside: bool) -> float:
    velocity, felt, number = _flown(drag_per_s, seed)
    columns = [-velocity, *([np.ones_like(velocity)] if beside else [])]
    x, allowed = np.column_stack(columns) / NOISE_MPS2, np.array([(TENTH * DRAG_PER_S) ** 2])
    theta, variance = by_segment(x, felt / NOISE_MPS2, number, allowed)
    return float(same(theta, variance, allowed)[0][0])


@pytest.mark.parametrize("seed", range(5))
def test_a_drag_beside_a_tilt_that_wanders_is_one_drag(seed: int) -> None:
    drag = np.full(STRETCHES, DRAG_PER_S)
    assert _p_value(drag, seed, beside=True) > 0.01
    assert _p_value(drag, seed, beside=False) < FICKLE_P  # so it was before


@pytest.mark.parametrize("seed", range(5))
def test_a_drag_that_changes_is_none_whatever_pushes_beside_it(seed: int) -> None:
    drag = np.where(np.arange(STRETCHES) < 3, DRAG_PER_S, 0.0)
    assert _p_value(drag, seed, beside=True) < FICKLE_P
