"""The vehicle's frequent messages, read in runs: what comes out is what reading them one by one gives."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavlink_bridge import messages as m
from mavlink_bridge.frequent import AT, DOWN, KINDS, VEL_DOWN, FrequentReader, Heard, Taking
from mavlink_bridge.link import Link
from mavlink_bridge.vehicle_view import VehicleView
from mavlink_bridge.watchdogs import Watchdogs

ZERO = (0.0, 0.0, 0.0)
NUMBER = st.floats(width=32, allow_nan=False, allow_infinity=False)
ANY = st.floats(width=32)
STAMP_US = st.integers(0, 2**31).map(lambda ms: 1000 * ms)
THREE, FOUR, ANY_THREE = st.tuples(*[NUMBER] * 3), st.tuples(*[NUMBER] * 4), st.tuples(*[ANY] * 3)
PULSES = st.lists(st.integers(0, 0xFFFF), min_size=16, max_size=16).map(tuple)
MESSAGE = st.one_of(
    st.builds(
        m.HighresImu, st.integers(0, 2**64 - 1), THREE, THREE, ANY_THREE, ANY, ANY, ANY, ANY, st.integers(0, 0xFFFF),
        st.integers(0, 255),
    ),
    st.builds(m.AttitudeQuaternion, STAMP_US, FOUR, THREE),
    st.builds(m.LocalPositionNed, STAMP_US, THREE, THREE),
    st.builds(m.ServoOutputRaw, st.integers(0, 2**32 - 1), st.integers(0, 1), PULSES),
    st.builds(m.ExtendedSysState, st.integers(0, 255), st.integers(0, 255)),
)  # fmt: skip


def _links(reading: tuple[int, int] = (1, 1)) -> tuple[Link, Link, Link]:
    """A vehicle, a link that reads one by one, and one that reads runs; both have heard the vehicle."""
    vehicle, single, runs = Link(1, 1), Link(240, 191), Link(240, 191)
    runs.read_runs(FrequentReader(*reading))
    vehicle.send(m.Heartbeat(2, 12, 0, 0, 4))
    for data in vehicle.datagrams_to_send():
        for link in (single, runs):
            link.receive_datagram(data, 0)
            link.take_events()
    return vehicle, single, runs


def _messages(heard: Heard) -> list[object]:
    """Several at once as messages: a stamp, then the triples, then the rest."""
    found: list[object] = []
    for number in heard.numbers:
        stamp, *v = heard.row[AT[number] : AT[number + 1]].tolist()
        kind, t_us = KINDS[number - 1], int(stamp)
        if kind is m.HighresImu:
            found.append(kind(t_us, tuple(v[:3]), tuple(v[3:6]), tuple(v[6:9]), *v[9:13], int(v[13]), int(v[14])))
        elif kind is m.AttitudeQuaternion:
            found.append(kind(t_us, tuple(v[:4]), tuple(v[4:])))
        elif kind is m.LocalPositionNed:
            found.append(kind(t_us, tuple(v[:3]), tuple(v[3:])))
        else:
            found.append(kind(t_us, int(v[16]), tuple(map(int, v[:16]))))
    return found


def _one_by_one(link: Link) -> list[str]:
    """What a link hands out, messages of a run one by one; as text, so that NaN is NaN."""
    found: list[object] = []
    for received in link.take_events():
        message = received.message
        found += _messages(message) if isinstance(message, Heard) else [message]
    return [repr(message) for message in found]


@settings(max_examples=200, deadline=None)
@given(st.lists(MESSAGE, max_size=8), st.data())
def test_runs_hold_what_is_read_one_by_one(sent: list[object], data: st.DataObject) -> None:
    """Also of datagrams that are damaged on the way; and the counters say the same."""
    vehicle, single, runs = _links()
    for message in sent:
        vehicle.send(message)
    for packed in vehicle.datagrams_to_send(1400):
        damaged = bytearray(packed)
        for place in data.draw(st.lists(st.integers(0, len(packed) - 1), max_size=2)):
            damaged[place] ^= 0x40
        for link in (single, runs):
            link.receive_datagram(bytes(damaged), 0)
    assert _one_by_one(runs) == _one_by_one(single)
    assert runs.stats == single.stats


@settings(max_examples=200, deadline=None)
@given(st.lists(st.lists(MESSAGE, max_size=5), max_size=6), st.booleans())
def test_what_is_made_of_runs_is_what_is_made_one_by_one(ticks: list[list[object]], flying: bool) -> None:
    """To the last bit, jumps included: streams, their observer and bias, the watch of the estimate, latency, clock."""
    found = []
    vehicle, *links = _links()
    states = [(VehicleView(), link) for link in links]
    watches = [Watchdogs(view.clock) for view, _ in states]
    for watch in watches:
        if flying:
            watch.begin()
    for count, messages in enumerate(ticks, 1):
        for message in messages:
            vehicle.send(message)
        for data in vehicle.datagrams_to_send(1400):
            for (view, link), watch in zip(states, watches, strict=True):
                link.receive_datagram(data, 4000 * count)
                taking = Taking(view, watch)
                for received in link.take_events():
                    if isinstance(received.message, Heard):
                        taking.take(received.message, 4000 * count)
                    else:
                        view.update(watch.see(received.message), 4000 * count)
        for view, _ in states:
            view.latency.sent(4000 * count, 0.5)
    for (view, _), watch in zip(states, watches, strict=True):
        rows = (
            view.streams.row, view.streams.observer.row, view.streams.imu_bias.row, watch.estimate.row,
            view.latency.sent_row, view.latency.square_row,
        )  # fmt: skip
        said = watch.resets.shift_ned_m, watch.judge(), view.counts, view.clock.vehicle_us(10**7), view.heard_at_us
        found.append(([row.tobytes() for row in rows], repr(said)))
    assert found[0] == found[1]


def test_a_run_is_of_one_sender_and_holds_each_kind_once() -> None:
    vehicle, _, runs = _links()
    attitude = m.AttitudeQuaternion(4000, (1.0, 0.0, 0.0, 0.0), ZERO)
    for _ in range(2):
        vehicle.send(attitude)
        vehicle.send(m.LocalPositionNed(4000, ZERO, ZERO))
    for data in vehicle.datagrams_to_send(1400):
        runs.receive_datagram(data, 0)
    assert [[type(message) for message in _messages(event.message)] for event in runs.take_events()] == 2 * [
        [m.AttitudeQuaternion, m.LocalPositionNed]
    ]
    _, _, others = _links((7, 1))
    others.receive_datagram(data, 0)
    assert {type(event.message) for event in others.take_events()} == {m.AttitudeQuaternion, m.LocalPositionNed}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_read_in_runs(kind: type) -> None:
    """What is usual is read so, or nothing would be gained."""
    vehicle, _, runs = _links()
    sample = {
        m.HighresImu: m.HighresImu(4000, ZERO, ZERO, (math.nan,) * 3, 950.0, 0.0, 500.0, 20.0, 63),
        m.AttitudeQuaternion: m.AttitudeQuaternion(4000, (1.0, 0.0, 0.0, 0.0), ZERO),
        m.LocalPositionNed: m.LocalPositionNed(4000, ZERO, ZERO),
        m.ServoOutputRaw: m.ServoOutputRaw(4000, 0, (1500,) * 16),
    }[kind]
    vehicle.send(sample)
    for data in vehicle.datagrams_to_send():
        runs.receive_datagram(data, 0)
    (event,) = runs.take_events()
    assert isinstance(event.message, Heard)
    assert [repr(message) for message in _messages(event.message)] == [repr(sample)]


def test_height_and_vertical_velocity_stand_where_they_are_said_to() -> None:
    vehicle, _, runs = _links()
    vehicle.send(m.LocalPositionNed(4000, (1.0, 2.0, -3.0), (4.0, 5.0, 6.0)))
    for data in vehicle.datagrams_to_send():
        runs.receive_datagram(data, 0)
    (event,) = runs.take_events()
    assert (event.message.row[DOWN], event.message.row[VEL_DOWN]) == (-3.0, 6.0)
