"""MAVSDK's timers run on the wall; the vehicle's own messages come at the same vehicle times all the same."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from flightstack.testkit import Px4Sim
from flightstack.testkit.px4_sim import Px4Options
from flightstack_sim.shell import ONBOARD

pytest.importorskip("mavsdk")
pytestmark = pytest.mark.client
FOUND_S, FLOWN_S = 6.0, 8.0
EVENT = "UNKNOWN_410"  # newer than this dialect; its sequence number is bytes 8 and 9
REPLIES = frozenset({
    "AUTOPILOT_VERSION", "COMMAND_ACK", "COMPONENT_METADATA", "FILE_TRANSFER_PROTOCOL", "PARAM_VALUE", "PING",
    "PROTOCOL_VERSION", "TIMESYNC",
})  # fmt: skip


def flight(kind: str, flown_s: float = FLOWN_S) -> list[tuple[int, str, bytes]]:
    """Found, armed and taken off by MAVSDK; what the vehicle said of itself: time (us), name, payload."""
    from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
    from mavsdk.asyncio.plugins.action import ActionAsync

    px4 = Px4Sim(Px4Options())

    async def run() -> None:
        async with Mavsdk(Configuration.create_with_component_type(ComponentType[kind])) as mavsdk:
            await mavsdk.add_any_connection(px4.mavsdk_address)
            px4.step(FOUND_S)
            system = await px4.call(mavsdk.first_autopilot(20.0))
            action = ActionAsync(system)
            await px4.call(action.arm())
            await px4.call(action.takeoff())
            px4.step(flown_s)

    try:
        asyncio.run(asyncio.wait_for(run(), 60.0))
        assert px4.now_s == pytest.approx(FOUND_S + flown_s, abs=0.01)
        assert px4.truth.pos_ned_m[2] < -2.0
        return own_messages(px4)
    finally:
        px4.close()


def own_messages(px4: Px4Sim) -> list[tuple[int, str, bytes]]:
    """All but replies; an event that was said before is one, to REQUEST_EVENT."""
    parser, said, told = mavlink.MAVLink(None), [], set[bytes]()
    for direction, t_us, link, data in px4.recording._datagrams:
        if direction == "rx" and link == ONBOARD:
            for message in parser.parse_buffer(data) or ():
                payload = bytes(message.get_msgbuf()[10:-2])
                if message.get_type() == EVENT:
                    if payload[8:10] in told:
                        continue
                    told.add(payload[8:10])
                if message.get_type() not in REPLIES:
                    said.append((t_us, message.get_type(), payload))
    return said


@pytest.mark.parametrize("kind", ["COMPANION_COMPUTER", "GROUND_STATION"])
def test_two_flights_by_mavsdk_say_the_same_at_the_same_times(kind: str) -> None:
    first: list[Any] = flight(kind)
    assert len({name for _, name, _ in first}) > 20
    assert len(first) > 3000
    assert flight(kind) == first


def test_a_ground_station_that_answers_is_not_lost_in_a_long_step() -> None:
    """Its heartbeats come once a second of the wall, in which the vehicle flies a minute; PX4 loses it after 10 s."""
    texts = b" ".join(payload for _, name, payload in flight("GROUND_STATION", 30.0) if name == "STATUSTEXT")
    assert b"Takeoff detected" in texts  # it is there: PX4 tells texts to ground stations only
    assert b"GCS connection" not in texts  # and was not lost meanwhile
