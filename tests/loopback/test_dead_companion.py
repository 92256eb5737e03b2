"""Kills and stalls of the companion at random moments of a figure of eight, by the simulator's truth.

The figures: tilt at most 35 degrees, no ground contact, height lost in the first second 0.5 m in the median, 0.8 m at
worst.  Without the dead-man the same kills, at PX4's default parameters, tilt beyond 45 degrees.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median

import pytest
from silence import GuardedFlight, height_lost_m, impact_mps

from flightstack_sim.shell import ONBOARD
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link
from tests.branches import branching, in_a_child
from tests.thorough import thorough

TILT_MAX_DEG, LOST_MEDIAN_M, LOST_MAX_M = 35.0, 0.5, 0.8
LAP_S = 8.0
_DRAWN = random.Random(3)
MOMENTS_S = [_DRAWN.uniform(0.0, LAP_S) for _ in range(6)]
STALLS_S = [_DRAWN.uniform(0.1, 3.0) for _ in range(3)]


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardedFlight]:
    """A figure of eight 3 s into its track, COM_OF_LOSS_T 1 s."""
    guarded = GuardedFlight(tmp_path_factory.mktemp("begun"), "figure8", 14.0)
    try:
        guarded.begin(3.0)
        assert guarded.flight.vehicle.params.get("COM_OF_LOSS_T") == 1.0
        yield guarded
    finally:
        guarded.close()


@pytest.fixture
def flight(begun: GuardedFlight, request: pytest.FixtureRequest) -> GuardedFlight:
    branching(request)
    return begun


def _pilot(flight: GuardedFlight, command: int, *params: float) -> None:
    station = Link(255, 190)
    p = (*params, *(0.0,) * (7 - len(params)))
    station.send(m.CommandLong(1, 1, command, 0, (p[0], p[1], p[2], p[3], p[4], p[5], p[6])))
    for data in station.datagrams_to_send():
        flight.flight.shell.server.receive(ONBOARD, data)


def _at_moments(flight: GuardedFlight, acts: dict[float, Callable[[], float]]) -> list[float]:
    """What each act says that branches off from the flight so long after its track's beginning, in their order."""
    flight.begin(0.0)
    began_us, said = flight.flight.t_us, []
    for moment_s in sorted(acts):
        while flight.flight.t_us < began_us + 1e6 * moment_s:
            flight.step()
        said.append(float(in_a_child(acts[moment_s])))
    flight.close()
    return said


def test_kills_at_random_moments_of_a_figure_8_are_harmless(tmp_path: Path) -> None:
    flight = GuardedFlight(tmp_path, "figure8")

    def killed() -> float:
        killed_us = flight.flight.t_us
        flight.stand_still(3.0)
        after = flight.since(killed_us)
        assert flight.mode == "Hold"
        assert impact_mps(after) == 0.0
        assert not any(truth.on_ground for truth in after)
        assert max(truth.tilt_deg for truth in after) <= TILT_MAX_DEG
        return height_lost_m(after)

    lost = _at_moments(flight, dict.fromkeys(MOMENTS_S, killed))
    assert max(lost) <= LOST_MAX_M
    assert median(lost) <= LOST_MEDIAN_M


def test_without_the_dead_man_the_same_kills_tip_the_vehicle_over(tmp_path: Path) -> None:
    flight = GuardedFlight(tmp_path, "figure8", dead_man=False)

    def killed() -> float:
        killed_us = flight.flight.t_us
        flight.stand_still(1.5)
        return max(truth.tilt_deg for truth in flight.since(killed_us))

    assert max(_at_moments(flight, dict.fromkeys(MOMENTS_S[:2], killed))) > 45.0


def test_stalls_at_random_moments_of_a_figure_8_are_harmless(tmp_path: Path) -> None:
    flight = GuardedFlight(tmp_path, "figure8")

    def stalled(stall_s: float) -> float:
        stopped_us = flight.flight.t_us
        flight.stand_still(stall_s)
        for _ in range(500):
            flight.step()
        after = flight.since(stopped_us)
        assert not any(truth.on_ground for truth in after)
        assert max(truth.tilt_deg for truth in after) <= TILT_MAX_DEG
        return height_lost_m(after)

    moments = {random.Random(stall_s).uniform(0.0, LAP_S): partial(stalled, stall_s) for stall_s in STALLS_S}
    assert max(_at_moments(flight, moments)) <= LOST_MAX_M


