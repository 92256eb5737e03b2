"""Compile everything that a tick calls, before there is anything to miss.

The first call of a compiled function costs seconds on a fresh machine; a flight must not be the one to pay them.
"""

from __future__ import annotations

import numpy as np

from flightstack.mission import plan
from flightstack.predictor import Streams, predict
from flightstack.scenario import Scenario
from flightstack.stack import Stack

_TICKS = 40
"""Two of the learner's windows and some."""


def warm_up(stack: Stack, scenario: Scenario) -> None:
    """One prediction, tick and fallback with made-up samples, and a look at each leg of the mission."""
    streams = Streams()
    streams.attitude(0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    streams.position(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    streams.imu(0, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    measurement = predict(streams, 1000)
    assert measurement is not None  # every stream was fed
    mission = plan(scenario, np.zeros(3))
    for time_s in (0.0, mission.takeoff_end_s, mission.track_start_s, mission.track_end_s):
        setpoint = mission.reference(time_s + 0.1)
    state = stack.init(measurement)
    now_us = 1000
    for _ in range(_TICKS):
        state, _, _ = stack.tick(state, predict(streams, now_us), setpoint, now_us)
        now_us += 4000
        streams.attitude(now_us, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        streams.position(now_us, tuple(setpoint.pos_ned_m), tuple(setpoint.vel_ned_mps))
        streams.imu(now_us, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    stack.tick(state, predict(streams, 10 * now_us), setpoint, 10 * now_us)
