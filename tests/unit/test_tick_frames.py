"""The frequent streams in one compiled call are, byte for byte, what builder, table and link make one by one."""

from __future__ import annotations

import itertools

import pytest
from station import ONBOARD, Station, airborne

from flightstack_sim import builders
from flightstack_sim.autopilot.setpoint import OFF, ControlKind, ControlSetpoint
from flightstack_sim.streams import LinkKind, LinkStreams
from flightstack_sim.tick_frames import TickFrames, plain
from mavlink_bridge import messages as m
from mavlink_bridge.link import Link

BUILD = (
    builders.highres_imu,
    builders.attitude_quaternion,
    builders.local_position_ned,
    builders.servo_output_raw,
)


@pytest.fixture(scope="module")
def flying() -> Station:
    return airborne()


@pytest.mark.parametrize("thrust", [0.6, float("nan"), None], ids=["spinning", "stopped", "disarmed"])
def test_every_order_gives_the_bytes_of_builder_and_link(flying: Station, thrust: float | None) -> None:
    flying.run(0.1)
    view = flying.server.view
    before = view.setpoint
    view.setpoint = OFF if thrust is None else ControlSetpoint(ControlKind.RATE, thrust_norm=thrust)
    ours, theirs, frames = Link(7, 1), Link(7, 1), TickFrames()
    try:
        for numbers in itertools.permutations(range(1, 5), 3):
            order = 0
            for number in numbers:
                order = order * 8 + number
                theirs.send(BUILD[number - 1](view))
            frames.send(order, view, ours)
            assert ours.datagrams_to_send() == theirs.datagrams_to_send()
        for number in range(1, 5):  # the sequence has gone round at 256
            for _ in range(80):
                frames.send(number, view, ours)
                theirs.send(BUILD[number - 1](view))
        assert ours.datagrams_to_send() == theirs.datagrams_to_send()
        assert ours.stats == theirs.stats
    finally:
        view.setpoint = before


def test_the_stamps_are_those_of_the_table_beyond_71_minutes(flying: Station) -> None:
    view = flying.server.view
    view.clock_offset_us = 2**33 + 1
    ours, theirs = Link(7, 1), Link(7, 1)
    try:
        for number in range(1, 5):
            TickFrames().send(number, view, ours)
            theirs.send(BUILD[number - 1](view))
        assert ours.datagrams_to_send() == theirs.datagrams_to_send()
    finally:
        view.clock_offset_us = 0


def test_what_a_fault_touches_goes_out_message_by_message(flying: Station) -> None:
    view, link = flying.server.view, flying.server.link(ONBOARD)
    assert plain(view, link)
    view.freeze()
    assert not plain(view, link)
    view.thaw()
    view.silenced = frozenset({m.HighresImu})
    assert not plain(view, link)
    view.silenced = frozenset()
    view.vehicle.sensors.position_valid = False
    streams = LinkStreams(LinkKind.ONBOARD)
    try:
        streams.set_interval(m.id_of(m.LocalPositionNed), 4000, view.t_us)
        streams.emit(view, quiet := Link(7, 1))
    finally:
        view.vehicle.sensors.position_valid = True
    (client := Link(240, 1)).receive_datagram(b"".join(quiet.datagrams_to_send()), 0)
    kinds = {type(received.message) for received in client.take_events()}
    assert m.LocalPositionNed not in kinds
    assert m.HighresImu in kinds
