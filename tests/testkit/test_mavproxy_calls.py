"""What MAVProxy sends for `wp load`, `wp list`, `fence load`, `fence list`, `mode`, `arm throttle`, in its order.

MAVProxy 1.8's mission_item_protocol.py: the count; each item when it is asked for; to list, the list's request, each
item's request, the acknowledgement.  Modes go out by pymavlink's own table for PX4.
"""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from flightstack.testkit import Px4Sim

LAT, LON = 473_977_420, 85_455_940
M_NORTH_E7 = 1e7 * math.degrees(1.0 / 6_371_000.0)
MISSION, FENCE = mavlink.MAV_MISSION_TYPE_MISSION, mavlink.MAV_MISSION_TYPE_FENCE
Item = tuple[int, float, int, int, float]  # command, first parameter, latitude, longitude, height
NORTH = LAT + round(10.0 * M_NORTH_E7)
PLAN: list[Item] = [(22, 0.0, LAT, LON, 5.0), (16, 0.0, NORTH, LON, 5.0), (21, 0.0, NORTH, LON, 0.0)]
CORNERS = ((-1, -1), (-1, 1), (1, 1), (1, -1))
SQUARE: list[Item] = [(5001, 4.0, LAT + a * 10_000, LON + b * 10_000, 0.0) for a, b in CORNERS]


def expect(client: Any, *kinds: str, **given: Any) -> Any:
    message = client.recv_match(type=list(kinds), blocking=True, timeout=2.0, **given)
    assert message is not None, f"no {kinds}"
    return message


def load(client: Any, items: list[Item], kind: int) -> None:
    client.mav.mission_count_send(1, 1, len(items), kind)
    for number in range(len(items)):
        asked = expect(client, "MISSION_REQUEST", "MISSION_REQUEST_INT")
        assert (asked.seq, asked.mission_type) == (number, kind)
        command, first, lat, lon, height = items[number]
        frame = 6 if kind == MISSION else 3
        client.mav.mission_item_int_send(
            1, 1, number, frame, command, 0, 1, first, 0.0, 0.0, math.nan, lat, lon, height, kind
        )  # fmt: skip
    acknowledged = expect(client, "MISSION_ACK")
    assert (acknowledged.type, acknowledged.mission_type) == (mavlink.MAV_MISSION_ACCEPTED, kind)


def listed(client: Any, kind: int) -> list[Item]:
    client.mav.mission_request_list_send(1, 1, kind)
    items = []
    for number in range(expect(client, "MISSION_COUNT").count):
        client.mav.mission_request_int_send(1, 1, number, kind)
        item = expect(client, "MISSION_ITEM_INT")
        assert (item.seq, item.mission_type) == (number, kind)
        items.append((item.command, item.param1, item.x, item.y, item.z))
    client.mav.mission_ack_send(1, 1, mavlink.MAV_MISSION_ACCEPTED, kind)
    return items


def command(client: Any, number: int, *params: float) -> None:
    client.mav.command_long_send(1, 1, number, 0, *params, *(0.0,) * (7 - len(params)))
    answer = expect(client, "COMMAND_ACK", condition=f"COMMAND_ACK.command=={number}")
    assert answer.result == mavlink.MAV_RESULT_ACCEPTED


def mode(client: Any, name: str) -> None:
    command(client, mavlink.MAV_CMD_DO_SET_MODE, *mavutil.px4_map[name])


def test_a_mission_is_loaded_listed_fenced_armed_and_flown(px4_sim: Px4Sim) -> None:
    client = px4_sim.connect()
    px4_sim.step(5.0)
    load(client, PLAN, MISSION)
    assert listed(client, MISSION) == [pytest.approx(item, abs=1.0) for item in PLAN]
    load(client, SQUARE, FENCE)
    assert listed(client, FENCE) == [pytest.approx(item, abs=1.0) for item in SQUARE]
    mode(client, "LOITER")
    command(client, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    mode(client, "MISSION")
    assert px4_sim.step_until(lambda: float(px4_sim.truth.pos_ned_m[0]) > 9.0, 40.0)
    assert px4_sim.truth.pos_ned_m[2] == pytest.approx(-5.0, abs=0.5)
    assert px4_sim.step_until(lambda: not px4_sim.armed, 40.0)
    assert px4_sim.truth.pos_ned_m[0] == pytest.approx(10.0, abs=0.5)
