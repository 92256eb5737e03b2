"""On the ground it turns gently only; what leaves it is noticed by what it feels.  Oracles: closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from companions import MODEL
from measured import measured

from flightstack.lift_off import LiftOff
from flightstack.stack import Stack
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, FlatOutput, Measurement

DT_S = 0.004
NONE = np.zeros(3)


def seen(
    up_mps2: float = 0.0, *, pos_ned_m: F64 = NONE, vel_ned_mps: F64 = NONE, t_us: int = 0
) -> Measurement:  # fmt: skip
    force = np.array([0.0, 0.0, -STANDARD_GRAVITY_MPS2 - up_mps2])
    level, motors = np.array([1.0, 0.0, 0.0, 0.0]), np.full(4, np.nan)
    return measured(t_us, pos_ned_m, vel_ned_mps, level, NONE, force, motors, 0, 0, 0)


def until_it_flies(up_mps2: float, vel_ned_mps: F64 = NONE) -> float:
    """Seconds from rest; not a number where it stands for a minute."""
    lift_off = LiftOff(stands=True)
    for tick in range(15_000):
        lift_off = lift_off.step(seen(up_mps2, vel_ned_mps=vel_ned_mps), DT_S)
        if not lift_off.stands:
            return (tick + 1) * DT_S
    return math.nan


@pytest.mark.parametrize("acc_mps2", [0.7, 1.5, 5.0])
def test_a_vehicle_that_rises_is_noticed_within_the_time_of_its_closed_form(acc_mps2: float) -> None:
    """felt' = a exp(-t / 2) - 2 felt from rest: felt = a (exp(-t / 2) - exp(-2 t)) / 1.5; and a few centimetres up."""
    times = np.arange(0.0, 2.0, 1e-4)
    felt = acc_mps2 * (np.exp(-times / 2.0) - np.exp(-2.0 * times)) / 1.5
    expected = float(times[np.argmax(felt > 0.15)])
    assert until_it_flies(acc_mps2) == pytest.approx(expected, abs=0.01)
    assert 0.5 * acc_mps2 * expected**2 < 0.05


@pytest.mark.parametrize("bias_mps2", [0.0, 0.4, -0.4])
def test_an_accelerometers_bias_and_noise_are_no_flight(bias_mps2: float) -> None:
    rng, lift_off = np.random.default_rng(5), LiftOff(stands=True)
    for _ in range(15_000):
        lift_off = lift_off.step(seen(bias_mps2 + rng.normal(0.0, 0.5 if bias_mps2 else 1.0)), DT_S)
    assert lift_off.stands


def test_a_vehicle_that_moves_by_its_estimate_does_not_stand() -> None:
    assert math.isnan(until_it_flies(0.0, vel_ned_mps=np.array([0.3, 0.0, -0.3])))
    assert until_it_flies(0.0, vel_ned_mps=np.array([0.4, 0.0, -0.4])) == DT_S


def test_a_stack_that_stands_commands_gentle_rates_until_it_flies_and_never_again() -> None:
    stack = Stack(MODEL)
    leaning = np.array([2.0, 0.0, 0.0])  # off its place, so that it wants to lean
    zero = np.zeros(3)
    reference = FlatOutput.of(np.array([0.0, 0.0, -0.2]), zero, zero, zero, zero, 0.0)
    state = stack.init(seen(pos_ned_m=leaning), zero, stands=True)
    rates: list[float] = []
    for tick in range(1, 400):
        felt = 2.0 if 200 <= tick < 240 else 0.0
        now = seen(felt, pos_ned_m=leaning, t_us=4000 * tick)
        state, command, record = stack.tick(state, now, reference, 4000 * tick)
        assert not record.guard
        assert command.thrust_n > 0.5 * MODEL.weight_n
        rates.append(float(np.abs(command.rate_frd_radps).max()))
    assert max(rates[:195]) == 0.5
    assert min(rates[245:]) > 1.0
    in_the_air = stack.init(seen(pos_ned_m=leaning), zero)
    assert np.abs(stack.tick(in_the_air, seen(pos_ned_m=leaning), reference, 4000)[1].rate_frd_radps).max() > 1.0
