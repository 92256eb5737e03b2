"""The client's side of a recorded PX4 exchange, played to the simulated vehicle; its answers beside PX4's own."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from station import ONBOARD, Station
from tlog import Heard, recording

from flightstack_sim import builders
from flightstack_sim.autopilot.params import find
from mavlink_bridge import messages as m

GROUND_US = 63_000_000
"""Until then the recorded vehicle stood on the ground; later the recorded setpoints answer to another flight."""
SETTLE_S = 22.0
"""The recording begins this long after boot."""


class Exchange(NamedTuple):
    """Both sides of the recording and our answers to its client."""

    theirs: list[Heard]
    ours: list[tuple[int, Any]]
    heartbeats: list[tuple[m.Heartbeat, set[m.Heartbeat]]]
    """(PX4's, ours at the same time and in the 20 ms before)"""


@pytest.fixture(scope="module")
def exchange(recorded: Path) -> Exchange:
    heard = [item for item in recording(recorded / "px4_sih_offboard.tlog") if item.t_us < GROUND_US]
    station = Station(grade="gps")
    station.run(SETTLE_S)
    station.clear()
    start_us, heartbeats = station.server.t_us, []
    lately: deque[m.Heartbeat] = deque(maxlen=5)
    for item in heard:
        while station.server.t_us - start_us < item.t_us:
            station.tick()
            lately.append(builders.heartbeat(station.server.view))
        if item.system != 1:
            station.server.receive(ONBOARD, item.frame)
        elif isinstance(item.message, m.Heartbeat):
            heartbeats.append((item.message, set(lately)))
    station.run(0.1)
    ours = [(t_us - start_us, message) for t_us, message in station.heard[ONBOARD]]
    return Exchange([item for item in heard if item.system == 1], ours, heartbeats)


def theirs(exchange: Exchange, kind: type) -> list[Any]:
    return [item.message for item in exchange.theirs if isinstance(item.message, kind)]


def ours(exchange: Exchange, kind: type) -> list[Any]:
    return [message for _, message in exchange.ours if isinstance(message, kind)]


def test_every_command_gets_px4s_acknowledgements_in_px4s_order(exchange: Exchange) -> None:
    assert len(theirs(exchange, m.CommandAck)) > 50
    assert ours(exchange, m.CommandAck) == theirs(exchange, m.CommandAck)


def test_every_heartbeat_on_the_ground_is_px4s(exchange: Exchange) -> None:
    assert len(exchange.heartbeats) > 55
    for expected, got in exchange.heartbeats:
        assert expected in got


def test_every_text_is_px4s(exchange: Exchange) -> None:
    def texts(messages: list[Any]) -> list[tuple[int, str, int]]:
        return [(t.severity, t.text, t.chunk_seq) for t in messages]

    assert texts(ours(exchange, m.Statustext)) == texts(theirs(exchange, m.Statustext))


def test_every_event_is_px4s(exchange: Exchange) -> None:
    def events(messages: list[Any]) -> list[tuple[int, int, bytes]]:
        return [(e.id, e.log_levels, e.arguments) for e in messages]

    assert events(ours(exchange, m.Event)) == events(theirs(exchange, m.Event))


def test_every_interval_read_is_px4s(exchange: Exchange) -> None:
    assert ours(exchange, m.MessageInterval) == theirs(exchange, m.MessageInterval)


def test_every_listed_mode_and_version_is_px4s(exchange: Exchange) -> None:
    assert ours(exchange, m.AvailableModes) == theirs(exchange, m.AvailableModes)
    got, expected = ours(exchange, m.AutopilotVersion)[0], theirs(exchange, m.AutopilotVersion)[0]
    assert got.capabilities == expected.capabilities
    assert got.flight_sw_version == expected.flight_sw_version
    assert ours(exchange, m.ProtocolVersion)[0][:3] == theirs(exchange, m.ProtocolVersion)[0][:3]


def test_parameters_that_do_not_exist_or_have_another_type_get_px4s_errors(exchange: Exchange) -> None:
    """PX4 has more parameters than we have, and names none where an index is too large; those answers may differ."""
    missing = 1
    expected = [(error.param_id, error.error) for error in theirs(exchange, m.ParamError)]
    comparable = [
        (name, error) for name, error in expected if name.isascii() and (find(name) is not None or error == missing)
    ]
    got = [(error.param_id, error.error) for error in ours(exchange, m.ParamError)]
    assert len(comparable) == 3
    assert [pair for pair in got if pair in comparable] == comparable
    assert all(find(name) is None and error == missing for name, error in got if (name, error) not in comparable)


def test_parameters_that_both_have_are_of_the_same_type(exchange: Exchange) -> None:
    types = {value.param_id: value.param_type for value in theirs(exchange, m.ParamValue)}
    checked = [value for value in ours(exchange, m.ParamValue) if value.param_id in types]
    assert len(checked) > 50
    for value in checked:
        assert value.param_type == types[value.param_id], value.param_id


def test_empty_missions_are_px4s(exchange: Exchange) -> None:
    assert ours(exchange, m.MissionCount) == theirs(exchange, m.MissionCount)
    assert ours(exchange, m.MissionAck) == theirs(exchange, m.MissionAck)


def test_the_clock_is_answered_like_px4(exchange: Exchange) -> None:
    expected = [answer for answer in theirs(exchange, m.Timesync) if answer.tc1_ns]
    got = [answer for answer in ours(exchange, m.Timesync) if answer.tc1_ns]
    assert [a.ts1_ns for a in got] == [a.ts1_ns for a in expected]
    assert [(a.target_system, a.target_component) for a in got] == [
        (a.target_system, a.target_component) for a in expected
    ]
