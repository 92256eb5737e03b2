"""Missions as they are flown; what is said and in which order is a real PX4's (1.18, SIH), which flew the same one."""

from __future__ import annotations

import math

import pytest

from mavlink_bridge import messages as m
from tests.unit.station import HOLD_MODE, Station
from tests.unit.test_plans import LAND, TAKEOFF, WAYPOINT, item, place, ring, upload

START, MODE = 300, 176
MISSION_MODE = (1.0, 4.0, 4.0)
SPEED = item(178, p=(1.0, 2.0, -1.0, 0.0), frame=2)
NAN = math.nan


def ready() -> Station:
    station = Station().boot()
    station.heartbeat_every_us = 1_000_000
    station.run(1.1)
    return station


def at(station: Station) -> tuple[float, float, float]:
    north, east, down = station.vehicle.plant.pos_ned_m.tolist()
    return north, east, down


def test_a_mission_is_flown_paused_resumed_and_ends_on_the_ground() -> None:
    station = ready()
    mission = [
        item(TAKEOFF, z=5.0, **place(0.0, 0.0)), item(WAYPOINT, z=5.0, **place(20.0, 0.0)), SPEED,
        item(WAYPOINT, z=8.0, p=(2.0, 0.0, 0.0, 90.0), **place(20.0, 10.0)),
        item(93, p=(3.0, -1.0, -1.0, -1.0), frame=2), item(19, z=5.0, p=(3.0, 0.0, 0.0, 0.0), **place(10.0, 10.0)),
        item(LAND, z=0.0, **place(0.0, 5.0)),
    ]  # fmt: skip
    assert upload(station, mission) == 0
    station.run(1.1)
    current = station.last(m.MissionCurrent)
    assert (current.seq, current.total, current.mission_state, current.mission_mode) == (0, 7, 2, 2)
    station.clear()
    assert station.command(START, 0.0, 0.0) == [0]
    station.run(0.2)
    assert station.texts() == ["Armed by mission start", "Executing Mission", "Climb to 5.0 meters above home"]
    station.run_until(lambda: station.server.plans.current == 3, 25.0)
    assert at(station)[0] == pytest.approx(18.0, abs=0.3)  # NAV_ACC_RAD
    assert {one.seq for one in station.all(m.MissionItemReached)} >= {0}
    assert station.command(MODE, *HOLD_MODE) == [0, 0]
    station.run(4.0)
    assert station.last(m.MissionCurrent)[:4] == (3, 7, 4, 2)
    assert 18.0 < at(station)[0] < 24.0  # 5 m/s, braked at 0.7 of 3 m/s^2
    assert station.command(MODE, *MISSION_MODE) == [0, 0]
    station.run(0.2)
    assert station.texts()[-2:] == ["Executing Mission", "Climb to 8.0 meters above home"]
    station.run_until(lambda: at(station)[1] > 5.0, 15.0)
    assert math.hypot(*station.vehicle.plant.vel_ned_mps[:2]) < 2.1
    station.run_until(lambda: station.server.plans.current == 4, 15.0)
    began = station.server.t_us
    station.run_until(lambda: station.server.plans.current == 5, 5.0)
    assert (station.server.t_us - began) * 1e-6 == pytest.approx(3.0, abs=0.01)
    station.run_until(lambda: not station.state.armed, 40.0)
    assert math.dist(at(station)[:2], (0.0, 5.0)) < 1.0
    assert [one.seq for one in station.all(m.MissionItemReached)][-1] == 6
    station.run(1.1)
    assert station.last(m.MissionCurrent).mission_state == 5


def test_a_mission_that_does_not_land_ends_in_hold_and_one_that_returns_in_return() -> None:
    station = ready()
    mission = [item(TAKEOFF, z=3.0), item(WAYPOINT, z=3.0, p=(0.0, 0.0, 0.0, NAN), **place(8.0, 0.0))]
    assert upload(station, mission) == 0
    station.run(0.2)
    assert station.command(START, 0.0, 0.0) == [0]
    station.run_until(lambda: station.server.mission.finished, 20.0)
    station.run(0.1)
    assert station.state.mode.title == "Hold"
    assert upload(station, [*mission, item(177, p=(1.0, 2.0, 0.0, 0.0), frame=2), item(20, frame=2)]) == 0
    station.run(0.2)
    assert station.command(MODE, *MISSION_MODE) == [0, 0]
    station.run_until(lambda: station.state.mode.title == "Return", 20.0)
    assert [one.seq for one in station.all(m.MissionItemReached) if one.seq == 2]
    station.run_until(lambda: not station.state.armed, 60.0)


def test_the_current_item_can_be_chosen_and_a_mission_deleted_in_flight() -> None:
    station = ready()
    far = [item(WAYPOINT, z=4.0, **place(60.0, 0.0)), item(WAYPOINT, z=4.0, **place(0.0, 60.0))]
    assert upload(station, [item(TAKEOFF, z=4.0), *far]) == 0
    station.run(0.2)
    assert station.command(START, 0.0, 0.0) == [0]
    station.run_until(lambda: at(station)[0] > 5.0, 20.0)
    station.send(m.MissionSetCurrent(1, 1, 2))
    station.run_until(lambda: at(station)[1] > 5.0, 10.0)
    station.send(m.MissionClearAll(1, 1, 0))
    station.run(0.3)
    assert station.state.mode.title == "Hold"
    assert station.last(m.MissionCurrent) is not None
    station.run(1.0)
    assert station.last(m.MissionCurrent)[:3] == (0, 65_535, 1)


@pytest.mark.parametrize(
    ("mission", "said"),
    [
        ([], None),
        ([item(TAKEOFF), item(WAYPOINT, x=910_000_000)], "Mission rejected"),
        ([item(WAYPOINT), item(TAKEOFF)], "Mission rejected: takeoff not first waypoint item"),
        ([item(TAKEOFF), item(WAYPOINT, **place(60.0, 0.0))], "Geofence violation for waypoint 2"),
    ],
)
def test_what_can_not_be_flown_can_not_be_started(mission: list, said: str | None) -> None:
    station = ready()
    assert upload(station, ring((-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)), kind=1) == 0
    station.run(0.2)
    assert upload(station, mission) == 0
    station.run(0.3)
    assert said is None or any(said in text for text in station.texts())
    station.clear()
    assert station.command(START, 0.0, 0.0) == [2]
    assert "Mission start denied! No valid mission" in station.texts()
    assert station.command(MODE, *MISSION_MODE) == [0, 0]
    assert station.command(400, 1.0) == [1]
    station.run(1.0)
    assert station.last(m.MissionCurrent).mission_state == 1


def test_a_mission_of_nothing_but_jumps_does_not_stop_the_clock() -> None:
    station = ready()
    assert upload(station, [item(TAKEOFF, z=3.0), item(177, p=(1.0, -1.0, 0.0, 0.0), frame=2)]) == 0
    station.run(0.2)
    assert station.command(START, 0.0, 0.0) == [0]
    station.run(8.0)
    assert at(station)[2] < -2.0