@pytest.mark.parametrize("stall_s", [thorough(0.06), thorough(0.2), 0.45])
def test_a_short_stall_is_taken_back_and_the_flight_completes(flight: GuardedFlight, stall_s: float) -> None:
    flight.stand_still(stall_s)
    acts = flight.dead_man.record  # type: ignore[union-attr]
    assert acts.acts == 1
    assert 50e6 <= acts.hold_ns - acts.silent_ns <= 65e6
    while not flight.companion.done:
        flight.step()
    assert flight.companion.completed, flight.companion.reason
    assert flight.companion.stalls.taken_back == 1
    assert flight.companion.state is State.LANDED


def test_a_short_stall_on_a_slow_machine_is_taken_back(flight: GuardedFlight) -> None:
    """120 ticks missed within 0.6 s, then 100 in one stall: together more than the watchdog of the pace allows."""
    for _ in range(15):
        flight.step()
        flight.stand_still(0.032)
    flight.stand_still(0.4)
    for _ in range(250):
        flight.step()
    assert flight.companion.state is State.OFFBOARD
    assert flight.companion.stalls.taken_back == 1


def test_a_long_stall_ends_in_hold(flight: GuardedFlight) -> None:
    flight.stand_still(0.7)
    for _ in range(250):
        flight.step()
    assert flight.companion.state is State.PILOT
    assert flight.companion.reason.startswith("stalled-long")
    assert flight.mode == "Hold"
    assert not flight.companion.link.datagrams_to_send()


def test_a_second_stall_within_ten_seconds_ends_in_hold(flight: GuardedFlight) -> None:
    flight.stand_still(0.2)
    for _ in range(500):
        flight.step()
    assert flight.companion.state is State.OFFBOARD
    flight.stand_still(0.2)
    for _ in range(250):
        flight.step()
    assert flight.companion.state is State.PILOT
    assert "taken back" in flight.companion.reason
    assert flight.mode == "Hold"


@pytest.mark.parametrize("steps", [1, thorough(3)])
def test_a_stall_while_offboard_is_being_taken_back_begins_that_again(flight: GuardedFlight, steps: int) -> None:
    """In Hold still, or just out of it: the second silence finds a Hold that is nobody else's."""
    flight.stand_still(0.1)
    for _ in range(steps):
        flight.step()
    assert flight.companion.state is State.RETAKING
    flight.stand_still(0.12)
    for _ in range(100):
        flight.step()
    assert flight.companion.state is State.OFFBOARD
    assert not flight.dead_man.record.touched  # type: ignore[union-attr]


@pytest.mark.parametrize("mode", [(4.0, 5.0), thorough((3.0, 0.0))])
def test_a_pilot_who_takes_over_while_offboard_is_being_taken_back_keeps_the_vehicle(
    flight: GuardedFlight, mode: tuple[float, float]
) -> None:
    flight.stand_still(0.1)
    flight.step()
    assert flight.companion.state is State.RETAKING
    _pilot(flight, px4.Cmd.DO_SET_MODE, 1.0, *mode)
    flight.stand_still(0.12)
    taken = flight.mode
    for _ in range(250):
        flight.step()
    assert flight.companion.state is State.PILOT
    assert flight.mode == taken != "Offboard"


def test_a_pilot_who_selects_hold_between_two_stalls_keeps_the_vehicle(flight: GuardedFlight) -> None:
    flight.stand_still(0.1)
    for _ in range(100):
        flight.step()
    assert flight.companion.state is State.OFFBOARD
    _pilot(flight, px4.Cmd.DO_SET_MODE, 1.0, 4.0, 3.0)
    flight.stand_still(0.1)
    for _ in range(250):
        flight.step()
    assert flight.companion.state is State.PILOT
    assert flight.mode == "Hold"


@pytest.mark.parametrize("delay_s", [thorough(0.0), 0.045])
def test_a_pilot_who_changes_the_mode_before_the_dead_man_acts_is_never_fought(
    flight: GuardedFlight, delay_s: float
) -> None:
    flight.stand_still(delay_s)
    _pilot(flight, px4.Cmd.DO_SET_MODE, 1.0, 4.0, 5.0)
    flight.stand_still(0.4)
    record = flight.dead_man.record  # type: ignore[union-attr]
    assert record.hold_ns == 0
    assert flight.mode == "Return"
    for _ in range(50):
        flight.step()
    assert flight.companion.state is State.PILOT
    assert flight.mode == "Return"


def test_a_pilot_who_takes_over_from_the_dead_mans_hold_keeps_the_vehicle(flight: GuardedFlight) -> None:
    flight.stand_still(0.2)
    _pilot(flight, px4.Cmd.DO_SET_MODE, 1.0, 4.0, 5.0)
    flight.stand_still(0.1)
    for _ in range(250):
        flight.step()
    assert flight.companion.state is State.PILOT
    assert flight.mode == "Return"


