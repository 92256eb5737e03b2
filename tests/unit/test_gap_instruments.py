"""What a loop feeds back of its gyro's noise, and commands that a log's rows hold: neither is an effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.gap_cases import make, write
from flightstack.gap import instruments
from flightstack.gap.checks.clocks import settle_clocks
from flightstack.gap.naming.ranged import as_twins_read
from flightstack.gap.records import Estimate, IdentifiedEffect, Samples, Signal
from flightstack.gap.simulate import with_value
from flightstack.gap.workflow import analyse
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from tests.gap_flights import as_samples, fly, hidden, quad, wander

TRUE_LAG_S = 0.042
SHIFT_S = 0.004


@pytest.fixture(scope="module")
def shaky() -> Samples:
    """A flight on a noisy gyro, whose noise a rate loop feeds back."""
    truth = hidden(quad(), {"motor_lag": {"time_constant_s": TRUE_LAG_S}})
    return as_samples(fly(truth, quad(), wander(), seconds=30.0, seed=5, grade="px4-sih"))


def named(effect: str, **parameters: tuple[float, float, float, float]) -> IdentifiedEffect:
    """An effect with these parameters: before, estimate, ends of its interval."""
    return IdentifiedEffect(effect, {p: Estimate(*x) for p, x in parameters.items()}, -100.0, 0.5, 1e-9, (), "")


def lag_of(told_s: float) -> tuple[IdentifiedEffect, Vehicle]:
    """A motor lag named to be of this size, within 2 ms, and the vehicle with it."""
    found = named("motor_lag", time_constant_s=(0.02, told_s, told_s - 0.002, told_s + 0.002))
    return found, with_value(quad(), "motor_lag", {"time_constant_s": told_s})


def test_a_lag_that_the_loops_noise_has_bent_is_put_right(shaky: Samples) -> None:
    """12 ms too short: the planted one is in the interval, by instruments alone and beside the estimate."""
    found, vehicle = lag_of(TRUE_LAG_S - 0.012)
    wide, alone = instruments.compared(quad(), vehicle, [found], [shaky], [shaky.valid], [0.0])
    assert alone is not None
    for (lag,) in (wide, alone):
        told = lag.parameters["time_constant_s"]
        assert told.low < TRUE_LAG_S < told.high
    assert wide[0].parameters["time_constant_s"].estimate == TRUE_LAG_S - 0.012


def test_the_truth_is_left_alone(shaky: Samples) -> None:
    found, vehicle = lag_of(TRUE_LAG_S)
    (lag,), alone = instruments.compared(quad(), vehicle, [found], [shaky], [shaky.valid], [0.0])
    assert alone is None
    assert lag.parameters["time_constant_s"].estimate == TRUE_LAG_S


def test_a_lag_that_is_one_stays_one(shaky: Samples) -> None:
    found, vehicle = lag_of(TRUE_LAG_S)
    assert instruments.delay_for_lag(quad(), vehicle, [found], [shaky], [shaky.valid]) is None


def test_a_delay_in_a_hover_is_no_lag(tmp_path: Path) -> None:
    """Commands are the gyro's noise passed on there, for which a lag of 32 ms stood better than the delay of 22 ms."""
    case = make("one:transport_delay", 5060143)
    log, _, _ = write(case, tmp_path, "case", "mcap")
    (found,) = analyse([log], case.believed).found
    assert found.name == "transport_delay"
    assert found.indistinguishable_from == ("motor_lag",)
    told = found.parameters["delay_s"]
    assert told.low <= case.answer.effects["transport_delay"]["delay_s"] <= told.high


def test_commands_that_rows_hold_are_seen_to_have_acted_before_their_stamps() -> None:
    flown = as_samples(fly(quad(), quad(), wander(), seconds=20.0, seed=3))

    def early(shift_s: float) -> float:
        later = np.stack([np.interp(flown.t_s - shift_s, flown.t_s, m) for m in flown.motor.T], axis=1)
        held = replace(flown, motor=later)
        (found,) = instruments.early_s(quad(), [held], [held.valid])
        assert instruments.moved([held], [found])[0].command_late_s == found
        return found

    assert early(0.0) == 0.0
    assert early(SHIFT_S) < 0.0
    assert early(1.8 * SHIFT_S) - early(SHIFT_S) == pytest.approx(-0.8 * SHIFT_S, rel=0.1)


def rows(commands: F64, rate_hz: float) -> Signal:
    return Signal(np.arange(len(commands)) / rate_hz, commands, "rows")


def test_commands_of_a_slower_clock_are_taken_where_they_are_new() -> None:
    rng = np.random.default_rng(1)
    sent = rng.uniform(0.3, 0.6, (1000, 4))
    held = np.concatenate([np.zeros((2500, 4)), sent[np.floor(np.arange(2500) / 2.5).astype(int)]])
    out, findings = settle_clocks({"motor": rows(held, 250.0)}, "csv")
    motor = out["motor"]
    np.testing.assert_array_equal(motor.value[-1000:], sent)
    still = motor.t_s[:-1000]  # before take-off rows stay, or the first command would grow from there
    assert np.allclose(np.diff(still), 0.008)
    assert still[-1] > 9.98
    assert len(settle_clocks({"motor": rows(held, 250.0)}, "ulog")[0]["motor"].t_s) == 5000
    assert any("motor" in f.text and "repeat" in f.text for f in findings)


def test_commands_that_merely_stay_the_same_are_kept() -> None:
    """Rounded ones of a calm flight repeat at random."""
    rng = np.random.default_rng(2)
    new = rng.uniform(size=2500) < 0.4
    calm = np.repeat((0.5 + 0.001 * np.cumsum(new))[:, None], 4, axis=1)
    out, _ = settle_clocks({"motor": rows(calm, 250.0)}, "csv")
    assert len(out["motor"].t_s) == 2500


def test_what_goes_with_the_common_scale_reaches_to_the_twins_reading() -> None:
    """0.32 kg aboard of 1.535 and an inertia of 1.376, told as a thrust of 1.535 / 1.855: the interval holds both."""
    start = quad()
    carried, true_inertia, true_drag = 0.2 * start.mass_kg, 1.376, 2.0e-4
    scale = start.mass_kg / (start.mass_kg + carried)
    thrust = replace(
        named("thrust_scale", scale=(1.0, scale, 0.99 * scale, 1.01 * scale)), indistinguishable_from=("payload",)
    )
    inertia = named("inertia", scale_x=(1.0, true_inertia * scale, 0.97 * true_inertia * scale, 1.2))
    drag = named("rotor_drag", k_d_kg_per_rad=(0.0, true_drag * scale, 0.95 * true_drag * scale, 1.8e-4))
    lag = named("motor_lag", time_constant_s=(0.02, 0.03, 0.028, 0.032))
    told = {f.name: f for f in as_twins_read(start, (thrust, inertia, drag, lag))}
    for value in (true_inertia, true_inertia * scale):
        assert told["inertia"].parameters["scale_x"].low < value < told["inertia"].parameters["scale_x"].high
    for value in (true_drag, true_drag * scale):
        own = told["rotor_drag"].parameters["k_d_kg_per_rad"]
        assert own.low < value < own.high
    assert told["motor_lag"] == lag
    assert told["thrust_scale"] == thrust
    alone = replace(thrust, indistinguishable_from=())
    assert as_twins_read(start, (alone, inertia))[1] == inertia
