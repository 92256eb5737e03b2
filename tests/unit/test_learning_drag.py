"""Drag that the model lacks is learned as drag, not as thrust: on a figure of eight with forces worked out by hand.

The oracle is mechanics: a path p(t), its acceleration a, drag d per second against the ground.  Thrust per mass is then
f = g e_d - a - d v, the thrust axis f / |f|, and an accelerometer measures a - g e_d in body axes (no heading).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from measured import measured as measured_at
from scipy.spatial.transform import Rotation
from shipped import load_vehicle

from flightstack.learning.learner import GpLearner
from flightstack.model import Model
from flightstack.types import F64, Command, FlatOutput, Learned
from tests.thorough import thorough

G = 9.80665
BELIEVED_PER_S = 1.0
STEP_S = 0.004
LAP_RADPS = 1.0


def sihsim() -> Model:
    """Believed: 1 kg, 20 N, linear thrust, drag of 1 / s; without rotor lag, which the oracle leaves out."""
    return replace(Model.from_vehicle(load_vehicle("px4-sihsim-quadx")), motor_lag_s=1e-4)


def path(t: float) -> F64:
    """(4, 3) position, velocity, acceleration, jerk of a figure of eight, 3 m by 1.5 m, with some height."""
    w = LAP_RADPS
    amplitude, rates = np.array([3.0, 1.5, 0.4]), np.array([w, 2.0 * w, 0.7 * w])
    angle = rates * t
    return np.stack(
        [
            amplitude * np.sin(angle) - [0.0, 0.0, 5.0],
            amplitude * rates * np.cos(angle),
            -amplitude * rates**2 * np.sin(angle),
            -amplitude * rates**3 * np.cos(angle),
        ]
    )


def flown(drag_per_s: float, gain: float, seconds: float = 30.0) -> Learned:
    """What the learner knows after a flight whose thrust gives `gain` of what is believed."""
    model, rng = sihsim(), np.random.default_rng(3)
    learner = GpLearner(model)
    state, told = learner.init(), None
    down, nan = np.array([0.0, 0.0, G]), np.full(4, np.nan)
    for k in range(round(seconds / STEP_S)):
        pos, vel, acc, jerk = path(k * STEP_S)
        force = down - acc - drag_per_s * vel
        size = float(np.linalg.norm(force))
        axis = force / size
        turn, _ = Rotation.align_vectors(axis[None], np.array([[0.0, 0.0, 1.0]]))  # the shortest turn of down onto it
        x, y, z, w = turn.as_quat()
        measured = turn.inv().apply(acc - down) + rng.normal(scale=0.05, size=3)
        t_us = 1_000_000 + round(1e6 * STEP_S * k)
        measurement = measured_at(t_us, pos, vel, np.array([w, x, y, z]), np.zeros(3), measured, nan, 0, 0, 0)
        thrust_n = size / gain * model.mass_kg
        sent = Command(t_us - 4_000, thrust_n, model.norm_of(thrust_n), np.zeros(3))
        reference = FlatOutput.of(pos, vel, acc, jerk, np.zeros(3))
        state, told = learner.step(state, measurement, sent, reference)
    assert told is not None
    return told


@pytest.mark.parametrize(("drag_per_s", "gain"), [thorough(2.0, 1.0), (1.0, 0.8), thorough(0.5, 1.1)])
def test_drag_is_not_taken_for_thrust(drag_per_s: float, gain: float) -> None:
    told = flown(drag_per_s, gain)
    assert told.thrust_gain == pytest.approx(gain, abs=0.03)
    assert abs(told.thrust_gain - gain) <= 3.0 * told.thrust_gain_sigma
    assert math.isfinite(told.confidence)
