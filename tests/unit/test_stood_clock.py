"""A vehicle whose messages come and whose clock hardly goes on: the flight ends in stated time, by our own clock.

Seen on a real PX4 in lockstep with its simulator: after `ekf2 stop` in flight its stamps went on by 0.1 s in two
minutes, by which nothing was ever old, and the companion flew on until it was killed.
"""

from __future__ import annotations

import pytest
from companions import Flying, flying
from fake_px4 import LAND, FakePx4, exchange

from mavlink_bridge.companion import CompanionConfig
from mavlink_bridge.handshake import State

LIMIT_S = CompanionConfig().link_loss_s


def _slow_down(vehicle: FakePx4, start_us: int, rate: float) -> None:
    """From a time on the vehicle's clock goes on at that rate, in its stamps and in its answers."""

    def clock_us(now_us: int) -> int:
        return start_us + round(rate * (now_us - start_us))

    vehicle.alter = lambda message: message._replace(**{message._fields[0]: clock_us(message[0])})
    vehicle.clock_us = clock_us


def _flying() -> Flying:
    """With TIMESYNC, by whose answers the companion follows the vehicle's clock wherever it goes."""
    flight = flying()
    flight.vehicle.round_trip_us = 4_000
    return flight._replace(now_us=exchange(flight.companion, flight.vehicle, 3.0, start_us=flight.now_us))


@pytest.mark.parametrize("rate", [0.0, 0.001])
def test_a_vehicle_whose_clock_stands_still_is_given_to_px4_and_left(rate: float) -> None:
    companion, _, vehicle, start = _flying()
    _slow_down(vehicle, start, rate)
    end = exchange(companion, vehicle, 10.0, start_us=start)
    assert companion.state is State.LOST
    assert (end - start) * 1e-6 == pytest.approx(LIMIT_S, abs=0.1)
    assert companion.reason.startswith("the vehicle's clock has stood still for 3.0 s")
    assert not companion.completed
    assert vehicle.mode == LAND
    spoken = len(vehicle.setpoints)
    exchange(companion, vehicle, 2.0, start_us=end)
    assert len(vehicle.setpoints) == spoken


def test_a_landing_says_why_it_began_before_the_clock_stood_still() -> None:
    companion, _, vehicle, start = _flying()
    companion.stop("enough")
    begun = exchange(companion, vehicle, 1.0, start_us=start)
    assert companion.state is State.LANDING
    _slow_down(vehicle, begun, 0.001)
    end = exchange(companion, vehicle, 10.0, start_us=begun)
    assert companion.state is State.LOST
    assert (end - begun) * 1e-6 == pytest.approx(LIMIT_S, abs=0.1)
    assert companion.reason.startswith("enough; the vehicle's clock has stood still for ")


@pytest.mark.parametrize("rate", [0.05, 0.3])
def test_a_slow_simulator_is_flown_with(rate: float) -> None:
    """`sim --speed` goes down to 0.05; here the clock slows down in flight, which is harder."""
    companion, _, vehicle, start = _flying()
    _slow_down(vehicle, start, rate)
    exchange(companion, vehicle, 10.0, start_us=start)
    assert not companion.reason.startswith("the vehicle's clock")
