"""Hostile datagrams against both ends: nothing raises, every good message between them is answered or taken.

100,000 in the tests; `make fuzz` (FLIGHTSTACK_FUZZ=1000000) a million with other seeds.
"""

from __future__ import annotations

import math
import os
import random
import warnings
from pathlib import Path

import numpy as np
import pytest

from flightstack.cli.flight import FlyOptions, SimulatedFlight, prepare
from flightstack.vehicle import parse_vehicle
from flightstack_logs.writer import FlightLog
from flightstack_sim.grade import load_grade
from flightstack_sim.server import Server
from flightstack_sim.simulated_vehicle import simulated_vehicle
from mavlink_bridge import messages as m
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link
from tests.hostile import good_frames, hostile, malformed

NUMBER = int(os.environ.get("FLIGHTSTACK_FUZZ", "100000"))
SEED = 17 if NUMBER == 100_000 else NUMBER
EVERY = 10
"""A good message after so many bad ones."""
PER_TICK = 100
ROOT = Path(__file__).resolve().parents[2]


def _server() -> Server:
    vehicle = parse_vehicle((ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text(), "quad-x.toml")
    server = Server(simulated_vehicle(vehicle, vehicle, load_grade("mocap"), seed=1))
    server.advance(5000)
    return server


def _answered(server: Server, client: Link) -> list[object]:
    for data in server.datagrams(0):
        client.receive_datagram(data, 0)
    answers = []
    while (received := client.next_event()) is not None:
        answers.append(received.message)
    return answers


@pytest.mark.parametrize("kind", ["malformed", "hostile"])
def test_the_simulator_answers_every_good_message_between_bad_ones(kind: str) -> None:
    """A quarter of them each; in flight as far as what comes lets it fly."""
    rng, frames = random.Random(SEED), good_frames(SEED)
    server, client = _server(), Link(245, 190)
    client.send(m.CommandLong(1, 1, 400, 0, (1.0,) + (math.nan,) * 6))
    client.send(m.CommandLong(1, 1, 22, 0, (math.nan,) * 7))
    for data in client.datagrams_to_send():
        server.receive(0, data)
    server.advance(4000)
    asked = answered = 0
    for count in range(NUMBER // 4):
        bad = malformed(rng, frames) if kind == "malformed" else hostile(rng, system=245, component=190)
        server.receive(0, bad)
        if count % EVERY == 0:
            asked += 1
            client.send(m.Ping(5, count, 0, 0))
            server.receive(0, client.datagrams_to_send()[0])
            pings = [answer for answer in _answered(server, client) if isinstance(answer, m.Ping)]
            answered += any(
                (ping.seq, ping.target_system, ping.target_component) == (count, 245, 190) for ping in pings
            )
        if count % PER_TICK == 0:
            server.advance(4)
    assert answered == asked == NUMBER // 4 // EVERY
    server.advance(1000)
    assert any(isinstance(answer, m.Heartbeat) for answer in _answered(server, client))
    assert server.view.pos_ned_m == server.view.pos_ned_m  # no NaN has come in by the wire
    client.send(m.CommandLong(1, 1, 519, 0, (math.nan,) * 7))
    server.receive(0, client.datagrams_to_send()[0])
    assert any(isinstance(answer, m.CommandAck) for answer in _answered(server, client))


def _tracking(folder: Path) -> tuple[SimulatedFlight, FlightLog]:
    options = FlyOptions(scenario="hover", out=folder, learning=False)
    log = FlightLog.open(folder / "flight.mcap", metadata={})
    flight = SimulatedFlight(prepare(options), options, log)
    while flight.companion.phase != "track":
        flight.step()
        assert not flight.companion.done
    return flight, log


def test_the_companion_flies_on_through_malformed_and_foreign_datagrams(tmp_path: Path) -> None:
    """Noise, broken frames, and good frames of other systems with hostile numbers: none of it is the vehicle's word."""
    rng, frames = random.Random(SEED + 1), good_frames(SEED)
    flight, log = _tracking(tmp_path)
    companion = flight.companion
    lost, furthest = companion.link.stats.lost, 0.0
    at = flight.vehicle.plant.pos_ned_m.copy()
    for count in range(NUMBER // 4):
        bad = malformed(rng, frames) if count % 2 else hostile(rng, system=rng.randint(2, 255), component=1)
        companion.receive_datagram(bad, flight.t_us)
        if count % PER_TICK == 0:
            flight.step()
            furthest = max(furthest, float(np.linalg.norm(flight.vehicle.plant.pos_ned_m - at)))
            if companion.state is not State.OFFBOARD:  # a scenario's length is over sooner than a million
                break
    assert companion.state in (State.OFFBOARD, State.LANDING)
    assert companion.link.stats.lost == lost  # of the vehicle's own
    assert furthest < 0.1
    flight.close()
    log.close()


_ENDS_IT = (m.Heartbeat, m.CurrentMode, m.ExtendedSysState, m.CommandAck)
"""One hostile word of these ends a flight, as it should."""


@pytest.mark.parametrize("spared", [(), _ENDS_IT], ids=["everything", "all but what ends a flight"])
def test_the_companion_raises_nothing_whatever_the_vehicle_itself_says(
    spared: tuple[type, ...], tmp_path: Path
) -> None:
    """The vehicle's own frames with hostile numbers while it tracks; where that ends is the guard's business."""
    rng, rows = random.Random(SEED + 2), [row for row in m.MESSAGES if row.event not in spared]
    flight, log = _tracking(tmp_path)
    ticks = flight.companion.ticks
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the overflow of absurd numbers is no exception in flight
        for count in range(NUMBER // 8):
            flight.companion.receive_datagram(hostile(rng, system=1, component=1, row=rng.choice(rows)), flight.t_us)
            if count % 20 == 0:
                flight.step()
    assert flight.companion.ticks > ticks or not spared  # it was still being flown when the first ones came
    flight.close()
    log.close()


def test_every_stream_can_be_built_from_a_state_that_is_no_number() -> None:
    """A plant that has blown up is told as it is, never by an exception."""
    from flightstack_sim.streams import STREAMS, build_once

    server = _server()
    server.vehicle.sensors.state[:] = math.nan
    server.vehicle.plant.pos_ned_m[:] = math.nan
    server.view.refresh()
    client = Link(9, 9)
    for spec in STREAMS:
        message = build_once(spec.id, server.view)
        if message is not None:
            client.send(message)
    assert len(client.datagrams_to_send()) > 20
