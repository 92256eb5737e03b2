"""Every fault of the state, the clock and the pace, thrown at a companion in flight: what it does, and how soon.

The oracle of when is closed form: thresholds over rates, with the forgetting of the sums; the oracle of no false alarm
is a real PX4's recorded flight.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from companions import MODEL, Flying, build, flying
from fake_px4 import HOLD, LAND, RTL, STEP_US, FakePx4, exchange
from tlog import recording

from flightstack.consistency import EstimateWatch
from mavlink_bridge import messages as m
from mavlink_bridge.faults import FAULTS, Reaction
from mavlink_bridge.handshake import State
from mavlink_bridge.vehicle_clock import VehicleClock
from mavlink_bridge.watchdogs import PERIOD_US, PaceWatch, ResetWatch, Watchdogs

Alter = Callable[[Any, float], Any | None]
"""A message and the seconds since the fault began (0 for the first altered one) -> what arrives."""
POSITION, ATTITUDE, IMU = m.LocalPositionNed, m.AttitudeQuaternion, m.HighresImu


def _lost(kind: type) -> Alter:
    return lambda message, t_s: None if isinstance(message, kind) else message


def _frozen(kind: type) -> Alter:
    """The first one again and again, with stamps that go on."""
    kept: list[Any] = []

    def alter(message: Any, t_s: float) -> Any:
        if not isinstance(message, kind):
            return message
        kept.append(message)
        return kept[0]._replace(**{message._fields[0]: message[0]})

    return alter


def _moved(north_m: Callable[[float], float], vel_mps: Callable[[float], float]) -> Alter:
    def alter(message: Any, t_s: float) -> Any:
        if not isinstance(message, POSITION):
            return message
        (n, e, d), (vn, ve, vd) = message.pos_ned_m, message.vel_ned_mps
        return message._replace(pos_ned_m=(n + north_m(t_s), e, d), vel_ned_mps=(vn + vel_mps(t_s), ve, vd))

    return alter


def _tilted(angle_rad: float) -> Alter:
    def alter(message: Any, t_s: float) -> Any:
        if not isinstance(message, ATTITUDE):
            return message
        return message._replace(q_ned_frd=(math.cos(angle_rad / 2), math.sin(angle_rad / 2), 0.0, 0.0))

    return alter


def _restamped(by_us: int) -> Alter:
    return lambda message, t_s: message._replace(**{message._fields[0]: max(0, message[0] + by_us)})


STEP_S = STEP_US * 1e-6
ALTERATIONS: dict[str, Alter] = {
    "stale-position": _lost(POSITION),
    "stale-attitude": _lost(ATTITUDE),
    "stale-imu": _lost(IMU),
    "frozen-position": _frozen(POSITION),
    "frozen-attitude": _frozen(ATTITUDE),
    "frozen-imu": _frozen(IMU),
    "velocity-against-imu": _moved(lambda t: 4.0 * (t + STEP_S) ** 2, lambda t: 8.0 * (t + STEP_S)),
    "position-against-velocity": _moved(lambda t: 4.0 * (t + STEP_S), lambda t: 0.0),
    "attitude-against-gyro": _tilted(math.radians(30.0)),
    "jump": _moved(lambda t: 3.0, lambda t: 0.0),
    "reset-far": _moved(lambda t: 12.0, lambda t: 0.0),
    "reboot": _restamped(-60_000_000),
    "clock": _restamped(2_000_000),
}
FLAGS = {"estimator-attitude": 1023 & ~0x01, "estimator-position": 1023 & ~0x20}
BLIND = {"stale-attitude", "frozen-attitude", "attitude-against-gyro", "estimator-attitude"}


def _until_handed_back(flight: Flying, limit_s: float = 2.0) -> float:
    """Seconds until the companion hands back; it must."""
    companion = flight.companion
    start = flight.now_us
    end = exchange(
        companion, flight.vehicle, limit_s, start_us=start, until=lambda: companion.state is not State.OFFBOARD
    )
    assert companion.state in (State.LANDING, State.HOLDING)
    return (end - start - STEP_US) * 1e-6


def _assert_handed_back(flight: Flying, name: str, now_us: int) -> None:
    """The stated mode is asked for, the words until PX4 has it are safe, then there are none."""
    companion, notes, vehicle, _ = flight
    row = FAULTS[name]
    spoken = len(vehicle.setpoints)
    exchange(companion, vehicle, 0.5, start_us=now_us)
    assert vehicle.mode == (HOLD if row.reaction is Reaction.HOLD else LAND)
    assert companion.state is (State.PILOT if row.reaction is Reaction.HOLD else State.LANDING)
    assert companion.reason.startswith(f"{name}: ")
    assert [text for text in notes.texts("fault") if text.startswith(f"{name}: ")]
    words = vehicle.setpoints[spoken - 1 :]
    assert 1 <= len(words) <= 30  # CURRENT_MODE comes at 10 Hz
    for word in words:
        assert word.rate_frd_radps == (0.0, 0.0, 0.0)
        assert word.thrust_norm == pytest.approx(MODEL.hover_norm, rel=0.1)
        if name in BLIND:
            assert word.type_mask == 128
        else:
            assert word.type_mask == 7
            assert word.q_ned_frd == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-3)
    silent = len(vehicle.setpoints)
    exchange(companion, vehicle, 2.0, start_us=now_us + 500_000)
    assert len(vehicle.setpoints) == silent


@pytest.mark.parametrize("name", [*ALTERATIONS, *FLAGS])
def test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time(name: str) -> None:
    flight = flying()
    vehicle, start = flight.vehicle, flight.now_us
    if name in FLAGS:
        vehicle.flags = FLAGS[name]
    else:
        alter = ALTERATIONS[name]
        if name.startswith("frozen"):  # what is repeated is the last one that was good
            alter_from = start - STEP_US
        else:
            alter_from = start + STEP_US
        vehicle.alter = lambda message: alter(message, (vehicle_time(message) - alter_from) * 1e-6)
        if name.startswith("frozen"):
            exchange(flight.companion, vehicle, STEP_S, start_us=start)
            flight = flight._replace(now_us=start + STEP_US)
    after_s = _until_handed_back(flight)
    stated = FAULTS[name].after_s
    assert stated is not None
    assert after_s == pytest.approx(stated, abs=1.5 * STEP_S)
    _assert_handed_back(flight, name, flight.now_us + round(after_s * 1e6) + STEP_US)


def vehicle_time(message: Any) -> int:
    """The stamp of a state message, its first field."""
    return int(message[0])


def test_a_counted_reset_is_not_chased() -> None:
    """3 m north and 1 m down in one sample, told by the counter within 40 ms: position stays where it was."""
    companion, notes, vehicle, start = flying()
    before = notes.ticks[-1].measurement.pos_ned_m.copy()

    def alter(message: Any) -> Any:
        if not isinstance(message, POSITION):
            return message
        n, e, d = message.pos_ned_m
        return message._replace(pos_ned_m=(n + 3.0, e, d + 1.0))

    vehicle.alter, vehicle.resets = alter, 1
    count = len(notes.ticks)
    exchange(companion, vehicle, 3.0, start_us=start)
    assert companion.state is State.OFFBOARD
    for record in notes.ticks[count:]:
        assert record.measurement.pos_ned_m == pytest.approx(before, abs=1e-3)
    said = [text for text in notes.texts("fault") if text.startswith("reset: ")]
    assert len(said) == 1
    assert "(3.00, 0.00, 1.00) m" in said[0]


@pytest.mark.parametrize(("step_m", "ends"), [(9.0, False), (12.0, True), (111_000.0, True)])
def test_a_counted_reset_farther_than_the_vehicle_can_have_gone_unnoticed_hands_back(step_m: float, ends: bool) -> None:
    """2 m/s, beyond which velocity contradicts the IMU, for the 5 s after which PX4 calls an unaided position bad.

    A real PX4 whose GPS jumped by 111 km counted a reset and was flown on for 1.6 s.
    """
    flight = flying()
    companion, notes, vehicle, start = flight
    before = notes.ticks[-1].measurement.pos_ned_m.copy()
    alter = _moved(lambda t: step_m, lambda t: 0.0)
    vehicle.alter = lambda message: alter(message, 0.0)
    vehicle.resets, count = 1, len(notes.ticks)
    end = exchange(companion, vehicle, 1.0, start_us=start, until=lambda: companion.state is not State.OFFBOARD)
    assert (companion.state is State.LANDING) is ends
    for record in notes.ticks[count:]:  # nothing is chased meanwhile
        assert record.measurement.pos_ned_m == pytest.approx(before, abs=1e-3)
    if ends:
        assert (end - start) * 1e-6 <= 3 * STEP_S
        _assert_handed_back(flight, "reset-far", end)


def test_a_third_reset_within_ten_seconds_hands_back() -> None:
    flight = flying()
    companion, _, vehicle, now = flight
    for count in range(1, 4):
        shift = float(count)
        vehicle.alter = lambda message, shift=shift: (  # type: ignore[misc]
            message._replace(pos_ned_m=(shift, 0.0, 1e-6 * (message.t_boot_us % 7)))
            if isinstance(message, POSITION)
            else message
        )
        vehicle.resets, begun = count, now
        now = exchange(companion, vehicle, 1.0, start_us=now, until=lambda: companion.state is not State.OFFBOARD)
    assert companion.state is State.LANDING
    assert companion.reason.startswith("resets: ")
    assert (now - begun) * 1e-6 <= (FAULTS["resets"].after_s or 0.0) + 2 * STEP_S


def test_of_small_counted_steps_the_largest_is_taken_out_once_and_then_the_next() -> None:
    watch = ResetWatch()
    assert watch.shift_ned_m == (0.0, 0.0, 0.0)
    watch.counter(1, 0)
    assert not watch.counter(2, 1)  # of heading: nothing has stepped
    assert watch.counted == 0
    for t_us, north_m in ((10, 0.06), (20, 0.08)):
        assert not watch.position(t_us, (north_m, 0.0, 0.0))
    assert watch.counter(30, 2)
    assert watch.shift_ned_m == pytest.approx((0.08, 0.0, 0.0))
    assert watch.counter(40, 3)
    assert watch.shift_ned_m == pytest.approx((0.14, 0.0, 0.0))
    assert not watch.counter(50, 4)
    assert watch.counted == 2


@pytest.mark.parametrize("jumped_us", [0, 1_000_000])
def test_a_jump_that_no_counter_tells_is_trouble_after_a_fifth_of_a_second_and_none_is_none(jumped_us: int) -> None:
    watch = ResetWatch()
    watch.position(jumped_us + 900_000, (0.0, 0.0, 0.0))
    assert watch.trouble == ""
    watch = ResetWatch()
    assert watch.position(jumped_us, (2.0, 0.0, 0.0))
    watch.position(jumped_us + 200_000, (0.0, 0.0, 0.0))
    assert watch.trouble == ""
    watch.position(jumped_us + 200_001, (0.0, 0.0, 0.0))
    assert watch.trouble == "jump"


def test_before_the_flight_begins_a_jump_is_left_as_it_is() -> None:
    watchdogs = Watchdogs(VehicleClock())
    assert watchdogs.pace.period_us == PERIOD_US
    still = (0.0, 0.0, 0.0)
    for t_us, north_m in ((0, 0.0), (8_000, 0.0), (16_000, 5.0)):
        message = POSITION(t_us, (north_m, 0.0, 0.0), still)
        assert watchdogs.see(message) is message
    watchdogs.begin()
    moved = watchdogs.see(POSITION(24_000, (9.0, 0.0, 0.0), still))
    assert isinstance(moved, POSITION)
    assert moved.pos_ned_m == pytest.approx((5.0, 0.0, 0.0))


def _wakes(flight: Flying, piled_up: list[bytes], now_us: int) -> None:
    """The companion's first tick after a sleep, and what the vehicle makes of its words."""
    for data in piled_up:
        flight.companion.receive_datagram(data, now_us)
    flight.companion.step(now_us)
    assert flight.companion.state is State.HOLDING
    for data in flight.companion.link.datagrams_to_send():
        flight.vehicle.link.receive_datagram(data, now_us)
    flight.vehicle.step(now_us)


