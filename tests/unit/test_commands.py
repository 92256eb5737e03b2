"""Commands to the simulated vehicle and their acknowledgements; the oracle is a real PX4, measured."""

from __future__ import annotations

import math

import pytest
from station import (
    ARM,
    GCS,
    HOLD_MODE,
    MODE,
    OFFBOARD_MODE,
    ONBOARD,
    POSITION_MODE,
    Station,
)

from mavlink_bridge import messages as m


@pytest.fixture
def station() -> Station:
    return Station().boot()


def test_do_set_mode_has_two_acknowledgements_the_second_is_the_verdict(station: Station) -> None:
    assert station.command(MODE, *HOLD_MODE) == [0, 0]
    assert station.command(MODE, *OFFBOARD_MODE) == [0, 0]
    assert station.command(MODE, 129.0, 4.0, 3.0) == [0, 0]  # as MAVSDK sends it
    assert station.command(MODE, 1.0, 99.0) == [0, 1]
    assert station.command(ARM, 1.0) == [0]
    assert station.command(MODE, *OFFBOARD_MODE) == [0, 1]
    assert station.command(MODE, *POSITION_MODE) == [0, 1]


def test_an_acknowledgement_names_the_requester_and_goes_to_its_link_only() -> None:
    station = Station(system=17, component=33, link_index=GCS)
    station.command(519)
    ack = station.last(m.CommandAck)
    assert ack == m.CommandAck(519, 0, 0, 0, 17, 33)
    assert station.all(m.CommandAck, ONBOARD) == []


def test_legacy_set_mode_has_one_acknowledgement_for_176(station: Station) -> None:
    station.send(m.SetMode(1, 1, 0x00060000))
    station.run(0.02)
    assert station.all(m.CommandAck) == [m.CommandAck(176, 0, 0, 0, 245, 190)]
    assert station.state.mode.title == "Offboard"


def test_command_int_is_taken_in_frame_5_and_refused_in_any_other(station: Station) -> None:
    for frame, results in ((5, [0, 0]), (3, [9]), (0, [9]), (6, [9])):
        station.clear()
        station.send(m.CommandInt(1, 1, frame, MODE, 0, 0, (1.0, 4.0, 3.0, 0.0, 0, 0, 0.0)))
        station.run(0.02)
        assert [ack.result for ack in station.all(m.CommandAck)] == results


@pytest.mark.parametrize("command", [31999, 192, 2000, 65535, 1])
def test_an_unknown_command_is_unsupported(station: Station, command: int) -> None:
    assert station.command(command) == [3]


@pytest.mark.parametrize("target", [(9, 1), (1, 2), (2, 0), (0, 191)])
def test_a_command_for_somebody_else_gets_silence(station: Station, target: tuple[int, int]) -> None:
    assert station.command(ARM, 1.0, target=target) == []
    assert not station.state.armed


@pytest.mark.parametrize("target", [(1, 1), (1, 0), (0, 0), (0, 1)])
def test_broadcast_targets_are_taken(station: Station, target: tuple[int, int]) -> None:
    assert station.command(ARM, 0.0, target=target) == [0]


def test_reboot_is_denied(station: Station) -> None:
    assert station.command(246, 1.0) == [2]


@pytest.mark.parametrize("number", [148, 300, 242, 397, 395, 436, 264, 230, 245, 147, 33, 49, 0, 30])
def test_a_message_asked_for_comes_before_its_acknowledgement(station: Station, number: int) -> None:
    station.clear()
    assert station.command(512, float(number)) == [0]
    names = [type(message) for _, message in station.heard[ONBOARD]]
    assert m.BY_ID[number].event in names[: names.index(m.CommandAck)]


@pytest.mark.parametrize("number", [259, 410, 411, 77, 12345, 65000, -1, math.inf])
def test_a_message_that_is_not_to_be_had_is_denied(station: Station, number: float) -> None:
    assert station.command(512, float(number)) == [2]


def test_a_fix_that_was_sent_already_is_denied() -> None:
    station = Station(grade="gps").boot()
    station.command(512, 24.0)
    assert station.command(512, 24.0) == [2]


def test_all_26_modes_are_listed_on_request_or_one_by_its_index(station: Station) -> None:
    station.command(512, 435.0, 0.0)
    listed = station.all(m.AvailableModes)
    assert [mode.mode_index for mode in listed] == list(range(1, 27))
    assert all(mode.number_modes == 26 for mode in listed)
    station.clear()
    assert station.command(512, 435.0, 11.0) == [0]
    assert [(mode.custom_mode, mode.mode_name) for mode in station.all(m.AvailableModes)] == [(393216, "Offboard")]
    assert station.command(512, 435.0, 27.0) == [2]


@pytest.mark.parametrize(
    ("command", "event"), [(519, m.ProtocolVersion), (520, m.AutopilotVersion), (410, m.HomePosition)]
)
def test_old_request_commands_give_their_message(station: Station, command: int, event: type) -> None:
    station.clear()
    assert station.command(command, 1.0) == [0]
    assert station.all(event)


def test_the_version_is_px4s(station: Station) -> None:
    station.command(512, 148.0)
    version = station.last(m.AutopilotVersion)
    assert (version.capabilities, version.flight_sw_version, version.uid) == (0xE8FF, 0x01120040, 5283920058631409231)
    station.command(512, 300.0)
    protocol = station.last(m.ProtocolVersion)
    assert (protocol.version, protocol.min_version, protocol.max_version) == (200, 100, 203)


def test_an_arm_command_with_2_gets_no_acknowledgement_but_words(station: Station) -> None:
    station.heartbeat_every_us = 1_000_000
    station.run(1.1)
    assert station.command(ARM, 2.0) == []
    assert station.texts()[-1] == "Unsupported ARM_DISARM param: 2.000"
