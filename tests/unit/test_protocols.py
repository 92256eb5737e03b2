"""Parameters, clocks, missions and files of the simulated vehicle; the oracle is a real PX4, measured."""

from __future__ import annotations

import pytest
from station import (
    GCS,
    ONBOARD,
    Station,
)

from mavlink_bridge import messages as m


@pytest.fixture
def station() -> Station:
    return Station().boot()


def read(station: Station, name: str, index: int = -1) -> None:
    station.clear()
    station.send(m.ParamRequestRead(1, 1, name, index))
    station.run(0.01)


def test_an_integer_parameter_is_bit_cast_into_the_float(station: Station) -> None:
    read(station, "NAV_RCL_ACT")
    value = station.last(m.ParamValue)
    assert (value.param_id, value.param_type, value.bits) == ("NAV_RCL_ACT", 6, 2)
    read(station, "", value.param_index)
    assert station.last(m.ParamValue) == value
    read(station, "COM_OF_LOSS_T")
    assert (station.last(m.ParamValue).param_type, station.last(m.ParamValue).bits) == (9, 0x3F800000)


@pytest.mark.parametrize(("name", "index"), [("NO_SUCH_PARAM", -1), ("", 5000), ("", 32767), ("\xff\xfe", -1)])
def test_an_unknown_parameter_gets_an_error_and_no_value(station: Station, name: str, index: int) -> None:
    read(station, name, index)
    assert station.all(m.ParamValue) == []
    error = station.last(m.ParamError)
    assert (error.target_system, error.target_component, error.error) == (245, 190, 1)


def test_a_set_parameter_acts_and_is_told_on_every_link_once(station: Station) -> None:
    station.clear()
    station.send(m.ParamSet(1, 1, "COM_OF_LOSS_T", m.param_bits(0.5, 9), 9))
    station.run(0.01)
    for link in (ONBOARD, GCS):
        assert [value.value for value in station.all(m.ParamValue, link)] == [0.5]
    assert station.vehicle.params.get("COM_OF_LOSS_T") == 0.5


@pytest.mark.parametrize(
    ("name", "bits", "type_", "error"),
    [
        ("NO_SUCH", 0, 9, 1),
        ("NAV_DLL_ACT", 0, 9, 7),
        ("COM_OF_LOSS_T", 1, 6, 7),
        ("COM_OF_LOSS_T", 1, 77, 7),
        ("COM_OF_LOSS_T", 0x7FC00000, 9, 2),
        ("COM_OF_LOSS_T", 0x7F800000, 9, 2),
        ("NAV_DLL_ACT", 0x7FFFFFFF, 6, 2),
        ("NAV_DLL_ACT", 0xFFFFFFFF, 6, 2),
    ],
)
def test_a_bad_parameter_value_gets_an_error_and_changes_nothing(
    station: Station, name: str, bits: int, type_: int, error: int
) -> None:
    version = station.vehicle.params.version
    station.clear()
    station.send(m.ParamSet(1, 1, name, bits, type_))
    station.run(0.01)
    assert [message.error for message in station.all(m.ParamError)] == [error]
    assert station.all(m.ParamValue) == station.all(m.ParamValue, GCS) == []
    assert station.vehicle.params.version == version


def test_the_parameter_list_begins_with_the_hash_and_is_whole(station: Station) -> None:
    station.clear()
    station.send(m.ParamRequestList(1, 1))
    station.run(1.0)
    items = station.all(m.ParamValue)
    assert (items[0].param_id, items[0].param_type, items[0].param_index) == ("_HASH_CHECK", 5, 65535)
    assert [item.param_index for item in items[1:]] == list(range(len(station.vehicle.params)))
    assert all(item.param_count == len(items) - 1 for item in items)
    names = [item.param_id for item in items[1:]]
    assert names == sorted(names)
    before = items[0].bits
    read(station, "_HASH_CHECK")
    assert station.last(m.ParamValue).bits == before
    station.send(m.ParamSet(1, 1, "COM_OF_LOSS_T", m.param_bits(2.0, 9), 9))
    read(station, "_HASH_CHECK")
    assert station.last(m.ParamValue).bits != before


def test_a_timesync_question_is_answered_with_boot_time(station: Station) -> None:
    station.clear()
    station.send(m.Timesync(0, 123456789))
    now_ns = station.server.t_us * 1000
    station.run(0.01)
    answers = [message for message in station.all(m.Timesync) if message.tc1_ns]
    assert answers == [m.Timesync(now_ns, 123456789, 245, 190)]
    station.clear()
    station.send(m.Timesync(5, 6))  # an answer: no business of ours
    station.run(0.01)
    assert [message for message in station.all(m.Timesync) if message.tc1_ns] == []


def test_a_ping_to_all_comes_back_to_its_sender(station: Station) -> None:
    station.clear()
    station.send(m.Ping(77, 5, 0, 0))
    station.send(m.Ping(78, 6, 1, 1))
    station.run(0.01)
    assert [ping for ping in station.all(m.Ping) if ping.target_system] == [m.Ping(77, 5, 245, 190)]


def test_a_file_request_is_refused_at_once(station: Station) -> None:
    station.clear()
    payload = bytes([7, 0, 3, 4, 5, 0, 0, 0, 0, 0, 0, 0]) + b"/etc\0"  # open "/etc" for reading, sequence 7, session 3
    station.send(m.FileTransferProtocol(0, 1, 1, payload.ljust(251, b"\0")))
    station.run(0.01)
    answer = station.last(m.FileTransferProtocol).payload
    assert (answer[0], answer[2], answer[3], answer[4], answer[5], answer[12]) == (8, 3, 129, 1, 4, 10)