def test_hold_and_back_by_the_pilot_finds_a_silent_companion_and_a_silent_dead_man(flight: GuardedFlight) -> None:
    """PX4 takes OFFBOARD again while the last setpoint is younger than COM_OF_LOSS_T; its failsafe ends it."""
    _pilot(flight, px4.Cmd.DO_SET_MODE, 1.0, 4.0, 3.0)
    for _ in range(50):
        flight.step()
    _pilot(flight, px4.Cmd.DO_SET_MODE, 1.0, 6.0)
    said = flight.companion.link.stats.sent
    for _ in range(25):
        flight.step()
    assert flight.mode == "Offboard"
    assert flight.companion.state is State.PILOT
    assert flight.companion.link.stats.sent == said
    assert flight.dead_man.record.acts == 0  # type: ignore[union-attr]
    for _ in range(300):
        flight.step()
    assert flight.mode == "Return"


@pytest.mark.parametrize(("loss_t_s", "lands"), [(1.0, True), (0.4, False)])
def test_without_its_dead_man_a_flight_at_a_long_loss_time_lands(tmp_path: Path, loss_t_s: float, lands: bool) -> None:
    flight = GuardedFlight(tmp_path, "figure8", 14.0)
    flight.flight.vehicle.params.set("COM_OF_LOSS_T", loss_t_s)
    flight.begin(1.0)
    assert flight.dead_man is not None
    record = flight.dead_man.record
    flight.dead_man = None
    flight.companion.hear_dead_man(record, "its process has ended")
    for _ in range(100):
        flight.step()
    flight.close()
    assert (flight.companion.state is State.LANDING) is lands
    assert (flight.mode == "Land") is lands


def test_at_fifty_ticks_a_second_a_figure_of_eight_flies_as_ever(flight: GuardedFlight) -> None:
    began_us = flight.flight.t_us
    for _ in range(200):
        flight.step()
        flight.stand_still(0.016)
    assert flight.companion.state is State.OFFBOARD
    assert max(truth.tilt_deg for truth in flight.since(began_us)) <= TILT_MAX_DEG
    assert min(truth.height_m for truth in flight.since(began_us)) > 1.5


def test_in_the_middle_of_the_landing_command_a_stall_still_ends_in_a_landing(flight: GuardedFlight) -> None:
    flight.companion.stop("the user asked to stop")
    server = flight.flight.shell.server
    receive, server.receive = server.receive, lambda index, data: None  # type: ignore[method-assign,assignment]
    flight.step()  # the command to land is lost
    server.receive = receive  # type: ignore[method-assign]
    assert flight.companion.state is State.LANDING
    flight.stand_still(0.2)
    assert flight.mode == "Hold"
    for _ in range(100):
        flight.step()
    assert flight.mode == "Land"
    assert flight.companion.state is State.LANDING


def _stall_whose_words_are_held_up(flight: GuardedFlight) -> list[bytes]:
    """A stall of 0.1 s; what was said to the vehicle meanwhile, which did not reach it: OFFBOARD was kept."""
    server, held = flight.flight.shell.server, list[bytes]()
    receive = server.receive
    server.receive = lambda index, data: held.append(data)  # type: ignore[method-assign,assignment]
    flight.stand_still(0.1)
    server.receive = receive  # type: ignore[method-assign]
    for _ in range(60):
        flight.step()
    assert flight.companion.state is State.OFFBOARD
    assert flight.mode == "Offboard"
    return held


def test_a_hold_of_the_dead_mans_that_is_obeyed_late_is_taken_back(flight: GuardedFlight) -> None:
    for data in _stall_whose_words_are_held_up(flight):
        flight.flight.shell.server.receive(ONBOARD, data)
    for _ in range(100):
        flight.step()
    assert flight.companion.state is State.OFFBOARD
    assert flight.mode == "Offboard"


def test_a_pilots_hold_after_a_hold_that_was_lost_is_not_taken_for_the_dead_mans(flight: GuardedFlight) -> None:
    """Nobody answered the companion's system that a mode was accepted: it was another one who asked."""
    _stall_whose_words_are_held_up(flight)
    _pilot(flight, px4.Cmd.DO_SET_MODE, 1.0, 4.0, 3.0)
    for _ in range(250):
        flight.step()
    assert flight.mode == "Hold"
    assert flight.companion.state is State.PILOT
