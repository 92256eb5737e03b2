"""Missions, fences and rally points over MAVLink; the oracle is a real PX4 (1.18, SIH), asked the same on the wire."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from flightstack.cli.vehicle_site import Questions, as_plan
from flightstack.site.file import parse_site
from flightstack_sim.autopilot.requests import Sender
from flightstack_sim.fence import allowed, shapes_of
from flightstack_sim.plan_transfer import PlanTransfer
from flightstack_sim.plans import Item, Plans
from mavlink_bridge import messages as m
from mavlink_bridge.link import Link
from tests.unit.station import ONBOARD, Station

LAT, LON = 473_977_420, 85_455_940
MISSION, FENCE, RALLY = 0, 1, 2
WAYPOINT, LAND, TAKEOFF = 16, 21, 22
M_PER_E7_NORTH = 6_371_000.0 * math.radians(1e-7)
M_PER_E7_EAST = M_PER_E7_NORTH * math.cos(math.radians(47.397742))
NAN = math.nan

Words = tuple[int, dict[str, Any]]


def item(command: int, **given: Any) -> Words:
    return command, given


def place(north_m: float, east_m: float) -> dict[str, int]:
    return {"x": LAT + round(north_m / M_PER_E7_NORTH), "y": LON + round(east_m / M_PER_E7_EAST)}


def message(seq: int, words: Words, kind: int) -> m.MissionItemInt:
    command, given = words
    params = (*given.get("p", (0.0,) * 4), given.get("x", LAT), given.get("y", LON), given.get("z", 10.0))
    return m.MissionItemInt(1, 1, seq, given.get("frame", 6), command, 0, 1, params, kind)


def upload(station: Station, items: list[Words], kind: int = MISSION) -> int | None:
    """As a client does it; the type of the acknowledgement."""
    station.clear()
    station.send(m.MissionCount(1, 1, len(items), kind))
    for _ in range(len(items) + 5):
        station.tick()
        if acks := station.all(m.MissionAck):
            assert acks[0].mission_type == kind
            return acks[0].type
        asked = station.all(m.MissionRequestInt)[-1]
        assert (asked.target_system, asked.target_component, asked.mission_type) == (245, 190, kind)
        station.send(message(asked.seq, items[asked.seq], kind))
    return None


def download(station: Station, kind: int = MISSION) -> list[m.MissionItemInt]:
    station.clear()
    station.send(m.MissionRequestList(1, 1, kind))
    station.tick()
    count = station.last(m.MissionCount).items
    for seq in range(count):
        station.send(m.MissionRequestInt(1, 1, seq, kind))
        station.tick()
    station.send(m.MissionAck(1, 1, 0, kind))
    station.tick()
    return station.all(m.MissionItemInt)


def ring(*corners: tuple[float, float], command: int = 5001, count: int | None = None) -> list[Words]:
    p = (float(len(corners) if count is None else count), 0.0, 0.0, 0.0)
    return [item(command, p=p, frame=0, z=0.0, **place(*corner)) for corner in corners]


SQUARE = ((-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0))


@pytest.fixture(scope="module")
def station() -> Station:
    return Station().boot()


@pytest.mark.parametrize(
    ("answer", "items"),
    [
        (0, [item(TAKEOFF), item(WAYPOINT), item(WAYPOINT), item(LAND, z=0.0)]),
        (3, [item(WAYPOINT), item(4242)]),
        (0, [item(TAKEOFF), item(WAYPOINT, x=910_000_000)]),
        (0, [item(TAKEOFF), item(WAYPOINT, z=NAN)]),
        (0, [item(TAKEOFF), item(WAYPOINT, p=(NAN, 0.0, 0.0, 0.0))]),
        (0, [item(TAKEOFF), item(WAYPOINT, p=(math.inf, 0.0, 0.0, 0.0))]),
        (2, [item(TAKEOFF), item(WAYPOINT, frame=1)]),
        (0, [item(TAKEOFF), item(WAYPOINT, frame=3)]),
        (2, [item(TAKEOFF), item(WAYPOINT, frame=10)]),
        (2, [item(TAKEOFF), item(WAYPOINT, frame=99)]),
        (3, [item(TAKEOFF), item(WAYPOINT, frame=2)]),
        (0, [item(178, p=(1.0, 5.0, -1.0, 0.0), frame=2)]),
        (3, [item(TAKEOFF), item(18, p=(1.0, 0.0, 0.0, 0.0))]),
        (0, [item(TAKEOFF), item(177, p=(9.0, 2.0, 0.0, 0.0), frame=2), item(WAYPOINT)]),
        (1, ring(*SQUARE)[:1]),
    ],
)
def test_missions_get_px4s_answers(station: Station, answer: int, items: list[Words]) -> None:
    assert upload(station, items) == answer


@pytest.mark.parametrize(
    ("answer", "items"),
    [
        (0, ring(*SQUARE)),
        (0, ring((-50.0, -50.0), (50.0, 50.0), (50.0, -50.0), (-50.0, 50.0))),
        (1, ring(*SQUARE[:2])),
        (0, ring(*SQUARE, count=5)),
        (0, ring(*SQUARE[:3], count=4)),
        (0, [*ring(*SQUARE), *ring((0.0, 0.0), (0.0, 5.0), (5.0, 5.0), command=5002)]),
        (0, [item(5003, p=(30.0, 0.0, 0.0, 0.0), frame=0)]),
        (0, [item(5004, p=(-30.0, 0.0, 0.0, 0.0), frame=0)]),
        (0, [item(5004, p=(NAN, 0.0, 0.0, 0.0), frame=0)]),
        (0, [item(WAYPOINT)]),
        (4, ring(*SQUARE * 30, count=120)),
    ],
)
def test_fences_get_px4s_answers(station: Station, answer: int, items: list[Words]) -> None:
    assert upload(station, items, FENCE) == answer


def test_rally_points_get_px4s_answers(station: Station) -> None:
    assert upload(station, [item(5100, z=20.0)], RALLY) == 0
    assert upload(station, [item(5100, z=20.0)] * 40, RALLY) == 4
    assert upload(station, [item(WAYPOINT)], RALLY) == 0


def test_what_was_stored_comes_back(station: Station) -> None:
    items = [item(TAKEOFF, z=5.0), item(178, p=(1.0, 2.0, -1.0, 0.0), frame=2, x=7, y=0), item(LAND, z=0.0)]
    assert upload(station, items) == 0
    assert upload(station, ring(*SQUARE), FENCE) == 0
    assert [got._replace(target_system=1, target_component=1, current=0) for got in download(station)] == [
        message(seq, words, MISSION) for seq, words in enumerate(items)
    ]
    fence = download(station, FENCE)
    assert [got.frame for got in fence] == [5] * 4  # PX4 gives integers back in the frame of integers
    assert [got.params for got in fence] == [message(0, words, FENCE).params for words in ring(*SQUARE)]
    for kind in (MISSION, FENCE):
        station.send(m.MissionClearAll(1, 1, kind))
    assert download(station) == download(station, FENCE) == []


ASKED = ((1.0, 2.0, 3.0, 4.0), (0.4, -1.0, -50.0, 370.0), (NAN, NAN, NAN, NAN), (7.6, 3.0, 0.0, -30.0))


@pytest.mark.parametrize(
    ("kind", "command", "frame", "given", "back"),
    [
        (MISSION, 16, 6, 0, (1, 2, 0, 4)), (MISSION, 16, 6, 1, (0.4, -1, 0, 10)), (MISSION, 16, 0, 3, (7.6, 3, 0, 330)),
        (MISSION, 16, 6, 2, (NAN, NAN, 0, NAN)), (MISSION, 17, 6, 1, (0, 0, -50, 10)),
        (MISSION, 19, 6, 0, (1, 1, 3, 1)), (MISSION, 19, 6, 1, (0.4, 0, -50, 1)), (MISSION, 19, 6, 2, (NAN, 0, NAN, 0)),
        (MISSION, 21, 6, 1, (0, 65535, 0, 10)), (MISSION, 21, 6, 2, (0, 0, 0, NAN)),
        (MISSION, 21, 6, 3, (0, 3, 0, 330)),
        (MISSION, 22, 6, 1, (0, 0, 0, 10)), (MISSION, 84, 6, 0, (0, 0, 0, 4)), (MISSION, 85, 6, 3, (0, 0, 0, 330)),
        (MISSION, 31, 6, 1, (1, -1, 0, 1)), (MISSION, 31, 6, 3, (1, 3, 0, 0)), (MISSION, 195, 6, 0, (0, 0, 0, 0)),
        (MISSION, 178, 2, 1, (0.4, -1, -50, 370)), (MISSION, 177, 2, 1, (0, 65535, -50, 370)),
        (MISSION, 177, 2, 3, (7, 3, 0, -30)), (FENCE, 5001, 6, 3, (8, 0, 0, 0)), (FENCE, 5003, 6, 3, (7.6, 0, 0, 0)),
        (FENCE, 16, 6, 3, (7.6, 0, 0, 0)), (FENCE, 4501, 6, 3, (0, 0, 0, 0)), (RALLY, 5100, 3, 1, (0, 0, 0, 0)),
    ],
)  # fmt: skip
def test_a_download_gives_back_what_px4_keeps(
    station: Station, kind: int, command: int, frame: int, given: int, back: tuple[float, ...]
) -> None:
    """Each line was asked of a real PX4; unplaced coordinates have been through 32 bits, fences count from the sea."""
    assert upload(station, [item(command, frame=frame, p=ASKED[given], x=473_974_286, y=85_461_864)], kind) == 0
    (found,) = download(station, kind)
    assert found.params[:4] == pytest.approx(back, nan_ok=True)
    assert found.params[4:6] == ((473_974_272, 85_461_864) if frame == 2 else (473_974_286, 85_461_864))
    assert (found.frame, found.autocontinue) == (
        (5, 0) if kind == FENCE else (2 if frame == 2 else 5 if frame == 0 else 6, 1)
    )
    assert found.current == 1


def test_an_item_of_floats_does_not_count_in_whole_degrees() -> None:
    """UNSUPPORTED_FRAME, as a real PX4 answered: 5 and 6 are frames of MISSION_ITEM_INT."""
    for frame, answer in ((5, 2), (6, 2), (3, 0)):
        sender, transfer = Sender(0, 245, 190), PlanTransfer(Plans())
        transfer.handle(m.MissionCount(1, 1, 1, MISSION), sender, 0)
        given = m.MissionItem(1, 1, 0, frame, WAYPOINT, 0, 1, (0.0, 0.0, 0.0, 0.0, 47.39, 8.54, 10.0), MISSION)
        assert transfer.handle(given, sender, 0)[0].type == answer


@pytest.mark.parametrize(
    ("frame", "mode", "answer"), [(6, 0.4, 0), (6, 1.0, 6), (2, 1.0, 0), (2, 0.4, 0), (2, 3.0, 6), (2, NAN, 6)]
)
def test_a_region_of_interest_is_told_by_its_whole_number(
    station: Station, frame: int, mode: float, answer: int
) -> None:
    assert upload(station, [item(80, frame=frame, p=(mode, 0.0, 0.0, 0.0))]) == answer


def test_counts_beyond_all_bounds_and_kinds_that_are_none(station: Station) -> None:
    for kind, count, answer in ((MISSION, 65_535, 4), (7, 3, 4), (255, 3, 4), (MISSION, 0, 0)):
        station.clear()
        station.send(m.MissionCount(1, 1, count, kind))
        station.tick()
        assert [(ack.type, ack.mission_type) for ack in station.all(m.MissionAck)] == [(answer, kind)]
    for kind in (255, 7):
        station.clear()
        station.send(m.MissionClearAll(1, 1, kind))
        station.tick()
        assert [(ack.type, ack.mission_type) for ack in station.all(m.MissionAck)] == [(0, kind)]


def test_ten_thousand_items_are_a_mission() -> None:
    sender, plans = Sender(0, 245, 190), Plans()
    transfer = PlanTransfer(plans)
    answers = transfer.handle(m.MissionCount(1, 1, 10_000, MISSION), sender, 0)
    while isinstance(answers[0], m.MissionRequestInt):
        answers = transfer.handle(message(answers[0].seq, item(WAYPOINT), MISSION), sender, 0)
    assert answers[0].type == 0
    assert len(plans.mission) == 10_000


def test_wrong_sequences_are_passed_over_and_asked_for_again(station: Station) -> None:
    station.clear()
    station.send(m.MissionCount(1, 1, 3, MISSION))
    for seq in (2, 0, 0, 1, 2):
        station.send(message(seq, item(WAYPOINT), MISSION))
        station.run(0.6)
    asked = [request.seq for request in station.all(m.MissionRequestInt)]
    assert [asked.count(seq) > 1 for seq in range(3)] == [True] * 3  # every 0.25 s until it comes
    assert asked == sorted(asked)
    assert [ack.type for ack in station.all(m.MissionAck)] == [0]


def test_an_upload_that_breaks_off_is_given_up_after_five_seconds(station: Station) -> None:
    station.clear()
    station.send(m.MissionCount(1, 1, 3, MISSION))
    station.run(4.0)
    station.send(m.MissionRequestList(1, 1, MISSION))
    station.send(m.MissionClearAll(1, 1, MISSION))
    station.tick()
    assert station.all(m.MissionCount) == station.all(m.MissionAck) == []
    station.run(1.3)
    asked = len(station.all(m.MissionRequestInt))
    assert 15 <= asked <= 22
    station.run(1.0)
    assert len(station.all(m.MissionRequestInt)) == asked
    assert upload(station, [item(TAKEOFF)]) == 0


def test_requests_out_of_order_end_a_download(station: Station) -> None:
    assert upload(station, [item(TAKEOFF), item(WAYPOINT), item(WAYPOINT), item(LAND)]) == 0
    station.clear()
    station.send(m.MissionRequestInt(1, 1, 0, MISSION))
    station.send(message(0, item(WAYPOINT), MISSION))
    station.tick()
    assert station.all(m.MissionItemInt) == []
    assert [ack.type for ack in station.all(m.MissionAck)] == [1]
    station.send(m.MissionRequestList(1, 1, MISSION))
    for seq in (0, 1, 1, 3, 2):
        station.send(m.MissionRequestInt(1, 1, seq, MISSION))
        station.tick()
    assert [got.seq for got in station.all(m.MissionItemInt)] == [0, 1, 1]
    assert [ack.type for ack in station.all(m.MissionAck)] == [1, 1]


def test_hostile_numbers_raise_nothing(station: Station) -> None:
    numbers = (NAN, math.inf, -math.inf, 1e38, -1e38, -1.0)
    for number in numbers:
        for command in (WAYPOINT, 5001, 5003, 177, 80):
            for kind in (MISSION, FENCE, RALLY):
                upload(station, [item(command, p=(number,) * 4, z=number, frame=2)] * 3, kind)
                upload(station, [item(command, p=(number,) * 4, z=number)] * 3, kind)
                station.run(0.2)
    station.send(m.MissionClearAll(1, 1, 255))
    station.run(0.2)


@pytest.mark.parametrize(
    ("point", "inside"),
    [((0.0, 0.0), False), ((45.0, 0.0), True), ((-45.0, 0.0), True), ((0.0, 45.0), False), ((60.0, 0.0), False)],
)
def test_a_fence_that_crosses_itself_has_holes_by_the_even_odd_rule(point: tuple[float, float], inside: bool) -> None:
    """A bow tie north and south of its centre; the oracle is the drawing: the middle is where its lines cross."""
    bow = ((-50.0, -50.0), (50.0, 50.0), (50.0, -50.0), (-50.0, 50.0))
    shapes = shapes_of(tuple(Item(0, 5001, 1, (4.0, 0.0, 0.0, 0.0), n + 1e-9, e, 0.0) for n, e in bow))
    assert allowed(shapes, point[0] + 0.1 * inside, point[1] + (0.1 if not inside else 0.0)) is inside


def test_inclusions_add_up_and_exclusions_cut() -> None:
    def circle(command: int, lat: float, lon: float, radius_m: float) -> Item:
        return Item(0, command, 1, (radius_m, 0.0, 0.0, 0.0), lat, lon, 0.0)

    shapes = shapes_of((circle(5003, 0.0, 0.0, 50.0), circle(5003, 0.001, 0.0, 50.0), circle(5004, 0.0, 0.0, 10.0)))
    degree_m = math.radians(1.0) * 6_371_000.0
    assert [allowed(shapes, north_m / degree_m, 0.0) for north_m in (0.0, 11.0, 49.0, 55.0, 65.0, 112.0, 165.0)] == [
        False, True, True, False, True, True, False,
    ]  # fmt: skip


def test_a_fence_that_is_left_acts_as_px4s_does() -> None:
    """GF_ACTION 3: Hold for five seconds, then Return; a reposition beyond it is taken and not flown."""
    station = Station().boot()
    station.heartbeat_every_us = 1_000_000
    assert station.vehicle.params.set("GF_ACTION", 3.0) is not None
    assert upload(station, ring((8.0, -5.0), (12.0, -5.0), (12.0, 5.0), (8.0, 5.0), command=5002), FENCE) == 0
    station.run(1.1)
    assert station.command(TAKEOFF) == [0]
    assert station.command(400, 1.0) == [0]
    station.run(8.0)
    where = place(25.0, 0.0)
    station.clear()
    station.send(m.CommandInt(1, 1, 5, 192, 0, 0, (-1.0, 1.0, 0.0, NAN, where["x"], where["y"], 492.0)))
    station.run_until(lambda: station.state.in_failsafe, 8.0)
    assert 8.0 < station.vehicle.plant.pos_ned_m[0] < 9.0
    assert "Geofence: approaching or outside geofence" in station.texts()
    assert station.state.mode.title == "Hold"
    station.run_until(lambda: station.state.mode.title == "Return", 5.2)
    inside = place(10.0, 0.0)
    station.clear()
    station.send(m.CommandInt(1, 1, 5, 192, 0, 0, (-1.0, 1.0, 0.0, NAN, inside["x"], inside["y"], 492.0)))
    station.run(0.1)
    assert [ack.result for ack in station.all(m.CommandAck)] == [0]
    assert "Reposition is outside geofence" in station.texts()
    assert station.state.mode.title == "Return"


def test_a_fence_without_home_is_no_fence() -> None:
    station = Station().boot()
    station.heartbeat_every_us = 1_000_000
    station.run(1.1)
    assert upload(station, ring((300.0, 300.0), (400.0, 300.0), (400.0, 400.0)), FENCE) == 0
    station.run(0.3)
    assert "Geofence invalid, doesn't contain Home position" in station.texts()
    assert station.server.fence.shapes == ()


def test_a_stored_fence_is_read_back_as_a_site(station: Station) -> None:
    """A square to stay in, a triangle and a circle to keep out of; the lengths are those that were drawn."""
    circle = item(5004, p=(7.0, 0.0, 0.0, 0.0), frame=0, z=0.0, **place(20.0, -20.0))
    hole = ring((0.0, 10.0), (0.0, 15.0), (5.0, 15.0), command=5002)
    assert upload(station, [*ring(*SQUARE), *hole, circle], FENCE) == 0
    questions = Questions(Link(240, 191), fence=True)
    for _ in range(500):
        station.server.advance(4)
        for data in station.server.datagrams(ONBOARD):
            questions.link.receive_datagram(data, station.server.t_us)
        for received in questions.link.take_events():
            questions.take(received, station.server.t_us)
        questions.step(station.server.t_us)
        for data in questions.link.datagrams_to_send():
            station.server.receive(ONBOARD, data)
        if questions.is_answered:
            break
    assert questions.place is not None
    np.testing.assert_allclose(questions.place, (1e-7 * LAT, 1e-7 * LON), atol=1e-4)
    flat = parse_site(as_plan(questions.shapes), "vehicle.plan").local(1e-7 * LAT, 1e-7 * LON)
    np.testing.assert_allclose(flat.inside, SQUARE, atol=0.02)
    triangle, solid = flat.keep_outs
    np.testing.assert_allclose(triangle.polygon, [[0.0, 10.0], [0.0, 15.0], [5.0, 15.0]], atol=0.02)
    assert solid.radius_m == 7.0
    np.testing.assert_allclose(solid.centre, (20.0, -20.0), atol=0.02)
