"""Compile everything that a tick calls, before there is anything to miss.

The first call of a compiled function costs seconds on a fresh machine; a flight must not be the one to pay them.
"""

from __future__ import annotations

import numpy as np

from flightstack.barrier.condition import Setting
from flightstack.barrier.confidence import BLOCK, colour
from flightstack.barrier.estimate_bounds import BENCH
from flightstack.barrier.flown import least_h
from flightstack.barrier.initial import DOWN
from flightstack.barrier.premise_watch import watched
from flightstack.barrier.premises import ANY_BATTERY_V, Premises
from flightstack.barrier.records import Authority, AxisCertificate, Budget, Certificate, Response
from flightstack.barrier.shapes import Quadratic, values_at
from flightstack.consistency import EstimateWatch
from flightstack.error_statistics import ErrorStatistics
from flightstack.mission import plan
from flightstack.predictor import Streams, predict
from flightstack.scenario import Scenario
from flightstack.stack import Stack
from flightstack.state_observer import StateObserver
from flightstack.types import F64, TickRecord

_SETTLING_TICKS = 20
"""At rest where it begins, until the thrust as modelled has settled: noise that is none leaves no evidence."""
_TICKS = 60
"""Two of the learner's windows and some."""
_FILTER_TICKS = 400
"""Past the half second after which the barrier filter engages, and long enough to certify something."""
_FAR_M = 30.0
"""A step away that no barrier allows: the filter's fallback is compiled too."""
_STATISTICS = ErrorStatistics("mocap", (0.005,) * 3, 0.2, (0.0,) * 3, (0.02,) * 3, 0.2, (0.03,) * 3, 1.0, (0.01,) * 3)

_WIDE = (-100.0, 100.0)
_PREMISES = Premises(
    "", "", BENCH, (_WIDE,) * 3, (_WIDE, _WIDE), _WIDE, _WIDE, _WIDE, _WIDE, 1.0, 1.0, 1.0, ANY_BATTERY_V
)
"""Nothing breaks them, so that the watch looks at all of them in every tick."""


def warm_up(stack: Stack, scenario: Scenario) -> TickRecord:
    """One prediction, tick and fallback with made-up samples, and a look at each leg of the mission.

    The record of a tick, for whoever writes it.
    """
    _watch()
    colour(np.zeros((2 * BLOCK, 1)), np.zeros((2 * BLOCK, 2), dtype=np.int64), 1.0)  # of as many windows as tell one
    streams = Streams()
    streams.attitude(0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    streams.position(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    streams.imu(0, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    streams.imu_bias.raw(0, (0.0, 0.0, -9.8))
    measurement = predict(streams, 1000)
    assert measurement is not None  # every stream was fed
    StateObserver(_STATISTICS).refine(measurement)
    assert streams.observer.weight.shape == (3,)  # the log asks for it
    mission = plan(scenario, np.zeros(3))
    rest = mission.reference(0.0)
    for time_s in (0.0, mission.takeoff_end_s, mission.track_start_s, mission.track_end_s):
        setpoint = mission.reference(time_s + 0.1)
    state = stack.init(measurement)
    now_us = 1000
    ticks = _TICKS
    if stack.filter.enabled:
        ticks = _FILTER_TICKS
        held = _certificate(setpoint.pos_ned_m)
        least_h(held, np.zeros((1, 6)), None)  # what a flight is told by that has long been inside, and its score
        values_at(held.axes[DOWN].barrier.rows, np.zeros((1, 2)))
        state = state._replace(
            filter=stack.filter.adopt(state.filter, held),
            watch=watched(held.version, _PREMISES, held.axes[DOWN].authority.table),
        )
    for left in range(ticks, 0, -1):
        goal = rest if left > ticks - _SETTLING_TICKS else setpoint
        place = goal.pos_ned_m + (_FAR_M if left == 2 else 0.0)
        state, _, record = stack.tick(state, predict(streams, now_us), goal, now_us)
        now_us += 4000
        streams.attitude(now_us, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        streams.position(now_us, tuple(place), tuple(goal.vel_ned_mps))
        streams.imu(now_us, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    late = predict(streams, now_us)
    assert late is not None
    late.late_us = 20_000
    stack.tick(state, stack.carried(state, late, 10 * now_us), setpoint, 10 * now_us)
    return record


def _watch() -> None:
    """The watch of the estimate: each stream once, and what is worked out of them."""
    watch, zero = EstimateWatch(), (0.0, 0.0, 0.0)
    watch.attitude(0, (1.0, 0.0, 0.0, 0.0), zero)
    watch.position(0, zero, zero)
    watch.imu(0, zero, zero)
    watch.forgive()
    assert not watch.trouble


def _certificate(centre_ned_m: F64) -> Certificate:
    """One that proves nothing: a wide region of ellipses round a place."""
    v, one = np.linspace(-10.0, 10.0, 3), np.ones(3)
    lateral = Authority(v, 0.0 * v, 0.0 * v, -3.0 * one, 3.0 * one, 0.1 * one, 0.1 * one)
    down = Authority(v, 9.0 * one, one, -6.0 * one, 3.0 * one, 0.1 * one, 0.1 * one)
    setting, response = Setting(2.0, 0.0, 0.0, 0.004), Response(0.15, 0.007, 0.01)
    shape, cells = Quadratic(0.0, 0.0, 0.01, 0.0, 0.01), np.zeros((0, 6))
    axes = tuple(
        AxisCertificate(i, shape, setting, response, authority, (), cells)
        for i, authority in enumerate((lateral, lateral, down))
    )
    north, east, down = centre_ned_m.tolist()
    return Certificate("sound", (north, east, down), axes, Budget.square(6.0, 15.0, 17.0, 0.5), 1.0, 0.0)
