"""What the shield passes goes on before it is read: reading takes three times as long, and the rest would wait."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from flightstack.cli.shield_frames import is_one_frame
from flightstack.cli.shield_passing import Passing

TIMESYNC = 111
MAV = common.MAVLink(None, srcSystem=1, srcComponent=1)


def frame(message: Any, *, v1: bool = False, signed: bool = False) -> bytes:
    """By another codec than ours."""
    mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
    if signed:
        mav.signing.secret_key, mav.signing.sign_outgoing = b"k" * 32, True
    return bytes(message.pack(mav, force_mavlink1=v1))


ATTITUDE = common.MAVLink_attitude_quaternion_message(1, 1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3)
PLACE = common.MAVLink_local_position_ned_message(1, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
CLOCK = common.MAVLink_timesync_message(5, 7)


class Wire:
    """A link's two ends, and what happened in its order."""

    def __init__(self, name: str, events: list[str], waiting: list[bytes]) -> None:
        self.name, self.events, self.waiting = name, events, waiting

    def receive_all(self, most: int = 1000) -> list[bytes]:
        taken, self.waiting = self.waiting[:most], self.waiting[most:]
        return taken

    def send(self, data: bytes) -> bool:
        self.events.append(f"{self.name} {data!r}")
        return True


class Router:
    """Takes the vehicle's clock answers for its own, and a program's bytes as they are."""

    def __init__(self, events: list[str]) -> None:
        self.events = events

    def from_vehicle(self, data: bytes, now_us: int) -> list[bytes]:
        self.events.append(f"read {data!r}")
        return [] if data == frame(CLOCK) else [data]

    def from_program(self, data: bytes, now_us: int) -> list[bytes]:
        return [data]


def passed(vehicle: list[bytes], program: list[bytes]) -> tuple[list[str], Passing]:
    events: list[str] = []
    router: Any = Router(events)
    ends: Any = Wire("vehicle", events, vehicle), Wire("program", events, program)
    passing = Passing(router, *ends)
    passing.step(0, 0)
    return events, passing


def test_all_goes_on_before_any_is_read() -> None:
    plain, said = [frame(ATTITUDE), frame(PLACE), frame(ATTITUDE, v1=True)], [b"said"]
    events, passing = passed(plain, said)
    assert events == [
        *(f"program {data!r}" for data in plain),
        f"vehicle {said[0]!r}",
        *(f"read {data!r}" for data in plain),
    ]
    assert len(passing.latencies_us) == 1


@pytest.mark.parametrize("own", [frame(CLOCK), frame(ATTITUDE) + frame(CLOCK)])
def test_what_may_hold_the_routers_own_answer_is_read_first_and_in_its_order(own: bytes) -> None:
    before, after = frame(PLACE), frame(ATTITUDE)
    events, _ = passed([before, own, after], [])
    reads = [event for event in events if event.startswith("read")]
    assert reads == [f"read {data!r}" for data in (before, own, after)]
    sent = [event for event in events if event.startswith("program")]
    kept = [] if own == frame(CLOCK) else [own]
    assert sent == [f"program {data!r}" for data in (before, *kept, after)]


def test_nothing_that_came_is_no_latency() -> None:
    events, passing = passed([], [])
    assert (events, passing.latencies_us) == ([], [])


@pytest.mark.parametrize("v1", [False, True])
def test_one_frame_is_known_by_its_length_and_its_id(v1: bool) -> None:
    assert is_one_frame(frame(ATTITUDE, v1=v1), TIMESYNC)
    assert not is_one_frame(frame(CLOCK, v1=v1), TIMESYNC)
    assert not is_one_frame(frame(ATTITUDE, v1=v1) + b"\0", TIMESYNC)
    assert not is_one_frame(frame(ATTITUDE, v1=v1)[:-1], TIMESYNC)
    assert not is_one_frame(frame(ATTITUDE, v1=v1) + frame(CLOCK, v1=v1), TIMESYNC)
    assert not is_one_frame(b"", TIMESYNC)


def test_a_signature_is_part_of_its_frame() -> None:
    assert is_one_frame(frame(ATTITUDE, signed=True), TIMESYNC)
    assert not is_one_frame(frame(CLOCK, signed=True), TIMESYNC)
