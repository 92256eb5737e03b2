"""The server's links: who hears what, hostile input, same inputs same bytes."""

from __future__ import annotations

import math
import random

import pytest
from station import (
    ARM,
    GCS,
    HOSTILE,
    MODE,
    ONBOARD,
    POSITION_MODE,
    Station,
    airborne,
)

from mavlink_bridge import messages as m


@pytest.fixture
def station() -> Station:
    return Station().boot()


def test_texts_go_only_to_links_that_hear_a_ground_station_but_events_to_all(station: Station) -> None:
    station.clear()
    station.command(MODE, 1.0, 99.0)
    assert station.texts(ONBOARD) == station.texts(GCS) == []
    assert station.all(m.Event, ONBOARD)
    assert station.all(m.Event, ONBOARD) == station.all(m.Event, GCS)
    station.send(m.Heartbeat(18, 8, 0, 0, 4))  # an onboard controller is no ground station
    station.command(MODE, 1.0, 99.0)
    assert station.texts(ONBOARD) == []
    station.send(m.Heartbeat(6, 8, 0, 0, 4), GCS)
    station.command(MODE, 1.0, 99.0)
    assert station.texts(GCS) == ["Unsupported main mode"]
    assert station.texts(ONBOARD) == []


def test_a_long_text_comes_in_chunks_of_50_that_end_in_a_tab(station: Station) -> None:
    station.send(m.Heartbeat(6, 8, 0, 0, 4))
    station.command(MODE, *POSITION_MODE)
    station.clear()
    assert station.command(ARM, 1.0) == [1]
    chunks = station.all(m.Statustext)
    assert [(chunk.text, chunk.chunk_seq) for chunk in chunks] == [
        ("Arming denied: Resolve system health failures firs", 0),
        ("t\t", 1),
    ]
    assert chunks[0].id == chunks[1].id
    assert chunks[0].severity == 2


def test_events_are_numbered_without_gaps_and_can_be_had_again(station: Station) -> None:
    station.command(ARM, 1.0)
    station.command(ARM, 0.0)
    station.run(3.1)
    numbers = [event.sequence for event in station.all(m.Event)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert station.last(m.CurrentEventSequence).sequence == numbers[-1]
    again = station.all(m.Event)[2:4]
    station.clear()
    station.send(m.RequestEvent(1, 1, 3, 4))
    station.run(0.01)
    assert station.all(m.Event) == again
    station.send(m.RequestEvent(1, 1, 999, 65535))
    station.run(0.01)
    assert [error.sequence for error in station.all(m.ResponseEventError)] == [999]


def test_every_message_of_the_table_with_zeros_and_with_ones_is_survived(station: Station) -> None:
    link = station.links[ONBOARD]
    for row in m.MESSAGES:
        for fill in (b"\0", b"\1", b"\x7f", b"\xff"):
            event = row.decode(fill * row.size, 0)
            if event is not None:
                link.send(event)
    for data in link.datagrams_to_send():
        station.server.receive(ONBOARD, data)
        station.server.receive(GCS, data)
    station.run(0.2)
    assert math.isfinite(station.vehicle.plant.truth().pos_ned_m[2])


def test_random_payloads_in_every_message_are_survived(station: Station) -> None:
    rng = random.Random(7)
    link = station.links[ONBOARD]
    for _ in range(60):
        for row in m.MESSAGES:
            payload = bytearray(rng.randbytes(row.size))
            for at, field in enumerate(row.layout.fields):
                if field.name in ("target_system", "target_component") and rng.random() < 0.9:
                    payload[sum(f.size for f in row.layout.fields[:at])] = 1
            event = row.decode(bytes(payload), 0)
            if event is not None:
                link.send(event)
        for data in link.datagrams_to_send():
            station.server.receive(rng.choice((ONBOARD, GCS)), data)
        station.tick()
    assert math.isfinite(station.vehicle.plant.truth().pos_ned_m[2])


@pytest.mark.parametrize("value", HOSTILE)
@pytest.mark.parametrize("command", [176, 400, 22, 21, 20, 246, 510, 511, 512, 410, 519, 520])
def test_commands_with_hostile_parameters_are_survived(station: Station, command: int, value: float) -> None:
    station.command(command, *(value,) * 7)
    station.send(m.CommandInt(1, 1, 5, command, 0, 0, (value, value, value, value, 2**31 - 1, -(2**31), value)))
    station.run(0.05)
    assert not station.state.armed


def test_the_same_inputs_give_the_same_bytes() -> None:
    def flight() -> bytes:
        station = airborne()
        out = bytearray()
        for _ in range(250):
            station.send(station.stream)
            station.server.advance(4)
            out += b"".join(station.server.datagrams(ONBOARD) + station.server.datagrams(GCS))
        return bytes(out)

    assert flight() == flight()


def test_a_longer_step_gives_the_same_vehicle_time_and_slower_streams() -> None:
    station = Station()
    for _ in range(100):
        station.server.advance(20)
        station.collect()
    assert station.server.t_us == 2_000_000
    assert len(station.all(m.Attitude)) == 100
    assert len(station.all(m.LocalPositionNed)) == pytest.approx(50, abs=11)
