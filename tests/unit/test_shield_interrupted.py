"""The shield's router where vehicle or program are interrupted: they restart, fall silent, come back, send nonsense."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from shield_rig import NAN, SITE, Rig, inside, position, rates, velocity

from flightstack.geodesy import PX4_SIH
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.link import Link
from mavlink_bridge.requests import set_mode
from tests.branches import branching
from tests.thorough import thorough

INF = float("inf")
LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("site") / "room.toml"
    path.write_text(SITE)
    return path


@pytest.fixture(scope="module")
def risen(site: Path) -> Rig:
    made = Rig(site)
    made.take_off()
    made.places.clear()
    return made


@pytest.fixture
def rig(risen: Rig, request: pytest.FixtureRequest) -> Rig:
    """Hovering; every test branches off from there."""
    branching(request)
    return risen


def select(rig: Rig, mode: int) -> None:
    number, params = set_mode(mode)
    rig.command(number, *params)


def test_a_vehicle_that_restarted_is_not_flown_by_what_was_known_of_it(rig: Rig) -> None:
    """Its stamps are older than the last ones and were not taken: a thrust that carried it was asked for on and on, by
    the place where it had landed, and it climbed through the ceiling to 62 m."""
    select(rig, px4.MODE_LAND)
    rig.run(8.0)
    assert not rig.server.commander.state.armed
    rig.boot()
    rig.places.clear()
    rig.start = rig.vehicle.plant.pos_ned_m.copy()
    rig.run(6.0)
    select(rig, px4.MODE_OFFBOARD)
    rig.run(0.3)
    rig.command(px4.Cmd.COMPONENT_ARM_DISARM, 1.0)
    rig.run(3.0)
    assert max(-place[2] for place in rig.places) < 0.1
    assert "restarted" in rig.router.ended
    assert "\n" not in rig.router.ended
    assert (rig.router.flies, rig.router.has_spoken) == (False, False)


def test_an_attitude_of_another_boot_is_none(rig: Rig) -> None:
    """Before the restart is sure: ten stamps, at the IMU's slowest a second."""
    rig.boot()
    spoken = []
    for _ in range(25):
        rig.run(0.004)
        spoken.append(rig.router.has_spoken)
    assert not any(spoken[5:])


def test_frames_that_come_seconds_late_are_no_restart(rig: Rig) -> None:
    rig.server.advance(4)
    late = list(rig.server.datagrams(0, 1400))
    rig.run(2.0)
    for data in late * 8:
        rig.router.from_vehicle(data, rig.now_us)
        rig.run(0.02)
    assert rig.router.ended == ""
    assert rig.router.has_spoken


@pytest.mark.parametrize("what", ["stands", "cut"])
def test_a_vehicle_that_was_not_heard_for_seconds_stays_inside(rig: Rig, what: str) -> None:
    """It stands still with its clock, or its link is cut both ways: nothing is said meanwhile, and it goes on."""
    rig.say = lambda: velocity(3.0, 1.0, 0.0)
    rig.run(1.0)
    rig.run(3.0, stands=what == "stands", cut=what == "cut")
    assert not rig.router.has_spoken
    rig.run(4.0)
    assert rig.router.ended == ""
    assert rig.router.has_spoken
    assert inside(rig.places)
    assert rig.places[-1][0] > 2.0  # the program's word counts again


def test_a_program_that_comes_back_as_another_system_is_obeyed(rig: Rig) -> None:
    rig.say = lambda: None
    rig.run(2.0)
    stopped = rig.places[-1].copy()
    rig.program, rig.say = Link(77, 1), lambda: velocity(0.0, 2.0, 0.0)
    rig.run(1.5)
    assert rig.places[-1][1] - stopped[1] > 0.8
    assert inside(rig.places)


