"""What the motors made of the thrust that was sent; closed forms, and a learner that writes down what it is given."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from companions import MODEL
from measured import measured

from flightstack.applied import Applied
from flightstack.seams import NoLearner
from flightstack.stack import Stack
from flightstack.types import Command, FlatOutput, Learned, Measurement

HOVER = Command(0, MODEL.weight_n, MODEL.hover_norm, np.zeros(3))


def _motors(norm: float, scale: float, spread: float = 0.0) -> np.ndarray:
    """Four commands whose thrusts' mean is `scale` times that of `norm`, two up and two down by `spread` in thrust."""
    share = scale * MODEL.thrust_of(norm) / MODEL.max_thrust_n
    return np.array(
        [MODEL.norm_of(MODEL.max_thrust_n * part) for part in (share * (1 + s * spread) for s in (1, -1, 1, -1))]
    )


def test_a_change_of_scale_is_known_after_some_time_constants() -> None:
    """1.2 times the thrust: both sums have the same weights, so the ratio is exact."""
    applied = Applied()
    for _ in range(2500):
        applied = applied.follow(HOVER, _motors(HOVER.thrust_norm, 1.2), MODEL, 4000)
    got = applied.of(HOVER).thrust_norm
    assert MODEL.thrust_of(got) == pytest.approx(1.2 * MODEL.weight_n, rel=1e-6)


def test_a_change_in_flight_is_followed_within_its_time_constant() -> None:
    applied = Applied()
    for _ in range(1000):
        applied = applied.follow(HOVER, _motors(HOVER.thrust_norm, 1.0), MODEL, 4000)
    for _ in range(500):  # 2 s: 1 - 1/e of the way, as the discrete low-pass says
        applied = applied.follow(HOVER, _motors(HOVER.thrust_norm, 1.44), MODEL, 4000)
    ends = MODEL.norm_of(1.44 * MODEL.weight_n) / HOVER.thrust_norm
    kept, weight = 0.998**500, 1.0 - 0.998**990
    assert kept == pytest.approx(math.exp(-1.0), abs=1e-3)
    old = weight * kept
    assert applied.ratio == pytest.approx((old + (1.0 - kept) * ends) / (old + 1.0 - kept), rel=2e-3)


def test_a_climb_and_its_delay_are_no_change_of_scale() -> None:
    """Thrust that jumps up from the ground, with motors that are told of 12 ms late: nothing but the very same."""
    applied = Applied()
    wanted = [0.08] * 250 + [0.9] * 50 + [HOVER.thrust_norm] * 500
    for tick, norm in enumerate(wanted):
        late = wanted[max(0, tick - 3)]
        sent = HOVER._replace(thrust_norm=norm)
        applied = applied.follow(sent, _motors(late, 1.0), MODEL, 4000)
        assert applied.of(sent) is sent


@pytest.mark.parametrize("scale", [1.0, 1.01, 0.98])
def test_what_hardly_differs_is_the_very_same_command(scale: float) -> None:
    applied = Applied()
    for _ in range(500):
        applied = applied.follow(HOVER, _motors(HOVER.thrust_norm, scale, spread=0.2), MODEL, 4000)
    assert applied.of(HOVER) is HOVER


@pytest.mark.parametrize("motors", [[math.nan] * 4, [0.5, 0.5, math.nan, 0.5], [-1.0] * 4, [math.inf] * 4])
def test_motors_that_are_not_reported_or_make_no_sense_leave_the_commands_that_were_sent(motors: list[float]) -> None:
    applied = Applied().follow(HOVER, np.array(motors), MODEL, 4000)
    for _ in range(500):
        applied = applied.follow(HOVER, np.array(motors), MODEL, 4000)
    assert applied.of(HOVER) is HOVER


class _Scribe:
    """A learner that writes down what it is given."""

    enabled = False

    def __init__(self) -> None:
        self.sent: list[Command] = []
        self._inner = NoLearner()

    def init(self) -> Any:
        return self._inner.init()

    def step(self, state: Any, measurement: Measurement, sent: Command, reference: FlatOutput) -> tuple[Any, Learned]:
        self.sent.append(sent)
        return self._inner.step(state, measurement, sent, reference)


@pytest.mark.parametrize("reported", [True, False])
def test_the_learner_is_given_what_was_applied(reported: bool) -> None:
    """A vehicle that hovers although its autopilot gives the motors 1.25 times the thrust that was asked for."""
    scribe, zero = _Scribe(), np.zeros(3)
    stack = Stack(MODEL, learner=scribe)  # type: ignore[arg-type]
    place = FlatOutput.of(np.array([0.0, 0.0, -2.0]), zero, zero, zero, zero)
    state, commands = None, []
    for tick in range(500):
        now_us = 4000 * tick
        motors = np.full(4, math.nan)
        if reported and commands:
            motors = _motors(commands[-1].thrust_norm, 1.25)
        measurement = measured(
            now_us, place.pos_ned_m, zero, np.array([1.0, 0.0, 0.0, 0.0]), zero, np.array([0.0, 0.0, -9.80665]), motors,
            4000, 4000, 4000,
        )  # fmt: skip
        state = state or stack.init(measurement)
        state, command, _ = stack.tick(state, measurement, place, now_us)
        commands.append(command)
    scale = 1.25 if reported else 1.0
    thrust = MODEL.thrust_of(scribe.sent[-1].thrust_norm)
    assert thrust == pytest.approx(scale * MODEL.thrust_of(commands[-2].thrust_norm), rel=0.01)
