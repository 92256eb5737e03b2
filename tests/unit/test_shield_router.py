"""The shield's router against the simulated PX4, in memory: what passes, what is made safe, who has the last word."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from shield_rig import NAN, SITE, Rig, attitude, inside, position, rates, velocity

from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.cli import files
from flightstack.cli.sensors import error_statistics
from flightstack.cli.shield import ShieldOptions, shield_stack
from flightstack.cli.shield_router import ShieldRouter
from flightstack.cli.vehicle_site import unknowing
from flightstack.geodesy import PX4_SIH
from flightstack.site.file import parse_site
from flightstack.site.shape import Site
from flightstack_sim.grade import load_grade
from flightstack_sim.server import Server
from flightstack_sim.simulated_vehicle import simulated_vehicle
from flightstack_sim.streams import LinkKind
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.dead_man_frames import ACTIVE, IN_OFFBOARD, NOBODY
from mavlink_bridge.framing import CRC, MAGIC_V1, ONE_BYTE, build_frame, mcrf4xx
from mavlink_bridge.layout import CRC_EXTRAS
from mavlink_bridge.link import Link
from mavlink_bridge.messages import BY_ID
from mavlink_bridge.requests import set_mode
from mavlink_bridge.voice import Voice
from tests.branches import branching
from tests.thorough import ONLY_THEN


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("site") / "room.toml"
    path.write_text(SITE)
    return path


@pytest.fixture(scope="module")
def router(site: Path) -> ShieldRouter:
    """That has heard no vehicle."""
    return ShieldRouter(*shield_stack(ShieldOptions(connect="udpin::1", serve="udpin::2", site=site), None))


@pytest.fixture(scope="module")
def risen(site: Path) -> Rig:
    made = Rig(site)
    made.take_off()
    assert -made.places[-1][2] == pytest.approx(2.0, abs=0.15)
    made.places.clear()
    return made


@pytest.fixture
def rig(risen: Rig, request: pytest.FixtureRequest) -> Rig:
    """Hovering; every test branches off from there."""
    branching(request)
    return risen


def test_nothing_that_is_asked_for_leads_out(rig: Rig) -> None:
    """Velocity, position, rates, attitude, one after the other."""
    for wish in (velocity(4.0, 2.5, 0.0), position(30.0, -20.0, -9.0), rates(0.0, -0.3, 0.5), attitude(-0.6, 0.55)):
        changed, began = rig.router.score.changed, rig.places[-1] if rig.places else np.array([0.0, 0.0, -2.0])
        rig.say = lambda wish=wish: wish  # type: ignore[misc]
        rig.run(5.0)
        assert inside(rig.places)
        assert rig.router.score.changed > changed
        assert np.linalg.norm(rig.places[-1] - began) > 0.5
        rig.say = lambda: position(0.0, 0.0, -2.0)
        rig.run(4.0)


def test_a_program_that_dies_is_stopped_held_and_handed_over(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[float] = []
    stay = Voice.stay
    monkeypatch.setattr(Voice, "stay", lambda voice, *words: (told.append(words[1]), stay(voice, *words))[1])
    rig.say = lambda: velocity(2.0, 0.0, 0.0)
    rig.run(1.0)
    rig.say = lambda: None
    rig.run(4.0)
    assert np.linalg.norm(rig.vehicle.plant.vel_ned_mps) < 0.2
    assert rig.server.commander.state.mode.title == "Offboard"
    rig.run(3.0)
    assert rig.router.score.handed_over
    assert told[0] > 0.2  # PX4's Hold begins from the attitude and thrust that are
    assert rig.server.commander.state.mode.title != "Offboard"
    assert inside(rig.places)


def test_the_pilot_has_it(rig: Rig) -> None:
    """Hold, selected by somebody while the program goes on: the router does not take it back."""
    rig.command(*(lambda r: (r[0], *r[1]))(set_mode(px4.MODE_HOLD)))
    rig.say = lambda: velocity(2.0, 0.0, 0.0)
    rig.run(2.0)
    assert rig.server.commander.state.mode.title != "Offboard"
    assert np.linalg.norm(rig.places[-1] - rig.places[0]) < 0.3


def test_a_place_on_the_globe_is_flown_to(rig: Rig) -> None:
    """3 m north and 5 m east of PX4's origin: the first is reached, the second is behind the wall."""
    lat, lon = PX4_SIH.to_globe(float(rig.start[0]) + 3.0, float(rig.start[1]) + 5.0)
    mask, unset = 0b1001_1111_1000, (NAN,) * 3
    rig.say = lambda: m.SetPositionTargetGlobalInt(0, 1, 1, 6, mask, lat, lon, 2.0, unset, yaw_rad=0.0)
    rig.run(7.0)
    assert inside(rig.places)
    np.testing.assert_allclose(rig.places[-1][[0, 2]], [3.0, -2.0], atol=0.3)
    assert rig.places[-1][1] > 2.5