def test_a_long_gap_between_ticks_hands_back_to_hold() -> None:
    flight = flying()
    _, _, vehicle, now = flight
    for _ in range(75):  # 0.3 s in which only the vehicle lives
        now += STEP_US
        vehicle.step(now)
    _wakes(flight, vehicle.link.datagrams_to_send(), now)
    _assert_handed_back(flight, "overrun-gap", now)


@pytest.mark.parametrize("acted", [True, False])
def test_after_a_sleep_nothing_is_commanded_until_the_mode_is_heard_anew(acted: bool) -> None:
    """Seen on a real PX4: frozen for 3 s it woke, had read of OFFBOARD only, and put Hold in place of PX4's Return."""
    companion, _, vehicle, now = flight = flying()
    kept: list[bytes] = []
    for tick in range(750):  # 3 s in which only the vehicle lives, of which the socket keeps the first
        now += STEP_US
        if tick == 260 and acted:
            vehicle.mode = RTL
        vehicle.step(now)
        kept += vehicle.link.datagrams_to_send() if tick < 250 else []
    commanded = len(vehicle.set_modes(176))
    _wakes(flight, kept, now)
    assert len(vehicle.set_modes(176)) == commanded
    exchange(companion, vehicle, 0.5, start_us=now)
    assert vehicle.mode == (RTL if acted else HOLD)
    assert (len(vehicle.set_modes(176)) == commanded) is acted
    assert companion.state is State.PILOT


