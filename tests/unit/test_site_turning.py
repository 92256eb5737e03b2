"""How late a vehicle with slow rotors turns: against the rate loop in closed form, and against the simulated one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import TransferFunction, lsim

from flightstack.autopilot import autopilot_of
from flightstack.barrier.response import C_RATE_LAG, CHAIN, STATE
from flightstack.cli import files
from flightstack.cli.protection import governor_for
from flightstack.model import Limits, Model
from flightstack.rows import RATE_X
from flightstack.site.backup import turned
from flightstack.site.turning import Turning, turn_on, turning
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_sim.autopilot.setpoint import ControlKind, ControlSetpoint
from flightstack_sim.grade import load_grade
from flightstack_sim.simulated_vehicle import simulated_vehicle

STEP_S = 0.004


@pytest.fixture(scope="module")
def slow() -> Vehicle:
    """quad-x with rotors of 75 ms and a linear thrust curve: PX4's gains are halved for it."""
    believed, _ = files.load_vehicle(None)
    rotors = dataclasses.replace(believed.rotors, time_constant_s=0.075, thrust_model_factor=0.1)
    return dataclasses.replace(believed, rotors=rotors)


@pytest.fixture(scope="module")
def turn(slow: Vehicle) -> Turning:
    model = Model.from_vehicle(slow)
    return turning(slow, model, governor_for(slow, model, Limits(), "mocap"), Limits())


def answered(turn: Turning, asked: F64) -> F64:
    """Roll rate by the compiled step, on commands of STEP_S each."""
    chain, state, spin, rates = np.zeros(CHAIN), np.zeros(STATE), np.zeros(2), []
    state[6], chain[C_RATE_LAG] = 1.0, turn.lag_s
    for each in asked:
        rates.append(state[RATE_X])
        turn_on(state, spin, chain, turn.rotors_s, 0.5, np.array([each, 0.0, 0.0]), STEP_S, (np.zeros(3), 1.0))
    return np.array(rates)


def test_the_steps_are_the_second_order_loop(turn: Turning) -> None:
    loop = TransferFunction([1.0], [turn.lag_s * turn.rotors_s, turn.lag_s, 1.0])
    t = STEP_S * np.arange(200)
    asked = np.where(t < 0.3, 10.0 * t, 3.0 - 20.0 * (t - 0.3))
    exact = lsim(loop, asked + 5.0 * STEP_S * np.sign(np.gradient(asked)), t)[1]  # a held command is half a step older
    assert np.abs(answered(turn, asked) - exact).max() < 0.06
    jerk, snap, (a, b, c, d), way = 0.0, 0.0, turned(turn.lag_s, turn.rotors_s), []
    for _ in range(30):
        way.append(jerk)
        jerk, snap = 1.0 + a * (jerk - 1.0) + b * snap, c * (jerk - 1.0) + d * snap
    t = 0.02 * np.arange(30)
    assert way == pytest.approx(lsim(loop, np.ones(30), t)[1], abs=1e-6)


def test_slow_rotors_turn_as_late_as_in_the_simulator(slow: Vehicle, turn: Turning) -> None:
    """A ramp of the roll rate and back: by the default gains it would answer twice as soon."""
    vehicle = simulated_vehicle(slow, slow, load_grade("mocap"), seed=1, plant="native")
    norm = Model.from_vehicle(slow).hover_norm
    t = STEP_S * np.arange(125)
    asked = np.where(t < 0.2, 6.0 * t, np.maximum(1.2 - 6.0 * (t - 0.2), -0.6))
    for _ in range(300):
        vehicle.advance(ControlSetpoint(ControlKind.RATE, (0.0, 0.0, 0.0), 1.15 * norm), 4)
    seen = []
    for each in asked:
        seen.append(float(vehicle.plant.rate_frd_radps[0]))
        vehicle.advance(ControlSetpoint(ControlKind.RATE, (float(each), 0.0, 0.0), norm), 4)
    off = float(np.abs(answered(turn, asked) - np.array(seen)).max())
    assert autopilot_of(slow)["mc_rollrate_k"] < 0.6
    believed = Turning(Model.from_vehicle(slow).rate_lag_s, 0.004, 0.0, 0.0, 9.0)
    assert off < 0.15
    assert float(np.abs(answered(believed, asked) - np.array(seen)).max()) > 2.0 * off
