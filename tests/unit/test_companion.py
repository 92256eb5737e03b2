"""The companion against a stand-in PX4: who may be flown, who decides, and what the last words are."""

from __future__ import annotations

import numpy as np
import pytest
from companions import MODEL, build, flying
from fake_px4 import HOLD, LAND, OFFBOARD, POSITION, RTL, FakePx4, exchange

from mavlink_bridge import messages as m
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link
from mavlink_bridge.signing import SecretKey, Signer


def test_a_good_flight_arms_flies_lands_and_leaves_hold_selected() -> None:
    companion, notes = build()
    vehicle = FakePx4()

    def land_when_told(now_us: int) -> None:
        if vehicle.mode == LAND:
            vehicle.armed = False

    exchange(companion, vehicle, 40.0, each=land_when_told)
    assert companion.state is State.LANDED
    assert companion.completed
    assert vehicle.mode == HOLD  # OFFBOARD must not be left selected: the next stream would take off
    assert len(vehicle.set_modes(400)) == 1  # armed once
    assert len(notes.ticks) > 250
    assert max(record.command.thrust_norm for record in notes.ticks) > 0.3


def test_setpoints_flow_before_offboard_and_are_harmless_on_the_ground() -> None:
    companion, _ = build()
    vehicle = FakePx4()
    exchange(companion, vehicle, 10.0, until=lambda: bool(vehicle.set_modes(176)))
    assert len(vehicle.setpoints) >= 100  # 0.4 s at 250 Hz at least
    assert all(point.thrust_norm == 0.0 and point.rate_frd_radps == (0.0, 0.0, 0.0) for point in vehicle.setpoints)
    assert {point.type_mask for point in vehicle.setpoints} == {128}
    assert all(np.isfinite(point.q_ned_frd).all() for point in vehicle.setpoints)


@pytest.mark.parametrize("autopilot", [0, 3, 8])
def test_a_peer_that_is_no_px4_is_refused_and_gets_no_command(autopilot: int) -> None:
    companion, _ = build()
    vehicle = FakePx4(autopilot=autopilot)
    exchange(companion, vehicle, 10.0)
    assert companion.state is State.REFUSED
    assert "no PX4" in companion.reason
    assert not vehicle.setpoints
    assert not vehicle.set_modes(400)
    assert not vehicle.set_modes(176)


def test_a_fixed_wing_is_refused() -> None:
    companion, _ = build()
    exchange(companion, FakePx4(type=1), 10.0)
    assert companion.state is State.REFUSED
    assert "no quadrotor" in companion.reason


def test_a_vehicle_that_does_not_say_who_it_is_is_never_armed() -> None:
    companion, _ = build()
    vehicle = FakePx4(answers_version=False)
    exchange(companion, vehicle, 20.0)
    assert companion.state is State.REFUSED
    assert "AUTOPILOT_VERSION" in companion.reason
    assert not vehicle.set_modes(400)
    assert not vehicle.setpoints


def test_silence_is_told_from_a_vehicle() -> None:
    companion, _ = build()
    exchange(companion, FakePx4(heartbeats=False), 20.0)
    assert companion.state is State.REFUSED
    assert "no heartbeat" in companion.reason


def test_a_vehicle_without_our_key_is_told_from_silence() -> None:
    """A real PX4 that does not sign streamed all the while, and "no heartbeat" was all that was said."""
    companion, _ = build(signing=Signer(SecretKey(bytes(range(32))), lambda: 1))
    exchange(companion, FakePx4(), 20.0)
    assert companion.state is State.REFUSED
    assert "no heartbeat" in companion.reason
    assert "frames without the key's signature" in companion.reason


def test_a_stranger_whose_first_datagram_is_not_signed_with_our_key_is_counted() -> None:
    """Over UDP nobody becomes the peer without it, and nothing else of it is read."""
    signer, stranger = Signer(SecretKey(bytes(range(32))), lambda: 1), Link(1, 1)
    stranger.send(m.Heartbeat(2, 12, 0x81, HOLD, 4))
    (frame,) = stranger.datagrams_to_send()
    assert not signer.vouches(frame, False)
    assert Link(240, 191, signing=signer).refused == 1


def test_a_refused_arming_says_why_in_the_vehicles_words() -> None:
    companion, _ = build()
    vehicle = FakePx4(arm_result=1, texts=("Arming denied: Resolve system health failures first",))
    exchange(companion, vehicle, 60.0)
    assert companion.state is State.REFUSED
    assert "arming refused: temporarily rejected" in companion.reason
    assert "Resolve system health failures" in companion.reason
    assert "\n" not in companion.reason


def test_an_accepting_first_ack_does_not_hide_a_refused_mode() -> None:
    companion, _ = build()
    vehicle = FakePx4(mode_result=1)
    exchange(companion, vehicle, 60.0)
    assert companion.state is State.REFUSED
    assert "OFFBOARD mode refused: temporarily rejected" in companion.reason
    assert not vehicle.set_modes(400)