def in_hold_and_back(rig: Rig, place: tuple[float, float, float]) -> None:
    """Flown past the router to a place, in PX4's Hold, then OFFBOARD again by a program that wants to go north."""
    direct, passed = Link(250, 1), rig.router.step
    rig.router.step = lambda now_us: []  # type: ignore[method-assign]
    rig.say = lambda: direct.send(position(*(rig.start + place).tolist()))
    for _ in range(150):
        rig.run(0.04)
        for data in direct.datagrams_to_send():
            rig.server.receive(0, data)
    rig.say, rig.router.step = lambda: attitude(-0.4, 0.5), passed  # type: ignore[method-assign]
    rig.command(*(lambda r: (r[0], *r[1]))(set_mode(px4.MODE_HOLD)))
    rig.run(1.0)
    rig.places.clear()
    rig.command(*(lambda r: (r[0], *r[1]))(set_mode(px4.MODE_OFFBOARD)))


def test_offboard_that_is_entered_beside_a_wall_stops_and_holds(rig: Rig) -> None:
    """No way out is clear there, and what the program wants is not flown for that."""
    in_hold_and_back(rig, (4.75, 0.0, -2.0))
    rig.run(3.0)
    assert rig.server.commander.state.mode.title == "Offboard"
    assert inside(rig.places)


def test_the_site_stays_where_it_is_after_a_landing(rig: Rig) -> None:
    """Landed 3 m north of the start, armed again: the wall is not 3 m farther."""
    rig.say = lambda: position(3.0, 0.0, -2.0)
    rig.run(4.0)
    rig.command(*(lambda r: (r[0], *r[1]))(set_mode(px4.MODE_LAND)))
    rig.run(9.0)
    assert not rig.server.commander.state.armed
    start = rig.start.copy()
    rig.take_off()
    rig.start = start
    rig.places.clear()
    rig.say = lambda: velocity(4.0, 0.0, 0.0)
    rig.run(4.0)
    assert rig.places[-1][0] > 3.5
    assert inside(rig.places)


def test_all_but_setpoints_passes_byte_for_byte(rig: Rig) -> None:
    frames = []
    for message in (m.Heartbeat(6, 8, 0, 0, 4), m.ParamRequestRead(1, 1, "THR_MDL_FAC", -1)):
        rig.program.send(message)
    frames = rig.program.datagrams_to_send()
    for data in (*frames, b"no MAVLink at all", b"".join(frames)):
        assert rig.router.from_program(data, rig.now_us) == [data]
    rig.program.send(rates(0.0, 0.0, 0.5))
    mixed = frames[0] + rig.program.datagrams_to_send()[0] + frames[1]
    assert rig.router.from_program(mixed, rig.now_us) == [frames[0] + frames[1]]


def frame_of(message: object, *, flags: int = 0) -> bytes:
    row = BY_ID[m.id_of(type(message))]
    return build_frame(bytes(row.encode(message)), row.id, row.crc_extra, 7, 245, 190, flags)


