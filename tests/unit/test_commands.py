"""Commands to the simulated vehicle and their acknowledgements; the oracle is a real PX4, measured."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from station import (
    ARM,
    GCS,
    HOLD_MODE,
    HOSTILE,
    MODE,
    OFFBOARD_MODE,
    ONBOARD,
    POSITION_MODE,
    RETURN,
    Station,
    airborne,
)

from mavlink_bridge import messages as m
from tests.branches import branching
from tests.thorough import thorough


@pytest.fixture(scope="module")
def booted() -> Station:
    return Station().boot()


@pytest.fixture
def station(booted: Station, request: pytest.FixtureRequest) -> Station:
    branching(request)
    return booted


@pytest.fixture(scope="module")
def holding() -> Station:
    return _flying_in_hold()


@pytest.fixture
def in_hold(holding: Station, request: pytest.FixtureRequest) -> Station:
    branching(request)
    return holding


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


@pytest.mark.parametrize("command", [31999, 193, 2000, 65535, 1])
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


# --- commands with a place ---

INT32_MAX = 2**31 - 1
REPOSITION, ORBIT, SPEED, SET_HOME = 192, 34, 178, 179
METRE_DEG7 = 1e7 / 111_194.9
"""A metre north in 1e-7 degrees, on a sphere of 6371 km."""


def _int(station: Station, command: int, *params: float, frame: int = 5) -> list[int]:
    """The results of a COMMAND_INT's acknowledgements."""
    station.clear()
    station.send(m.CommandInt(1, 1, frame, command, 0, 0, params))  # type: ignore[arg-type]
    station.run(0.04)
    return [ack.result for ack in station.all(m.CommandAck) if ack.command == command]


def _flying_in_hold() -> Station:
    station = airborne()
    station.command(MODE, *HOLD_MODE)
    station.stream = None
    station.run(2.0)
    return station


def _here(station: Station) -> tuple[int, int, float]:
    lat, lon = station.server.view.frame.latitude_deg, station.server.view.frame.longitude_deg
    return round(lat * 1e7), round(lon * 1e7), station.server.view.frame.altitude_m


@pytest.mark.parametrize("frame", [0, thorough(3), thorough(5), 6, thorough(11)])
def test_reposition_flies_there_whatever_global_frame_says_it_altitude_above_the_sea(
    in_hold: Station, frame: int
) -> None:
    """MAVSDK sends goto_location in frame 0, set_home in 3, both with altitudes above the sea, as PX4 takes them."""
    station = in_hold
    lat, lon, alt = _here(station)
    yaw = 1.0
    target = (lat + round(6.0 * METRE_DEG7), lon, alt + 4.0)
    assert _int(station, REPOSITION, -1.0, 1.0, math.nan, yaw, *target, frame=frame) == [0]
    station.run(10.0)
    north, east, down = station.last(m.LocalPositionNed).pos_ned_m
    assert (north, east, down) == pytest.approx((6.0, 0.0, -4.0), abs=0.3)
    assert station.last(m.Attitude).yaw_rad == pytest.approx(yaw, abs=0.1)
    assert station.state.mode.title == "Hold"


def test_what_a_reposition_leaves_out_stays_as_it_is(in_hold: Station) -> None:
    station = in_hold
    before = station.last(m.LocalPositionNed).pos_ned_m
    nothing = (-1.0, 1.0, math.nan, math.nan, INT32_MAX, INT32_MAX, math.nan)
    assert _int(station, REPOSITION, *nothing) == [0]
    station.run(3.0)
    assert station.last(m.LocalPositionNed).pos_ned_m == pytest.approx(before, abs=0.4)


def test_reposition_without_leave_to_change_the_mode_leaves_offboard_alone() -> None:
    station = airborne()
    lat, lon, alt = _here(station)
    assert _int(station, REPOSITION, -1.0, 0.0, math.nan, math.nan, lat, lon, alt + 3.0) == [0]
    assert station.state.mode.title == "Offboard"


def test_reposition_as_a_command_long_takes_degrees(in_hold: Station) -> None:
    station = in_hold
    view = station.server.view.frame
    place = (view.latitude_deg + 5.0 * METRE_DEG7 * 1e-7, view.longitude_deg, view.altitude_m + 3.0)
    assert station.command(REPOSITION, -1.0, 1.0, math.nan, math.nan, *place) == [0]
    station.run(9.0)
    assert station.last(m.LocalPositionNed).pos_ned_m[0] == pytest.approx(5.0, abs=1.0)  # a float's degrees: 0.4 m


@pytest.mark.parametrize("frame", [1, 2, 7, 8, 12, 20, 255])
def test_frames_that_are_not_on_the_globe_are_refused(station: Station, frame: int) -> None:
    for command in (REPOSITION, ORBIT, SET_HOME):
        assert _int(station, command, 0.0, 1.0, 0.0, 0.0, 0, 0, 0.0, frame=frame) == [9]


@pytest.mark.parametrize("place", [(910000000, 0, 500.0), (0, 1810000000, 500.0), (-(2**31), -(2**31), 0.0)])
def test_a_place_that_is_not_on_the_globe_is_denied(station: Station, place: tuple[int, int, float]) -> None:
    for command in (REPOSITION, ORBIT, SET_HOME):
        assert _int(station, command, 0.0, 1.0, 0.0, 0.0, *place) == [2]