@pytest.mark.parametrize(("loss_s", "acted"), [(1.0, False), (0.2, True), (math.nan, True)])
def test_whether_px4_may_have_acted_goes_by_its_own_loss_time(loss_s: float, acted: bool) -> None:
    watch = PaceWatch()
    watch.step(0, 1.0)
    watch.step(500_000, 1.0)
    assert watch.may_have_acted(500_000, 504_000, loss_s) is acted
    assert not watch.may_have_acted(560_000, 564_000, loss_s)  # heard since
    assert not watch.may_have_acted(500_000, 750_000, loss_s)  # long awake


def test_a_link_that_becomes_slow_in_flight_ends_it() -> None:
    """Behind a radio that slept for 40 ms a real PX4 swung by a radian for three seconds, and met the ground at
    1.9 m/s.  Ten answers, one in 0.1 s: 1 s.  A stall's five late ones are none."""
    flight = flying()
    now = flight.now_us
    for trip_us, seconds in ((4_000, 1.5), (60_000, 0.5), (4_000, 1.5)):
        flight.vehicle.round_trip_us = trip_us
        exchange(flight.companion, flight.vehicle, seconds, start_us=now)
        now += round(1e6 * seconds)
    assert flight.companion.state is State.OFFBOARD
    flight.vehicle.round_trip_us, flight = 60_000, flight._replace(now_us=now)
    after_s = _until_handed_back(flight)
    assert after_s == pytest.approx(FAULTS["slow-link"].after_s or 0.0, abs=0.1)
    _assert_handed_back(flight, "slow-link", flight.now_us + round(after_s * 1e6) + STEP_US)