def version_1(frame: bytes) -> bytes:
    """The same frame as MAVLink 1 has it."""
    size, number = frame[1], frame[7]
    payload = frame[10 : 10 + size].ljust(39, b"\0")
    body = bytes([len(payload), frame[4], frame[5], frame[6], number]) + payload
    return bytes([MAGIC_V1]) + body + CRC.pack(mcrf4xx(body + ONE_BYTE[CRC_EXTRAS[number]]))


TURN = rates(1.0, 0.0, 0.5)
WHOLE = frame_of(TURN)


HIDING = build_frame(b"\1" * 7 + WHOLE, 385, CRC_EXTRAS[385], 0, 245, 190)  # a TUNNEL with a setpoint in its payload


def read_by_px4(stream: bytes) -> list[int]:
    """Ids of the frames that MAVLink's C parser finds in a byte stream: a broken frame costs all that it spans."""
    found, at = [], 0
    while at + 12 <= len(stream):
        first, size = stream[at], stream[at + 1]
        if first == 0xFD and stream[at + 2] <= 1:
            number, crc_at = int.from_bytes(stream[at + 7 : at + 10], "little"), at + 10 + size
            end = crc_at + 2 + 13 * stream[at + 2]
        elif first == MAGIC_V1:
            number, crc_at = stream[at + 5], at + 6 + size
            end = crc_at + 2
        else:
            at += 1
            continue
        said = stream[at + 1 : crc_at] + ONE_BYTE[CRC_EXTRAS.get(number, 0)]
        if end <= len(stream) and mcrf4xx(said) == CRC.unpack_from(stream, crc_at)[0]:
            found.append(number)
        at = end
    return found


