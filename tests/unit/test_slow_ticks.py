"""A companion at 42 Hz, just above what `overrun-rate` calls too slow (40 Hz), flies as one at 250 Hz."""

from __future__ import annotations

import numpy as np
from shipped import load_scenario, load_vehicle

from flightstack.frames import quat_to_matrix
from flightstack.model import Limits, Model
from flightstack.stack import Stack, StackState
from flightstack.types import Command, FlatOutput, Measurement, TickRecord
from tests.closed_loop import ClosedLoopFlight, fly

SIH = load_vehicle("px4-sihsim-quadx")


class Slow(Stack):
    """Decides at every `every`-th tick; in between the vehicle goes on with what it was sent."""

    __slots__ = ("count", "every", "last")

    def tick(
        self, state: StackState, measurement: Measurement | None, setpoint: FlatOutput, now_us: int
    ) -> tuple[StackState, Command, TickRecord]:
        self.count += 1
        if self.count % self.every and self.last is not None:
            return state, *self.last
        state, command, record = super().tick(state, measurement, setpoint, now_us)
        self.last = command, record
        return state, command, record


def flown(every: int) -> ClosedLoopFlight:
    def slow(model: Model, limits: Limits) -> Stack:
        stack = Slow(model, limits)
        stack.every, stack.count, stack.last = every, -1, None
        return stack

    scenario = load_scenario("figure8").with_duration(10.0)
    return fly(scenario, SIH, seed=1, grade="px4-sih", make_stack=slow, truth=SIH)


def test_at_42_hz_a_figure_of_eight_is_flown_as_at_250() -> None:
    """3 m/s with a real PX4's noise: 0.39 m of the truth, nearly all the estimate's, and 33 degrees, both ways."""
    often, rarely = flown(1), flown(6)
    assert often.guards == rarely.guards == set()
    assert rarely.rmse_m < 1.03 * often.rmse_m
    tilts = [
        max(float(np.arccos(quat_to_matrix(np.array(truth.q_ned_frd))[2, 2])) for truth in flight.truths)
        for flight in (often, rarely)
    ]
    assert abs(tilts[1] - tilts[0]) < np.radians(2.0)