@pytest.mark.parametrize(("radius", "turns"), [(4.0, 1.0), (-4.0, -1.0)])
def test_an_orbit_is_a_circle_at_the_speed_asked_for_facing_its_centre(
    in_hold: Station, radius: float, turns: float
) -> None:
    """Clockwise for a positive radius; one round of 4 m at 2 m/s takes 12.6 s."""
    station = in_hold
    lat, lon, alt = _here(station)
    assert _int(station, ORBIT, radius, 2.0, 0.0, math.nan, lat, lon, alt + 3.0) == [0]
    station.run(8.0)
    assert station.state.mode.title == "Orbit"
    station.clear()
    station.run(12.6)
    places = np.array([message.pos_ned_m for message in station.all(m.LocalPositionNed)])
    distance = np.hypot(places[:, 0], places[:, 1])
    assert distance == pytest.approx(np.full(len(places), 4.0), abs=0.6)
    angles = np.unwrap(np.arctan2(places[:, 1], places[:, 0]))
    assert angles[-1] - angles[0] == pytest.approx(turns * 2.0 * math.pi, rel=0.05)
    yaw, last = station.last(m.Attitude).yaw_rad, places[-1]
    to_centre = math.atan2(-last[1], -last[0])
    assert abs(math.remainder(yaw - to_centre, 2.0 * math.pi)) < 0.3


def test_the_speed_asked_for_is_flown_and_forgotten_again(in_hold: Station) -> None:
    station = in_hold
    lat, lon, alt = _here(station)
    assert station.command(SPEED, 1.0, 1.5, -1.0) == [0]
    assert _int(station, REPOSITION, -1.0, 1.0, math.nan, math.nan, lat + round(20 * METRE_DEG7), lon, alt + 2.5) == [0]
    station.run(8.0)
    speeds = [math.hypot(*message.vel_ned_mps[:2]) for message in station.all(m.LocalPositionNed)]
    assert max(speeds) == pytest.approx(1.5, abs=0.15)
    assert station.command(SPEED, 1.0, -1.0, -1.0) == [0]
    station.run(3.0)
    assert math.hypot(*station.last(m.LocalPositionNed).vel_ned_mps[:2]) > 2.5  # MPC_XY_CRUISE 5 m/s


def test_home_is_where_a_client_says_and_return_goes_there(in_hold: Station) -> None:
    station = in_hold
    lat, lon, alt = _here(station)
    assert _int(
        station, SET_HOME, 0.0, math.nan, math.nan, math.nan, lat + round(5 * METRE_DEG7), lon, alt, frame=3
    ) == [0]
    station.command(512, 242.0)
    home = station.last(m.HomePosition)
    assert home.pos_ned_m == pytest.approx((5.0, 0.0, 0.0), abs=0.05)
    station.command(RETURN)
    station.run(12.0)
    assert station.last(m.LocalPositionNed).pos_ned_m[:2] == pytest.approx((5.0, 0.0), abs=0.5)


def test_home_here_or_nowhere(in_hold: Station) -> None:
    station = in_hold
    assert station.command(SET_HOME, 1.0) == [0]
    station.command(512, 242.0)
    here = station.last(m.LocalPositionNed).pos_ned_m
    assert station.last(m.HomePosition).pos_ned_m == pytest.approx(here, abs=0.3)
    assert _int(station, SET_HOME, 0.0, 0.0, 0.0, 0.0, INT32_MAX, 0, 489.0) == [2]
    assert _int(station, SET_HOME, 0.0, 0.0, 0.0, 0.0, 0, 0, math.nan) == [2]


def test_a_goal_or_circle_that_can_not_be_flown_is_refused_in_words(in_hold: Station) -> None:
    station = in_hold
    station.heartbeat_every_us = 1_000_000
    station.run(1.1)
    lat, lon, alt = _here(station)
    station.vehicle.sensors.position_valid = False
    station.run(0.3)
    for command, words in ((REPOSITION, "Reposition command rejected"), (ORBIT, "Orbit command rejected")):
        assert _int(station, command, -1.0, 1.0, math.nan, math.nan, lat, lon, alt) == [1]
        assert words in station.texts()
    assert _int(station, SET_HOME, 1.0, 0.0, 0.0, 0.0, lat, lon, alt) == [1]


def test_the_origin_can_be_asked_for_by_wishing_another() -> None:
    station = Station().boot()
    station.clear()
    station.send(m.SetGpsGlobalOrigin(1, 47.0, 8.0, 500.0))
    station.run(0.02)
    origin = station.last(m.GpsGlobalOrigin)
    assert (origin.lat_deg, origin.lon_deg) == pytest.approx((47.397742, 8.545594), abs=1e-6)  # where it is and stays


@pytest.mark.parametrize("command", [REPOSITION, ORBIT, SPEED, SET_HOME])
@pytest.mark.parametrize("value", HOSTILE)
def test_hostile_numbers_are_answered_and_survived(command: int, value: float) -> None:
    station = _hostile_station()
    assert len(station.command(command, *[value] * 7)) == 1
    assert len(_int(station, command, value, value, value, value, INT32_MAX - 1, -INT32_MAX, value)) == 1
    station.run(0.2)
    assert math.isfinite(station.last(m.LocalPositionNed).pos_ned_m[0])


@cache
def _hostile_station() -> Station:
    return _flying_in_hold()
