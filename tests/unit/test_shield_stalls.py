"""A shield that stood still as its vehicle was armed: flown on, or disarmed, never left armed on the ground.

The dead-man is written down here: what it commands and tells, at PX4's times on a busy machine.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from shield_rig import SITE, Rig, position

from flightstack.cli.shield_words import ShieldWords
from mavlink_bridge import px4
from mavlink_bridge.dead_man_frames import NOBODY, DeadManRecord
from mavlink_bridge.link import Link
from mavlink_bridge.messages import CommandLong
from mavlink_bridge.requests import set_mode
from tests.thorough import ONLY_THEN

NAN = float("nan")
TICK_US, HELD_AFTER_US = 4_000, 68_000


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("site") / "room.toml"
    path.write_text(SITE)
    return path


class Stalled(Rig):
    """A rig whose router can stand still, with a dead-man beside it."""

    def arms(self, climbs_s: float) -> None:
        """Asks once for OFFBOARD and arming, and flies for so long."""
        self.record, self.said, self.words = NOBODY, [], ShieldWords()
        self.hears()
        self.say = lambda: position(0.0, 0.0, -2.0)
        self.run(6.0)
        self.command(*(lambda r: (r[0], *r[1]))(set_mode(px4.MODE_OFFBOARD)))
        self.run(0.3)
        self.command(px4.Cmd.COMPONENT_ARM_DISARM, 1.0)
        for _ in range(20):  # a heartbeat tells it, once a second
            self.run(0.1)
            if self.router.flies:
                break
        assert self.router.flies
        self.run(climbs_s)

    def hears(self) -> None:
        """The router hears the dead-man before each step, and says what it has to say."""
        inner = self.router.step

        def step(now_us: int) -> list[bytes]:
            self.router.hear_dead_man(self.record)
            out = inner(now_us)
            self.said += self.words.look(self.router, now_us)
            return out

        self.router.step = step  # type: ignore[method-assign]

    def hold(self) -> bytes:
        """The dead-man's command, in the router's name."""
        link = Link(240, 191)
        number, given = set_mode(px4.MODE_HOLD)
        link.send(CommandLong(1, 1, int(number), 0, (*given, *(NAN,) * (7 - len(given)))))
        return link.datagrams_to_send()[0]

    def stalls(self, seconds: float, obeyed_s: float, *, touched: int = 0) -> None:
        """The router stands still for so long; PX4 obeys the Hold so long after the stall began."""
        began_us, hold_us, waiting = self.now_us, self.now_us + HELD_AFTER_US, []
        obeyed_us, ends_us = began_us + round(1e6 * obeyed_s), began_us + round(1e6 * seconds)
        while self.now_us < ends_us:
            self.now_us += TICK_US
            self.server.advance(4)
            waiting += self.server.datagrams(0, 1400)
            if self.now_us - TICK_US < obeyed_us <= self.now_us:
                self.server.receive(0, self.hold())
        held_ns = 1000 * (obeyed_us + 25_000) if obeyed_us + 25_000 < ends_us else 0
        self.record = DeadManRecord(
            alive_ns=1000 * self.now_us, acts=1, silent_ns=1000 * began_us, began_ns=1000 * hold_us,
            hold_ns=1000 * hold_us, held_ns=held_ns, mode_ns=held_ns, mode=px4.MODE_HOLD if held_ns else 0, sequence=0,
            touched=touched, frames=10,
        )  # fmt: skip
        for data in waiting:
            self.router.from_vehicle(data, self.now_us)
        if obeyed_us > ends_us:
            self.run(1e-6 * (obeyed_us - ends_us))
            self.server.receive(0, self.hold())


def mode(rig: Rig) -> str:
    return str(rig.server.commander.state.mode.title)


@pytest.fixture
def rig(site: Path) -> Stalled:
    return Stalled(site)


def test_too_long_a_stall_on_the_ground_leaves_nothing_armed(rig: Stalled) -> None:
    rig.arms(0.1)
    rig.stalls(0.7, 0.1)
    rig.run(5.0)
    assert not rig.server.commander.state.armed
    (line,) = [line for line in rig.said if "stalled" in line]
    assert line.startswith("stalled while arming: no setpoint for ")
    assert "disarmed" in line
    rig.run(3.0)
    assert not rig.server.commander.state.armed, "the program asked once"


@ONLY_THEN
def test_a_short_one_is_taken_back_and_flown(rig: Stalled) -> None:
    rig.arms(0.1)
    rig.stalls(0.3, 0.1)
    rig.run(6.0)
    assert mode(rig) == "Offboard"
    assert -rig.vehicle.plant.pos_ned_m[2] > 1.0
    assert not rig.said


def test_a_hold_that_is_obeyed_late_is_taken_back_too(rig: Stalled) -> None:
    """A busy PX4 took it 0.25 s later, when it had been taken for lost: the vehicle stayed armed, in Hold."""
    rig.arms(0.1)
    rig.stalls(0.12, 0.45)
    rig.run(6.0)
    assert mode(rig) == "Offboard"
    assert -rig.vehicle.plant.pos_ned_m[2] > 1.0


def test_what_somebody_else_touched_is_theirs(rig: Stalled) -> None:
    rig.arms(0.1)
    rig.stalls(0.7, 0.1, touched=1)
    rig.run(1.5)
    assert rig.server.commander.state.armed
    assert not rig.said


def test_in_the_air_nothing_is_switched_off(rig: Stalled) -> None:
    rig.arms(5.0)
    rig.stalls(0.7, 0.1)
    rig.run(3.0)
    assert rig.server.commander.state.armed
    assert mode(rig) == "Hold"
    (line,) = rig.said
    assert line.startswith("no setpoint for ")
    assert line.endswith("too long to take back (limit 0.5 s)"), "nobody knew why it hung there"
    assert -rig.vehicle.plant.pos_ned_m[2] > 1.0