@pytest.mark.parametrize(
    "nonsense",
    [
        thorough(rates(NAN, 0.0, 0.5)),
        thorough(rates(0.0, INF, 0.5)),
        rates(0.0, 0.0, NAN),
        m.SetAttitudeTarget(0, 1, 1, 7, (NAN, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5),
        thorough(m.SetAttitudeTarget(0, 1, 1, 7, LEVEL, (0.0, 0.0, 0.0), -INF)),
        thorough(position(NAN, NAN, NAN)),
        velocity(INF, -INF, NAN),
    ],
)
def test_nonsense_is_no_word_of_the_program(rig: Rig, nonsense: object) -> None:
    """It stops, holds and is handed over as if nothing had come; thrust that is no number let it sink to the floor."""
    rig.say = lambda: nonsense
    rig.run(4.0)
    assert np.abs(rig.places[-1] - rig.places[0]).max() < 0.3
    assert rig.server.commander.state.mode.title == "Offboard"
    rig.run(2.5)
    assert rig.router.score.handed_over
    assert rig.server.commander.state.mode.title == "Hold"


def test_sense_and_nonsense_by_turns_is_flown_by_the_sense(rig: Rig) -> None:
    nothing = m.SetPositionTargetLocalNed(0, 1, 1, 1, 0, (NAN,) * 3, (INF,) * 3, (NAN,) * 3, INF)
    said = [velocity(1.0, 0.0, 0.0), rates(NAN, NAN, NAN), nothing, velocity(1.0, 0.0, 0.0)]
    rig.say = lambda: said[rig.now_us // 20_000 % 4]
    rig.run(3.0)
    assert 1.5 < rig.places[-1][0] < 4.0
    assert inside(rig.places)
    assert not rig.router.score.handed_over


def test_no_field_of_a_setpoint_whatever_its_number_ends_the_router_or_leads_out(rig: Rig) -> None:
    """All masks, frames and numbers that single precision has, mixed with sense so that it is obeyed."""
    rng = np.random.default_rng(4)
    odd = [0.0, -0.0, NAN, INF, -INF, 3.4e38, -3.4e38, 1e-45, 1e6, -1e3, 0.5]

    def number() -> float:
        return float(rng.choice(odd)) if rng.uniform() < 0.7 else float(rng.normal())

    def three() -> tuple[float, float, float]:
        return number(), number(), number()

    def say() -> object:
        kind, mask = int(rng.integers(4)), int(rng.integers(65_536))
        if kind == 0:
            q = (number(), *three())
            return m.SetAttitudeTarget(0, 1, 1, mask % 256, q, three(), number())
        if kind == 1:
            lat, lon = float(rng.uniform(-214.0, 214.0)), float(rng.uniform(-214.0, 214.0))
            frame = int(rng.choice([0, 3, 5, 6, 11]))
            words = (lat, lon, number(), three(), three(), number(), number())
            return m.SetPositionTargetGlobalInt(0, 1, 1, frame, mask, *words)
        if kind == 2:
            frame = int(rng.choice([1, 7, 8, 9, 12, 255]))
            return m.SetPositionTargetLocalNed(0, 1, 1, frame, mask, three(), three(), three(), number(), number())
        return velocity(*rng.uniform(-3.0, 3.0, 3).tolist())

    rig.say = say
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        rig.run(10.0)
    assert inside(rig.places)
    assert rig.router.flies


def on_the_globe(folder: Path, asked_north_m: float) -> Rig:
    """The same room on the globe; the shield asked where the vehicle is when it stood so far north of its place."""
    corners = [list(PX4_SIH.to_globe(*corner)) for corner in ((-5.0, -4.0), (5.0, -4.0), (5.0, 4.0), (-5.0, 4.0))]
    path = folder / "globe.toml"
    path.write_text(SITE[: SITE.index("inside")] + f'frame = "global"\ninside = {corners}\n')
    return Rig(path, place=PX4_SIH.to_globe(asked_north_m, 0.0))


@pytest.mark.parametrize("asked_north_m", [-2.0, thorough(2.0)])
def test_a_site_on_the_globe_stays_there_where_the_vehicle_was_carried_before_it_was_armed(
    tmp_path: Path, asked_north_m: float
) -> None:
    """It went with the vehicle: its northern wall was 2 m farther."""
    rig = on_the_globe(tmp_path, asked_north_m)
    rig.take_off()
    rig.places.clear()
    rig.say = lambda: velocity(4.0, 0.0, 0.0)
    rig.run(5.0)
    assert inside(rig.places)
    assert rig.places[-1][0] > 3.0


def test_a_vehicle_that_was_carried_out_of_its_chute_ends_the_shield(tmp_path: Path) -> None:
    rig = on_the_globe(tmp_path, -3.5)
    rig.take_off()
    assert "carried 3.5 m" in rig.router.ended
    assert max(-place[2] for place in rig.places) < 0.1


def test_last_words_leave_the_vehicle_level_in_hold(rig: Rig) -> None:
    """A second Ctrl-C at speed: what is said in that one moment, and nothing after it."""
    rig.say = lambda: velocity(3.0, 0.0, 0.0)
    rig.run(1.0)
    assert rig.vehicle.plant.vel_ned_mps[0] > 1.0
    for _ in range(3):
        rig.router.say_last_words("KeyboardInterrupt")
        for data in rig.router.link.datagrams_to_send():
            rig.server.receive(0, data)
    rig.router.step = lambda now_us: []  # type: ignore[method-assign]
    rig.say, tilts = lambda: None, []
    for _ in range(100):
        rig.run(0.04)
        _, x, y, _ = rig.vehicle.plant.q_ned_frd
        tilts.append(np.degrees(np.arccos(1.0 - 2.0 * (x * x + y * y))))
    assert rig.server.commander.state.mode.title == "Hold"
    assert max(tilts) < 35.0
    assert np.linalg.norm(rig.vehicle.plant.vel_ned_mps) < 0.3
    assert abs(rig.places[-1][2] + 2.0) < 0.4
