"""Compile everything that a tick calls, before there is anything to miss.

The first call of a compiled function costs seconds on a fresh machine; a flight must not be the one to pay them.
"""

from __future__ import annotations

import numpy as np

from flightstack.predictor import Streams, predict
from flightstack.stack import Stack
from flightstack.trajectory import Polynomial, hover


def warm_up(stack: Stack) -> None:
    """One prediction, one tick and one fallback with made-up samples; `stack` is as before."""
    streams = Streams()
    streams.attitude(0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    streams.position(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    streams.imu(0, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    measurement = predict(streams, 1000)
    assert measurement is not None  # every stream was fed
    Polynomial(np.array([0.0, 1.0]), np.zeros((1, 4, 8))).at(0.5)
    setpoint = hover((0.0, 0.0, -1.0)).at(0.0)
    state = stack.init(measurement)
    stack.tick(state, measurement, setpoint, 1000)
    stack.tick(state, predict(streams, 1_000_000), setpoint, 1_000_000)
