"""A real PX4's side of a recorded exchange, played to the companion: it meets, checks, flies along, and lets go.

Recorded by another client, which armed, selected OFFBOARD at 64 s and let its stream die at 111 s; PX4's failsafe then
returned and landed, and that client's resumed stream brought OFFBOARD back at 125 s.  Our setpoints change nothing in a
recording, so tracking means nothing; who may fly, and when to let go, does.  A vehicle that obeys another does not
turn as we tell it: `Swinging` would rightly land it 8 s on, so it's out of force here but where that itself is asked.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from companions import ROOT, VEHICLE, Notes
from tlog import recording

from flightstack.model import Limits, Model
from flightstack.scenario import parse_scenario
from flightstack.stack import Stack
from mavlink_bridge import messages as m
from mavlink_bridge.companion import Companion, CompanionConfig
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link

TICK_US = 4_000
PX4, CLIENT = 1, 245


class Flown(NamedTuple):
    """What became of a replay."""

    companion: Companion
    notes: Notes
    states: list[tuple[float, State]]
    """Seconds into the recording at which a state was entered."""
    setpoints: list[tuple[float, m.SetAttitudeTarget]]
    commands: list[m.CommandLong]


def _play(path: Path, *, arm: bool, systems: tuple[int, ...] = (PX4,)) -> Flown:
    text = (ROOT / "flightstack/data/scenarios" / "hover.toml").read_text()
    scenario = parse_scenario(text, "hover").with_duration(200.0)
    notes = Notes()
    # The recorded client flew wild and asked for streams at 50 and 100 Hz: the guard would end a flight of ours.
    limits = Limits(tilt_abort_rad=np.pi, attitude_age_max_us=60_000, imu_age_max_us=60_000, position_age_max_us=60_000)
    config = CompanionConfig(arm=arm, identify_timeout_s=8.0, ready_timeout_s=60.0, arm_timeout_s=60.0)
    stack = Stack(Model.from_vehicle(VEHICLE), limits=limits)
    companion = Companion(Link(240, 191), stack, scenario, notes, config)
    ear = Link(9, 9)
    flown = Flown(companion, notes, [], [], [])
    now_us = 0
    for heard in recording(path):
        while now_us < heard.t_us:
            now_us += TICK_US
            companion.step(now_us)
            for data in companion.link.datagrams_to_send():
                ear.receive_datagram(data, now_us)
            while (said := ear.next_event()) is not None:
                if isinstance(said.message, m.SetAttitudeTarget):
                    flown.setpoints.append((now_us * 1e-6, said.message))
                elif isinstance(said.message, m.CommandLong):
                    flown.commands.append(said.message)
            if not flown.states or flown.states[-1][1] is not companion.state:
                flown.states.append((now_us * 1e-6, companion.state))
        if heard.system in systems:
            companion.receive_datagram(heard.frame, now_us)
    return flown


@pytest.fixture(scope="module")
def flown(recorded: Path) -> Flown:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mavlink_bridge.notes._SWING_RAD", np.inf)
        return _play(recorded / "px4_sih_offboard.tlog", arm=False)


def test_a_real_px4_that_does_not_turn_as_it_is_told_is_landed_and_then_left_alone(recorded: Path) -> None:
    """It flies on, obeying its own client, while we tell it otherwise, then ask for Land; then PX4's failsafe."""
    flown = _play(recorded / "px4_sih_offboard.tlog", arm=False)
    assert [state for _, state in flown.states][4:] == [State.OFFBOARD, State.LANDING, State.PILOT]
    at = {state: t_s for t_s, state in flown.states}
    assert at[State.OFFBOARD] + 3.0 < at[State.LANDING] < at[State.OFFBOARD] + 10.0
    assert 111.4 < at[State.PILOT] < 112.6
    assert flown.companion.reason.startswith("swinging: ")
    modes = [command.params[:3] for command in flown.commands if command.command == 176]
    assert modes
    assert set(modes) == {(1.0, 4.0, 6.0)}  # AUTO.LAND and nothing else
    assert flown.setpoints[-1][0] <= at[State.PILOT]


def test_it_flies_from_the_pilots_offboard_to_px4s_failsafe_and_never_again(flown: Flown) -> None:
    states = [state for _, state in flown.states]
    assert states == [
        State.DISCONNECTED, State.IDENTIFYING, State.STANDBY, State.STREAMING, State.OFFBOARD, State.PILOT,
    ]  # fmt: skip
    at = {state: t_s for t_s, state in flown.states}
    assert 63.0 < at[State.OFFBOARD] < 64.1  # HEARTBEAT says it at 64.0
    assert 111.4 < at[State.PILOT] < 112.6  # and RTL at 112.5
    assert "left OFFBOARD for AUTO.RTL, not by this companion: hands off" in flown.companion.reason
    assert flown.setpoints[-1][0] <= at[State.PILOT]  # nothing at 125 s, when OFFBOARD is back


def test_px4s_own_streams_bark_at_nothing(flown: Flown) -> None:
    assert not flown.notes.texts("fault")


def test_it_neither_arms_nor_selects_a_mode(flown: Flown) -> None:
    assert not {176, 400} & {command.command for command in flown.commands}
    assert {511, 512} <= {command.command for command in flown.commands}


def test_what_it_sends_to_a_real_px4_counts_as_a_signal_and_is_finite(flown: Flown) -> None:
    """PX4 drops masks 129 to 131 and takes thrust as 0 where it is to be ignored (mask 64)."""
    assert len(flown.setpoints) > 10_000
    for _, point in flown.setpoints:
        assert point.type_mask == 128
        assert (point.target_system, point.target_component) == (1, 1)
        assert np.isfinite([*point.rate_frd_radps, point.thrust_norm]).all()
        assert 0.0 <= point.thrust_norm <= 1.0


def test_every_frame_of_px4_is_understood(flown: Flown) -> None:
    stats = flown.companion.link.stats
    assert stats.received > 90_000
    assert stats.dropped == 0
    assert flown.companion.view.version is not None
    assert flown.companion.view.version.flight_sw_version == 0x01120040


def test_its_clock_follows_px4s(flown: Flown) -> None:
    """The recorded simulation ran at 1 to 1.5 % below the wall's time at least at times, and never jumped."""
    clock = flown.companion.view.clock
    assert clock.jumps == 0
    assert 0.9 < clock.rate < 1.01


def test_with_leave_to_arm_it_keeps_off_while_another_client_sends_setpoints(recorded: Path) -> None:
    """Both sides of the recording on one link, as a router shows them."""
    flown = _play(recorded / "px4_sih_offboard.tlog", arm=True, systems=(PX4, CLIENT))
    assert flown.companion.state is State.REFUSED
    assert "system 245 sends offboard setpoints" in flown.companion.reason
    refused_s = flown.states[-1][0]
    assert flown.setpoints[-1][0] < refused_s
    first_s = next(
        heard.t_us * 1e-6
        for heard in recording(recorded / "px4_sih_offboard.tlog")
        if isinstance(heard.message, m.SetAttitudeTarget)
    )
    assert 0.0 <= refused_s - first_s <= 2 * TICK_US * 1e-6