@pytest.mark.parametrize(
    "data",
    [
        (WHOLE,),
        (frame_of(TURN, flags=1) + bytes(13),),
        (version_1(WHOLE),),
        (WHOLE[:9], WHOLE[9:]),
        (frame_of(m.SetAttitudeTarget(0, 0, 0, 128, (1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.5)),),
        (frame_of(m.SetAttitudeTarget(0, 9, 1, 128, (1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.5)),),
        (build_frame(b"\1" * 43, 139, CRC_EXTRAS[139], 0, 245, 190),),
        (bytes([0xFD, 5, 0, 0, 0, 0, 0, 0, 0, 0]) + HIDING,),
    ],
    ids=["plain", "signed", "version 1", "in pieces", "broadcast", "elsewhere", "actuators", "behind half a frame"],
)
def test_no_setpoint_gets_past_the_router(router: ShieldRouter, data: tuple[bytes, ...]) -> None:
    """PX4 reads datagrams as one stream of bytes; and no vehicle was heard yet."""
    assert set(read_by_px4(b"".join(data))) & {82, 139}
    assert read_by_px4(b"".join(b"".join(router.from_program(part, 0)) for part in data)) in ([], [385])


def test_what_is_no_setpoint_passes_whole(router: ShieldRouter) -> None:
    """Frames of any dialect among them; a payload that looks like a setpoint is none."""
    foreign = build_frame(b"\2" * 9, 54_321, 17, 0, 245, 190)
    for data in (HIDING, foreign, b"no MAVLink at all", frame_of(m.Heartbeat(6, 8, 0, 0, 4)) + foreign + HIDING):
        assert router.from_program(data, 0) == [data]


def test_a_router_that_sees_nothing_any_more_says_nothing_so_that_the_dead_man_answers(rig: Rig) -> None:
    """The streams stop, not by the program, whose word would be noticed: setpoints on an old attitude are worse than
    none."""
    assert (rig.router.flies, rig.router.has_spoken) == (True, True)
    rig.stop(m.AttitudeQuaternion, m.HighresImu, m.LocalPositionNed)
    rig.run(0.16)
    assert (rig.router.flies, rig.router.has_spoken) == (True, False)
    record = rig.router.last_word(0)
    assert record.flags == ACTIVE | IN_OFFBOARD
    assert record.thrust_norm > 0.2
    rig.run(3.0)  # the router asks for its streams again
    assert rig.router.has_spoken


def test_what_ends_the_router_hands_over_to_hold(rig: Rig) -> None:
    assert not rig.router.hand_over(rig.now_us)
    rig.run(0.2)
    assert rig.router.hand_over(rig.now_us)
    assert rig.router.view.custom_mode == px4.MODE_HOLD


@ONLY_THEN
def test_a_powerful_vehicle_stays_below_the_ceiling_and_holds_its_height(site: Path, tmp_path: Path) -> None:
    """Room to turn rotors once left no thrust below the weight: it climbed for as long as it was held."""
    powerful = tmp_path / "powerful.toml"
    text = files.load_vehicle("px4-sihsim-quadx")[1].text
    assert "max_thrust_n = 5.0" in text
    powerful.write_text(text.replace("max_thrust_n = 5.0", "max_thrust_n = 10.0"))
    rig = Rig(site, str(powerful))
    rig.take_off()
    rig.say = lambda: velocity(0.0, 0.0, -2.0)
    rig.run(4.0)
    assert 3.5 < -min(place[2] for place in rig.places) < 5.0
    before_m = -rig.places[-1][2]
    rig.say = lambda: None
    rig.run(4.0)
    assert -rig.places[-1][2] == pytest.approx(before_m, abs=0.3)


def test_without_its_dead_man_the_router_hands_over(rig: Rig) -> None:
    """A stock PX4 goes on with the last body rates for a second: the next stall would have nobody to answer it."""
    rig.router.hear_dead_man(NOBODY, "the dead-man's process has ended")
    rig.run(0.3)
    assert rig.router.view.custom_mode == px4.MODE_HOLD
    assert rig.router.score.handed_over


@pytest.mark.parametrize(("worse", "obeyed"), [(1.0, True), (1.6, False)])
def test_where_satellites_are_lost_and_the_estimate_is_the_worse_the_program_is_not_obeyed(
    rig: Rig, worse: float, obeyed: bool
) -> None:
    """A site means nothing by an estimate that runs away; beside motion capture nobody misses satellites."""
    rig.stop(m.GpsRawInt, m.EstimatorStatus)  # the vehicle's own; others are told in their place
    told, fix, accuracy_m = Link(1, 1), 3, 0.29

    def say() -> m.SetPositionTargetLocalNed:
        told.send(m.GpsRawInt(0, fix, 47.4, 8.5, 489.0, 0.7, 1.1, 0.0, 0.0, 10))
        told.send(m.EstimatorStatus(0, 1023, 0.1, 0.1, 0.1, 0.1, 0.1, NAN, accuracy_m, 0.2))
        for data in told.datagrams_to_send():
            rig.router.from_vehicle(data, rig.now_us)
        return velocity(1.0, 0.0, 0.0)

    rig.say = say
    rig.run(1.0)
    fix, accuracy_m = 0, 0.29 * worse
    rig.run(0.4)
    assert rig.router.view.in_offboard
    rig.run(0.4)
    assert rig.router.view.in_offboard is obeyed
    assert obeyed or rig.router.view.custom_mode == px4.MODE_HOLD
    assert rig.router.score.handed_over is not obeyed


def test_fixes_that_another_station_has_stopped_are_asked_for_again(rig: Rig) -> None:
    """Satellites that nobody tells of can't be seen to be lost."""
    rig.run(0.5)
    rig.stop(m.GpsRawInt)
    rig.heard.clear()
    rig.run(1.0)
    assert not [message for message in rig.heard if isinstance(message, m.GpsRawInt)]
    rig.run(1.0)
    assert [message for message in rig.heard if isinstance(message, m.GpsRawInt)]


REPLACED = int(os.environ.get("FLIGHTSTACK_REPLACED", "12"))
"""How often; docs/site.md tells of a hundred."""


def _room(north_m: float = 5.0, east_m: float = 4.0, ceiling_m: float = 5.0) -> Site:
    corners = f"[{north_m:.3f}, -4.0], [{north_m:.3f}, {east_m:.3f}], [-5.0, {east_m:.3f}]"
    text = SITE.replace("[5.0, -4.0], [5.0, 4.0], [-5.0, 4.0]", corners)
    return parse_site(text.replace("ceiling_m = 5.0", f"ceiling_m = {ceiling_m:.3f}"), "other.toml")


def test_a_site_that_is_replaced_in_flight_is_kept_from_then_on_or_refused(
    site: Path, record_property: Callable[[str, object], None]
) -> None:
    """Walls and a ceiling are put before a vehicle that goes on as fast as it may: taken, none is passed; refused, the
    old one holds."""
    rig = Rig(site)
    rig.take_off()
    rng, room, refused = np.random.default_rng(6), np.array([5.0, 4.0, 5.0]), 0
    taken: list[float] = []
    for _ in range(REPLACED):
        speed = rng.uniform(-5.0, 5.0, 3) * (1.0, 1.0, 0.4)
        rig.say = lambda speed=speed: velocity(*-speed)  # type: ignore[misc]
        rig.run(1.5)
        rig.say = lambda speed=speed: velocity(*speed)  # type: ignore[misc]
        rig.run(float(rng.uniform(0.2, 1.8)))
        began, ahead = len(rig.places), rng.uniform(0.1, (5.0, 5.0, 3.0))
        walls = np.minimum(rig.places[-1] * (1.0, 1.0, -1.0) + ahead, room)
        said = rig.router.replace_site(_room(*walls.tolist()))
        rig.run(1.5)
        flown = (np.array(rig.places[began:]) * (1.0, 1.0, -1.0)).max(axis=0)
        if said:
            assert "clear of its" in said
            refused += 1
            assert (flown < room).all()
        else:
            taken.append(float((walls - flown).min()))
            assert (flown < walls).all()
        assert rig.router.replace_site(_room()) == ""
    assert len(taken) >= REPLACED // 4
    assert refused >= REPLACED // 4
    assert min(taken) < 1.0  # it went on to the wall
    assert rig.router.score.sites_replaced == REPLACED + len(taken)
    record_property("walls", f"{len(taken)} taken, nearest {min(taken):.2f} m; {refused} refused")


def test_a_site_without_room_is_not_taken_and_none_before_the_vehicle_is_known(router: ShieldRouter, rig: Rig) -> None:
    assert router.replace_site(_room()).endswith("not known yet")
    flat = parse_site(SITE.replace("ceiling_m = 5.0", "ceiling_m = 0.35"), "flat.toml")
    assert rig.router.replace_site(flat).startswith("flat.toml: no room for the 1.2")
    beside = parse_site(SITE.replace("[5.0,", "[-3.0,"), "beside.toml")
    assert "clear of its edge" in rig.router.replace_site(beside)
    rig.run(1.0)
    assert rig.router.score.sites_replaced == 0


def test_a_vehicle_that_knows_less_than_the_margins_count_on_ends_it_before_it_is_armed(site: Path) -> None:
    """With GPS the shield of a user who left out `--sensors` kept the margins of mocap, and said nothing."""
    rig = Rig(site)
    rig.vehicle = simulated_vehicle(rig.believed, rig.believed, load_grade("gps"), seed=0)
    rig.server = Server(rig.vehicle, links=(LinkKind.ONBOARD,))
    bounds = estimate_bounds(error_statistics(load_grade("mocap")))
    made = shield_stack(ShieldOptions(connect="udpin::1", serve="udpin::2", site=site), None)
    rig.router = ShieldRouter(*made, None, lambda view: unknowing(view, bounds, "mocap"))
    rig.say = lambda: position(0.0, 0.0, -2.0)
    rig.run(3.0)
    assert rig.router.ended.startswith("the vehicle says that it knows its position")
    assert not rig.router.flies


def test_the_answers_to_the_routers_own_clock_questions_are_kept_from_the_program(rig: Rig) -> None:
    """Those to the program's pass, and the vehicle's questions."""
    rig.heard.clear()
    rig.program.send(m.Timesync(0, 4242, 1, px4.COMPONENT_AUTOPILOT))
    rig.run(2.0)
    clock = [message for message in rig.heard if isinstance(message, m.Timesync)]
    assert {message.ts1_ns for message in clock if message.tc1_ns} == {4242}
    assert len([message for message in clock if not message.tc1_ns]) > 10