def test_without_leave_to_arm_it_waits_for_the_pilot() -> None:
    companion, _ = build(arm=False)
    vehicle = FakePx4()
    now = exchange(companion, vehicle, 40.0)
    assert companion.state is State.STREAMING
    assert not vehicle.set_modes(400)
    assert not vehicle.set_modes(176)
    vehicle.armed, vehicle.mode = True, OFFBOARD
    exchange(companion, vehicle, 3.0, start_us=now, until=lambda: companion.state is State.OFFBOARD)
    assert companion.state is State.OFFBOARD


@pytest.mark.parametrize("mode", [POSITION, RTL, HOLD])
def test_when_the_pilot_changes_the_mode_the_stream_stops_at_once_and_for_good(mode: int) -> None:
    companion, _ = build()
    vehicle = FakePx4()
    now = exchange(companion, vehicle, 30.0, until=lambda: companion.ticks > 250)
    assert companion.state is State.OFFBOARD
    vehicle.mode = mode
    now = exchange(companion, vehicle, 1.0, start_us=now)
    assert companion.state is State.PILOT
    sent, commanded = len(vehicle.setpoints), len(vehicle.commands)
    vehicle.mode = OFFBOARD  # even then: no re-entry without a new run
    for _ in range(500):
        now += 4_000
        companion.step(now)
        assert not companion.link.datagrams_to_send()
    assert (len(vehicle.setpoints), len(vehicle.commands)) == (sent, commanded)
    assert not companion.completed


def test_a_vehicle_disarmed_by_someone_else_is_never_armed_again() -> None:
    companion, _ = build()
    vehicle = FakePx4()
    now = exchange(companion, vehicle, 30.0, until=lambda: companion.ticks > 250)
    vehicle.armed = False
    exchange(companion, vehicle, 5.0, start_us=now)
    assert companion.state is State.PILOT
    assert len(vehicle.set_modes(400)) == 1


@pytest.mark.parametrize("mode", [OFFBOARD, HOLD])
def test_an_armed_vehicle_that_we_did_not_arm_is_left_alone(mode: int) -> None:
    companion, _ = build()
    vehicle = FakePx4(armed=True, mode=mode, landed=2)
    exchange(companion, vehicle, 10.0)
    assert companion.state is State.REFUSED
    assert "already armed" in companion.reason
    assert not vehicle.setpoints


def test_a_dry_run_checks_and_sends_no_setpoint() -> None:
    companion, _ = build(dry_run=True)
    vehicle = FakePx4()
    exchange(companion, vehicle, 20.0)
    assert companion.state is State.STREAMING
    assert companion.done
    assert not vehicle.setpoints
    assert not {176, 400} & {command.command for command in vehicle.commands}


def test_a_bad_estimate_is_waited_for_and_then_named() -> None:
    companion, _ = build()
    vehicle = FakePx4(flags=164)
    exchange(companion, vehicle, 60.0)
    assert companion.state is State.REFUSED
    assert "estimate not good" in companion.reason
    assert not vehicle.setpoints


def test_streams_that_stop_in_flight_end_in_a_landing_and_hold_is_left_selected() -> None:
    companion, notes = build()
    vehicle = FakePx4()
    now = exchange(companion, vehicle, 30.0, until=lambda: companion.ticks > 250)
    vehicle.streams = False
    before = len(notes.ticks)

    def land_when_told(now_us: int) -> None:
        if vehicle.mode == LAND:
            vehicle.armed = False

    exchange(companion, vehicle, 5.0, start_us=now, each=land_when_told)
    assert companion.state is State.LANDED
    assert not companion.completed
    assert vehicle.mode == HOLD
    blind = notes.ticks[before:]
    assert any(record.guard for record in blind)
    assert len(blind) <= 0.6 * 250  # half a second of the guard, then words of our own


def test_a_link_that_is_too_slow_for_body_rates_is_refused_with_its_latency() -> None:
    """TIMESYNC answers that come 60 ms after the question: the round trip says so."""
    companion, _ = build()
    vehicle, asked = FakePx4(), []

    def answer(now_us: int) -> None:
        asked.append(now_us)
        if len(asked) % 25 == 0:
            question_us = now_us - 60_000
            vehicle.link.send(m.Timesync(question_us * 1000 + 30_000_000, question_us * 1000, 240, 191))

    exchange(companion, vehicle, 60.0, each=answer)
    assert companion.state is State.REFUSED
    assert "link too slow: 60 ms there and back" in companion.reason
    assert not vehicle.set_modes(400)


