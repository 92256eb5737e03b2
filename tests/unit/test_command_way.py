"""How late commands are felt, by TIMESYNC; the oracle is a made-up link whose ways are known."""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.under_way import LATE_MOST_US
from mavlink_bridge import messages as m
from mavlink_bridge.command_way import CommandWay
from mavlink_bridge.vehicle_view import VehicleView

OFFSET_US, RATE = 7_000_000, 0.987


def heard(up_us: int, down_us: int, seconds: float, *, jitter_us: int = 0, seed: int = 1) -> tuple[VehicleView, int]:
    """A view that heard HIGHRES_IMU every 4 ms and a TIMESYNC answer ten times a second; the last local time."""
    view, rng, answers = VehicleView(), np.random.default_rng(seed), []
    still = (0.0, 0.0, 0.0)
    now_us = 0
    for now_us in range(0, int(1e6 * seconds), 4_000):
        stamp_us = OFFSET_US + round(RATE * (now_us - down_us - rng.uniform(0, jitter_us)))
        view.update(m.HighresImu(stamp_us, still, still, still, 950.0, 0.0, 500.0, 20.0, 63), now_us)
        if now_us % 100_000 == 0:
            at_us = now_us + up_us + round(rng.uniform(0, jitter_us))
            answers.append((at_us + down_us + round(rng.uniform(0, jitter_us)), now_us, at_us))
        while answers and answers[0][0] <= now_us:
            _, asked_us, at_us = answers.pop(0)
            answer = m.Timesync(1000 * (OFFSET_US + round(RATE * at_us)), 1000 * asked_us, 255, 1)
            view.update(answer, now_us)
    return view, now_us


@pytest.mark.parametrize(("up_us", "down_us"), [(15_000, 15_000), (30_000, 0), (0, 30_000), (20_000, 20_000)])
def test_all_that_the_link_takes_counts_whichever_way(up_us: int, down_us: int) -> None:
    """A command of now acts when the vehicle's clock shows the time as seen now and the way there and back."""
    view, now_us = heard(up_us, down_us, 6.0)
    acts_us = OFFSET_US + round(RATE * (now_us + up_us))
    assert view.clock.vehicle_us(now_us) + view.way.late_us == pytest.approx(acts_us, abs=1_000)


def test_jitter_counts_as_it_is_most_often() -> None:
    view, _ = heard(10_000, 10_000, 6.0, jitter_us=6_000)
    assert view.way.late_us == pytest.approx(RATE * (20_000 + 3_000), abs=2_500)


def test_a_quick_link_is_none_at_all() -> None:
    assert heard(700, 700, 4.0)[0].way.late_us == 0


def test_a_link_that_gets_slower_is_followed_gently() -> None:
    way = CommandWay()
    for _ in range(10):
        way.answered(10_000, 10_000)
    assert way.late_us == 10_000
    told = []
    for _ in range(20):
        way.answered(40_000, 40_000)
        told.append(way.late_us)
    assert told[-1] == 40_000
    assert max(np.diff(told)) <= 4_000, "a reference that is looked up so much later moves no faster"
    way.answered(500_000, 500_000)
    assert way.late_us == 40_000, "one answer that hung is none"


def test_too_few_answers_say_nothing_and_what_is_less_than_nothing_is_nothing() -> None:
    way = CommandWay()
    way.answered(20_000, 20_000)
    way.answered(20_000, 20_000)
    assert way.late_us == 0
    for _ in range(20):
        way.answered(-1_000, 1_000)
    assert way.late_us == 0


@pytest.mark.parametrize("wrong_us", [500_000, -500_000, 2**62, -(2**62)])
def test_answers_by_another_clock_than_the_stamps_count_as_what_their_trips_took(wrong_us: int) -> None:
    """On a real PX4, 20 ms each way, answers half a second ahead flew figure8 half a second ahead of its reference."""
    way = CommandWay()
    for _ in range(600):
        way.answered(40_000 + wrong_us, 41_000)
    assert way.late_us == 41_000
    for _ in range(600):
        way.answered(wrong_us, 700)
    assert way.late_us == 0


def test_nothing_is_looked_up_further_ahead_than_any_link_that_is_flown() -> None:
    way = CommandWay()
    for _ in range(600):
        way.answered(10**7, 10**7)
    assert way.late_us == LATE_MOST_US