def test_too_many_missed_ticks_hand_back_to_hold() -> None:
    """Every tenth tick: 225 missed in a second, 210 of them after 0.96 s."""
    flight = flying()
    companion, _, vehicle, start = flight
    now = start
    while companion.state is State.OFFBOARD and now < start + 2_000_000:
        for _ in range(10):
            now += STEP_US
            vehicle.step(now)
            for data in vehicle.link.datagrams_to_send():
                companion.receive_datagram(data, now)
        companion.step(now)
        for data in companion.link.datagrams_to_send():
            vehicle.link.receive_datagram(data, now)
    assert companion.state is State.HOLDING
    assert (now - start) * 1e-6 == pytest.approx(FAULTS["overrun-rate"].after_s or 0.0, abs=0.02)
    vehicle.step(now)
    _assert_handed_back(flight, "overrun-rate", now)


@pytest.mark.parametrize(("swing_rad", "ends"), [(0.35, False), (0.9, True)])
def test_a_vehicle_that_swings_instead_of_turning_as_told_lands(swing_rad: float, ends: bool) -> None:
    """Rolling to and fro at 1 Hz, whatever it is sent (back, by up to its limits): 0.4 rad (rms) counts."""
    companion, notes, vehicle, start = flying()

    def alter(message: Any) -> Any:
        t_s = (message[0] - start) * 1e-6
        angle = swing_rad * math.sin(2.0 * math.pi * t_s)
        rates = (2.0 * math.pi * swing_rad * math.cos(2.0 * math.pi * t_s), 1e-6 * (message[0] // STEP_US % 7), 0.0)
        if isinstance(message, ATTITUDE):
            return message._replace(
                q_ned_frd=(math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0), rate_frd_radps=rates
            )
        if isinstance(message, IMU):
            force = (rates[1], -9.80665 * math.sin(angle), -9.80665 * math.cos(angle))
            return message._replace(accel_frd_mps2=force, rate_frd_radps=rates)
        return message

    vehicle.alter = alter
    exchange(companion, vehicle, 8.0, start_us=start, until=lambda: companion.state is not State.OFFBOARD)
    assert (companion.state is State.LANDING) is ends
    assert companion.reason.startswith("swinging: ") is ends
    assert any("the companion ends the flight early (swinging: " in text for text in notes.texts("state")) is ends


@pytest.mark.parametrize(("missing_s", "ends"), [(0.2, True), (0.06, False)])
def test_an_imu_that_comes_now_and_then_ends_the_flight(missing_s: float, ends: bool) -> None:
    """A real PX4 told to send HIGHRES_IMU at 5 Hz: the guard flew nine tenths of a figure of eight, 2.3 m beside it.

    From 22 ms of age on the guard flies: 0.178 of every 0.2 s are 0.5 s more than the rest during the fourth; 0.038
    of 0.2 s never are.
    """
    flight = flying()
    companion, _, vehicle, start = flight

    def alter(message: Any) -> Any:
        inside_s = (message[0] - start) * 1e-6 % 0.2
        return None if isinstance(message, IMU) and STEP_S / 2 < inside_s < missing_s - STEP_S / 2 else message

    vehicle.alter = alter
    end = exchange(companion, vehicle, 2.0, start_us=start, until=lambda: companion.state is not State.OFFBOARD)
    assert (companion.state is State.LANDING) is ends
    if ends:
        assert 0.6 < (end - start) * 1e-6 < 0.8
        _assert_handed_back(flight, "stale-imu", end)


def test_a_guard_that_acts_now_and_then_is_told_when_it_begins_and_with_the_count_when_it_ends() -> None:
    """The IMU misses 60 ms of every 0.2 s, for 2 s: ten times, in two lines; a log of a real PX4 had 1,727 pairs."""
    companion, notes, vehicle, start = flying()

    def alter(message: Any) -> Any:
        t_s = (message[0] - start) * 1e-6
        return None if isinstance(message, IMU) and t_s < 2.0 and STEP_S / 2 < t_s % 0.2 < 0.058 else message

    vehicle.alter = alter
    now = exchange(companion, vehicle, 2.5, start_us=start)
    assert notes.texts("guard") == ["guard: level: position lost"]
    now = exchange(companion, vehicle, 1.0, start_us=now)
    said = notes.texts("guard")[1:]
    assert len(said) == 1
    assert said[0].startswith("guard: lets go: acted 10 times within 1.8 s (level: position lost)")
    vehicle.alter = lambda message: None if isinstance(message, IMU) else message
    exchange(companion, vehicle, 1.0, start_us=now, until=lambda: companion.state is not State.OFFBOARD)
    assert companion.state is State.LANDING
    said = notes.texts("guard")[2:]
    assert [text.partition(":")[2].split(":")[0] for text in said] == [" level", " acted until the flight ended"]


def test_a_guard_that_does_not_let_go_ends_the_flight() -> None:
    """Rolled to 90 degrees at 3 rad/s, gyro and accelerometer agreeing: the guard brakes from 80 degrees on."""
    flight = flying()
    companion, notes, vehicle, start = flight
    crossed: list[int] = []

    def alter(message: Any) -> Any:
        t_s = (message[0] - start) * 1e-6
        angle = min(3.0 * t_s, math.pi / 2)
        rate = 3.0 if angle < math.pi / 2 else 0.0
        noise = 1e-6 * (message[0] // STEP_US % 7)
        if angle > math.radians(80.0) and not crossed:
            crossed.append(message[0])
        if isinstance(message, ATTITUDE):
            return message._replace(
                q_ned_frd=(math.cos(angle / 2), math.sin(angle / 2), noise, 0.0), rate_frd_radps=(rate, 0.0, 0.0)
            )
        if isinstance(message, IMU):
            force = (noise, -9.80665 * math.sin(angle), -9.80665 * math.cos(angle))
            return message._replace(accel_frd_mps2=force, rate_frd_radps=(rate, 0.0, 0.0))
        return message

    vehicle.alter = alter
    end = exchange(companion, vehicle, 3.0, start_us=start, until=lambda: companion.state is not State.OFFBOARD)
    assert (end - crossed[0]) * 1e-6 == pytest.approx(FAULTS["guard"].after_s or 0.0, abs=0.0081)
    assert companion.reason.startswith("guard: ")
    assert any("brake: tilt" in text for text in notes.texts("guard"))


@pytest.mark.parametrize("alteration", ["frozen-position", "frozen-attitude"])
def test_a_frozen_estimate_on_the_ground_is_never_armed(alteration: str) -> None:
    companion, _ = build()
    vehicle = FakePx4()
    alter = ALTERATIONS[alteration]
    vehicle.alter = lambda message: alter(message, 0.0)
    exchange(companion, vehicle, 60.0)
    assert companion.state is State.REFUSED
    assert "repeat" in companion.reason
    assert not vehicle.set_modes(400)


def test_nothing_barks_at_a_real_px4s_flight(recorded: Path) -> None:
    """143 s with take-off, steps, free fall, failsafe, landing: no alarm, and errors below half their thresholds."""
    watch, worst = EstimateWatch(), [0.0, 0.0, 0.0, 0.0]
    resets = ResetWatch()
    resets.begin()
    samples = 0
    for heard in recording(recorded / "px4_sih_offboard.tlog"):
        message = heard.message
        if isinstance(message, IMU):
            watch.imu(message.t_us, message.accel_frd_mps2, message.rate_frd_radps)
        elif isinstance(message, ATTITUDE):
            watch.attitude(message.t_boot_us, message.q_ned_frd, message.rate_frd_radps)
        elif isinstance(message, POSITION):
            watch.position(message.t_boot_us, message.pos_ned_m, message.vel_ned_mps)
            assert not resets.position(message.t_boot_us, watch.step_ned_m)
        elif isinstance(message, m.Odometry):
            assert not resets.counter(message.t_us, message.reset_counter)
        samples += 1
        worst = [
            max(old, new)
            for old, new in zip(
                worst,
                (
                    max(map(abs, watch.step_ned_m)),
                    watch.velocity_error_mps,
                    watch.position_error_m,
                    watch.tilt_error_rad,
                ),
                strict=True,
            )
        ]
        assert watch.trouble == ""
    assert samples > 100_000
    assert worst[0] < 0.125
    assert worst[1] < 1.0
    assert worst[2] < 0.75
    assert worst[3] < 0.175


@pytest.mark.parametrize("kind", [POSITION, ATTITUDE, IMU])
def test_what_px4_recorded_and_then_repeats_itself_is_noticed(kind: type, recorded: Path) -> None:
    """The recorded flight again; from the 60th second on one stream repeats its value: within 0.1 s it is named."""
    watch, kept, begin_us = Watchdogs(VehicleClock()), None, -1
    for heard in recording(recorded / "px4_sih_offboard.tlog"):
        message = heard.message
        if isinstance(message, kind) and heard.t_us > 60_000_000:
            kept = kept or message
            begin_us = kept[0]
            message = kept._replace(**{message._fields[0]: message[0]})
            watch.see(message)
            if watch.trouble:
                assert (
                    watch.trouble == {POSITION: "frozen-position", ATTITUDE: "frozen-attitude", IMU: "frozen-imu"}[kind]
                )
                assert 100_000 <= message[0] - begin_us <= 125_000
                return
        else:
            watch.see(message)
        assert not watch.trouble
    pytest.fail("not noticed")