def test_px4s_land_begins_from_the_attitude_and_thrust_that_are() -> None:
    """A real PX4 flies the first cycles of its own mode by the last attitude setpoint that it was told: where that was
    before the take-off (no thrust), it took the fall for its start and landed at 1.8 m/s."""
    companion, _, vehicle, now = flying()
    companion.stop("stopped by the user")
    exchange(companion, vehicle, 1.0, start_us=now, until=lambda: vehicle.mode == LAND)
    told = [point for point in vehicle.setpoints if point.type_mask == 7]
    assert len(told) == 1
    assert told[0].q_ned_frd == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=0.01)  # as the stand-in's attitude is
    assert told[0].thrust_norm == pytest.approx(MODEL.norm_of(MODEL.weight_n), abs=0.05)
    places = [vehicle.heard.index(told[0]), vehicle.heard.index(vehicle.set_modes(176)[-1])]
    assert 0 < places[1] - places[0] <= 2  # in the same tick


def test_once_px4_lands_silence_is_not_answered() -> None:
    """It disarms into OFFBOARD, and its HEARTBEAT says so up to a second later: a stall of 66 ms in between made the
    dead-man hold, and the companion took that for a pilot's."""
    companion, _, vehicle, now = flying()
    companion.stop("stopped by the user")
    now = exchange(companion, vehicle, 1.0, start_us=now, until=lambda: vehicle.mode == LAND)
    now = exchange(companion, vehicle, 0.6, start_us=now)
    assert companion.last_word(now).flags == 0
    vehicle.mode = OFFBOARD
    now = exchange(companion, vehicle, 0.3, start_us=now)
    assert companion.state is State.LANDING
    assert companion.last_word(now).flags == 0


@pytest.mark.parametrize("late_us", [0, 250_000])
def test_stop_while_arming_leaves_nothing_armed(late_us: int) -> None:
    """Ctrl-C as a real PX4 armed: it stayed armed in OFFBOARD without setpoints, then in Return, for 20 s and more.

    The latter moment is shortly before a heartbeat tells the companion that it is armed.
    """
    companion, _ = build()
    vehicle = FakePx4()
    now = exchange(companion, vehicle, 30.0, until=lambda: vehicle.armed)
    now = exchange(companion, vehicle, 1e-6 * late_us, start_us=now) if late_us else now
    assert companion.state is State.STREAMING
    companion.stop("stopped by the user")
    exchange(companion, vehicle, 0.1, start_us=now)
    assert companion.state is State.REFUSED
    assert not vehicle.armed


def test_stop_in_flight_lands_and_is_no_completed_flight() -> None:
    companion, _ = build()
    vehicle = FakePx4()
    now = exchange(companion, vehicle, 30.0, until=lambda: companion.ticks > 250)
    companion.stop("stopped by the user")

    def land_when_told(now_us: int) -> None:
        if vehicle.mode == LAND:
            vehicle.armed = False

    exchange(companion, vehicle, 10.0, start_us=now, each=land_when_told)
    assert companion.state is State.LANDED
    assert not companion.completed
    assert companion.reason == "stopped by the user"


def test_messages_of_other_systems_do_not_count() -> None:
    companion, _ = build()
    vehicle = FakePx4()
    now = exchange(companion, vehicle, 30.0, until=lambda: companion.ticks > 250)
    stranger = Link(7, 1)
    stranger.send(m.Heartbeat(2, 12, 0x01, POSITION, 4))
    stranger.send(m.CurrentMode(0, POSITION, POSITION))
    for data in stranger.datagrams_to_send():
        companion.receive_datagram(data, now)
    exchange(companion, vehicle, 0.5, start_us=now)
    assert companion.state is State.OFFBOARD


def test_two_autopilots_on_the_link_are_refused_before_arming() -> None:
    companion, _ = build()
    vehicle, other = FakePx4(), FakePx4(system=2)

    def also(now_us: int) -> None:
        other.step(now_us)
        for data in other.link.datagrams_to_send():
            companion.receive_datagram(data, now_us)

    exchange(companion, vehicle, 10.0, each=also)
    assert companion.state is State.REFUSED
    assert "two autopilots" in companion.reason
    assert not vehicle.set_modes(400)


def test_a_vehicle_that_speaks_to_the_same_port_by_another_one_is_refused_before_the_flight() -> None:
    """Two simulated PX4s beyond the tenth, say: both send to port 14549, and which one is met is chance."""
    companion, _ = build()
    vehicle = FakePx4()
    companion.view.other_system = 9
    exchange(companion, vehicle, 10.0)
    assert companion.state is State.REFUSED
    assert "two autopilots on one link (systems 1 and 9)" in companion.reason
    assert not vehicle.setpoints
    companion, _ = build()
    vehicle = FakePx4()
    now = exchange(companion, vehicle, 30.0, until=lambda: companion.ticks > 250)
    companion.view.other_system = 9
    exchange(companion, vehicle, 1.0, start_us=now)
    assert companion.state is State.OFFBOARD, "in flight it changes nothing"
