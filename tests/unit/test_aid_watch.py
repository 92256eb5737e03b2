"""Satellites lost in flight: the companion hands back while the vehicle still has the height to land from.

Replayed is what a real PX4 with SIH said in a flight whose SIM_GPS_USED was 0 for 3 s (2026-11-29; link of 15 ms each
way): position, velocity and IMU agreed to the end, and its height went by 0.27 m/s below what it told.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from companions import Flying, flying
from fake_px4 import LAND, STEP_US, exchange

from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.aid_watch import AidWatch
from mavlink_bridge.faults import FAULTS
from mavlink_bridge.handshake import State

GROWN_S = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.2, 2.4, 2.6, 2.8, 3.0)
GROWN_M = (0.30, 0.33, 0.36, 0.40, 0.45, 0.50, 0.55, 0.59, 0.64, 0.68, 0.72, 0.76, 0.80, 0.84, 0.88)
"""Stated accuracy across by the time since the last satellites; 0.29 m with them."""
WITH_M = 0.29


def _grown(t_s: float) -> float:
    """As a real PX4 stated it."""
    return next(
        (error_m for at_s, error_m in reversed(list(zip(GROWN_S, GROWN_M, strict=True))) if at_s <= t_s), WITH_M
    )


def _with_satellites() -> Flying:
    flight = flying()
    flight.vehicle.fix, flight.vehicle.accuracy_m = 3, WITH_M
    return flight._replace(now_us=exchange(flight.companion, flight.vehicle, 2.0, start_us=flight.now_us))


def _without(flight: Flying, accuracy_m: Callable[[float], float], fix: int | None, seconds: float) -> float:
    """Seconds without a fix until the companion no longer flies, at most so many."""
    companion, _, vehicle, start = flight
    vehicle.fix, now = fix, start
    while companion.state is State.OFFBOARD and now < start + round(1e6 * seconds):
        vehicle.accuracy_m = accuracy_m((now - start) * 1e-6)
        now = exchange(companion, vehicle, STEP_US * 1e-6, start_us=now)
    return (now - start) * 1e-6


@pytest.mark.parametrize("fix", [0, 1, 2])
def test_a_position_that_gets_worse_without_satellites_hands_back(fix: int) -> None:
    """Half as much again, 0.435 m, is stated from 1.0 s on: 1.0 s, and the next ESTIMATOR_STATUS within 0.2 s."""
    flight = _with_satellites()
    after_s = _without(flight, _grown, fix, 3.0)
    assert 1.0 <= after_s <= 1.25
    assert after_s == pytest.approx(FAULTS["gps-lost"].after_s or 0.0, abs=0.1)
    companion, notes, vehicle, start = flight
    assert companion.state is State.LANDING
    assert companion.reason == f"gps-lost: {FAULTS['gps-lost'].what}"
    exchange(companion, vehicle, 0.5, start_us=start + round(1e6 * after_s))
    assert vehicle.mode == LAND
    assert [text for text in notes.texts("fault") if text.startswith("gps-lost: ")]


@pytest.mark.parametrize("answers", [True, False])
def test_a_stream_that_another_station_stops_is_asked_for_again_and_is_no_loss_of_satellites(answers: bool) -> None:
    """A position may get worse for another reason; where nobody answers, satellites count as lost in the end."""
    flight = _with_satellites()
    companion, _, vehicle, start = flight
    vehicle.commands.clear()
    vehicle.fix, now, again_s = None, start, math.nan
    while companion.state is State.OFFBOARD and now < start + 5_000_000:
        vehicle.accuracy_m = _grown((now - start) * 1e-6)
        now = exchange(companion, vehicle, STEP_US * 1e-6, start_us=now)
        if math.isnan(again_s) and any(_asks_for_gps(command) for command in vehicle.commands):
            again_s = (now - start) * 1e-6
            vehicle.fix = 3 if answers else None
    assert 1.1 <= again_s <= 1.4, "a PX4 whose receiver is gone says so once a second by itself"
    assert (companion.state is State.OFFBOARD) is answers
    if not answers:
        assert 1.87 <= (now - start) * 1e-6 <= 2.25, "2 s after the last of eight fixes a second"
        assert companion.reason.startswith("gps-lost: ")
        assert sum(map(_asks_for_gps, vehicle.commands)) <= 11, "ten a second at most"


def _asks_for_gps(command: m.CommandLong) -> bool:
    return command.command == px4.Cmd.SET_MESSAGE_INTERVAL and command.params[:2] == (24.0, 200_000.0)


def test_fixes_are_asked_for_before_the_flight() -> None:
    """GPS_RAW_INT is message 24 of MAVLink's common set."""
    assert any(map(_asks_for_gps, flying().vehicle.commands))


def test_satellites_that_are_back_within_a_second_end_no_flight() -> None:
    flight = _with_satellites()
    gone_s = _without(flight, _grown, 0, 0.9)
    flight.vehicle.fix, flight.vehicle.accuracy_m = 3, 0.42
    exchange(flight.companion, flight.vehicle, 5.0, start_us=flight.now_us + round(1e6 * gone_s))
    assert flight.companion.state is State.OFFBOARD


def test_who_goes_by_something_else_may_lose_its_satellites() -> None:
    """Motion capture beside GPS: the estimate is no worse without."""
    flight = _with_satellites()
    _without(flight, lambda t_s: WITH_M * (1.0 + 0.1 * math.sin(t_s)), 0, 8.0)
    assert flight.companion.state is State.OFFBOARD


@pytest.mark.parametrize("fix", [0, None])
def test_who_never_had_satellites_misses_none(fix: int | None) -> None:
    flight = flying()
    _without(flight, lambda t_s: WITH_M * (1.0 + t_s), fix, 8.0)
    assert flight.companion.state is State.OFFBOARD


def test_silence_counts_later_than_a_word() -> None:
    watch = AidWatch()
    watch.estimator(m.EstimatorStatus(0, 1023, 0.1, 0.1, 0.1, 0.1, 0.1, math.nan, 0.3, math.nan))
    watch.gps(3, 0)
    watch.estimator(m.EstimatorStatus(0, 1023, 0.1, 0.1, 0.1, 0.1, 0.1, math.nan, 0.5, math.nan))
    assert not watch.is_silent(1_200_000)
    assert watch.is_silent(1_200_001)
    assert not watch.is_lost(2_000_000)
    assert watch.is_lost(2_000_001)
    watch.gps(0, 600_000)
    assert watch.is_lost(600_000)
    assert not watch.is_silent(1_800_000)


def test_where_no_accuracy_is_stated_two_seconds_without_satellites_count() -> None:
    watch = AidWatch()
    assert not watch.is_lost(0)
    watch.gps(3, 0)
    assert not watch.is_lost(2_000_000)
    assert watch.is_lost(2_000_001)
    watch.estimator(m.EstimatorStatus(0, 1023, 0.1, 0.1, 0.1, 0.1, 0.1, math.nan, math.nan, math.nan))
    assert watch.is_lost(2_000_001)
    watch.gps(3, 3_000_000)
    assert not watch.is_lost(3_000_000)
