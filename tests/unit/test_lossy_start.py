"""Starts over a link that loses three tenths each way, and streams that another station on the link has slowed.

The other end is the simulated autopilot with its own handling of commands, parameters and intervals; rates are counted
from what it sends, not from what the companion says.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from companions import ROOT, Notes
from station import TICK_MS, vehicle_file

from flightstack.model import Model
from flightstack.scenario import parse_scenario
from flightstack.stack import Stack
from flightstack_sim.grade import load_grade
from flightstack_sim.server import Server
from flightstack_sim.simulated_vehicle import simulated_vehicle
from flightstack_sim.streams import LinkKind
from mavlink_bridge import messages as m
from mavlink_bridge.companion import Companion, CompanionConfig
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link
from tests.thorough import thorough

_LOST = 0.3
_MOST_HZ = {m.LocalPositionNed: 125.0, m.AttitudeQuaternion: 198.0}


class _Pair:
    """A companion and an autopilot that has booted, on a link that loses a share, the same one for the same seed."""

    def __init__(self, *, arm: bool, seed: int = 0, lost: float = 0.0, duration_s: float = 5.0) -> None:
        vehicle = vehicle_file("px4-sihsim-quadx")
        text = (ROOT / "flightstack/data/scenarios/hover.toml").read_text()
        scenario = parse_scenario(text, "hover").with_duration(duration_s)
        self.server = Server(
            simulated_vehicle(vehicle, vehicle, load_grade("mocap"), seed=1), links=(LinkKind.ONBOARD,)
        )
        stack = Stack(Model.from_vehicle(vehicle), limits=scenario.limits)
        self.notes = Notes()
        self.companion = Companion(Link(240, 191), stack, scenario, self.notes, CompanionConfig(arm=arm))
        self.sent: Counter[type] = Counter()
        self._ear = Link(9, 1)
        self._lost, self._draw = lost, np.random.default_rng(seed)
        for _ in range(5000 // TICK_MS):
            self.server.advance(TICK_MS)
            self.server.datagrams(0)

    def step(self) -> None:
        self.server.advance(TICK_MS)
        for data in self.server.datagrams(0):
            self._ear.receive_datagram(data, self.server.t_us)
            if self._draw.random() >= self._lost:
                self.companion.receive_datagram(data, self.server.t_us)
        while (received := self._ear.next_event()) is not None:
            self.sent[type(received.message)] += 1
        self.companion.step(self.server.t_us)
        for data in self.companion.link.datagrams_to_send():
            if self._draw.random() >= self._lost:
                self.server.receive(0, data)

    def run_until(self, condition: Any, limit_s: float) -> None:
        end_us = self.server.t_us + 1e6 * limit_s
        while not condition() and not self.companion.done and self.server.t_us < end_us:
            self.step()


@pytest.mark.parametrize("seed", [s if s in (10, 15) else thorough(s) for s in range(20)])
def test_a_start_over_a_link_that_loses_three_tenths_each_way_has_every_stream_as_asked_for(seed: int) -> None:
    pair = _Pair(arm=False, seed=seed, lost=_LOST)
    pair.run_until(lambda: pair.companion.state is State.STREAMING, 30.0)
    assert pair.companion.state is State.STREAMING, pair.companion.reason
    pair.sent.clear()
    for _ in range(2000 // TICK_MS):
        pair.step()
    wanted = {m.AttitudeQuaternion: 4, m.LocalPositionNed: 8, m.HighresImu: 4, m.ScaledImu: 40, m.ServoOutputRaw: 10}
    wanted |= {m.EstimatorStatus: 200, m.ExtendedSysState: 100, m.Odometry: 40}
    for message, interval_ms in wanted.items():
        hz = min(1e3 / interval_ms, _MOST_HZ.get(message, 1e3))
        assert pair.sent[message] / 2.0 >= 0.8 * hz, message.__name__


def test_streams_that_another_station_slows_in_flight_are_asked_for_again() -> None:
    pair = _Pair(arm=True)
    pair.run_until(lambda: pair.companion.phase == "track", 40.0)
    other = Link(250, 190)
    for message in (m.AttitudeQuaternion, m.LocalPositionNed, m.HighresImu):
        words = (float(m.id_of(message)), 200_000.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        other.send(m.CommandLong(1, 1, 511, 0, words))
    for data in other.datagrams_to_send():
        pair.server.receive(0, data)
    pair.run_until(lambda: False, 40.0)
    assert pair.companion.completed, pair.companion.reason
