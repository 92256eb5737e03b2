"""What a certificate has to hold for, from how late ticks and messages were."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from measured import measured

from flightstack.barrier.lateness import Lateness, lateness_s
from flightstack.types import Measurement

PERIOD_S = 0.004


def at(t_us: int, imu_age_us: int = 4000) -> Measurement:
    return measured(
        t_us=t_us, pos_ned_m=np.zeros(3), vel_ned_mps=np.zeros(3), q_ned_frd=np.array([1.0, 0.0, 0.0, 0.0]),
        rate_frd_radps=np.zeros(3), specific_force_frd_mps2=np.array([0.0, 0.0, -9.8]),
        motor_command=np.full(4, math.nan), position_age_us=8000, attitude_age_us=4000, imu_age_us=imu_age_us,
    )  # fmt: skip


def after(gaps_ms: Sequence[float], ages_us: Sequence[int] = ()) -> Lateness:
    late, t_us = Lateness(), 0
    late.take(at(0))
    for gap_ms in gaps_ms:
        t_us += round(1000 * gap_ms)
        late.take(at(t_us))
    for age_us in ages_us:
        t_us += 4000
        late.take(at(t_us, age_us))
    return late


@pytest.mark.parametrize(
    ("gaps_ms", "held_ms"),
    [([4.0] * 9, 4.0), ([4.0, 4.49], 4.0), ([4.0, 4.6], 12.0), ([13.0, 4.0, 4.0], 12.0), ([300.0, 4.0], 12.0)],
)  # fmt: skip
def test_a_loop_that_was_late_once_is_certified_for_three_periods(gaps_ms: list[float], held_ms: float) -> None:
    assert after(gaps_ms).interval_s(PERIOD_S) == pytest.approx(1e-3 * held_ms)


def test_messages_are_as_late_as_all_but_one_tick_in_a_hundred_in_whole_milliseconds() -> None:
    rng = np.random.default_rng(3)
    ages_us = rng.integers(4000, 9_000, 5000)
    told = after([], ages_us.tolist()).jitter_s
    beyond = np.quantile(ages_us, 0.99) * 1e-6 - 0.006
    assert beyond <= told < beyond + 0.001
    assert np.mean(ages_us > 6000 + 1e6 * told) <= 0.01


def test_few_ticks_say_nothing_of_messages_and_no_more_than_four_milliseconds_are_certified_for() -> None:
    assert after([], [11_000] * 100).jitter_s == 0.0
    assert after([], [90_000] * 600).jitter_s == pytest.approx(0.004)
    assert after([4.0] * 1000).jitter_s == 0.0


def test_a_link_that_is_always_late_makes_samples_old_but_not_jittery() -> None:
    """20 to 23 ms: the age is that of all but one in a hundred, the jitter what comes beyond the quickest."""
    rng, late = np.random.default_rng(5), Lateness()
    for k, extra_us in enumerate(rng.integers(0, 3001, 2000).tolist()):
        seen = at(4000 * k, 20_000 + extra_us)
        seen.position_age_us, seen.attitude_age_us = 24_000 + extra_us, 20_000 + extra_us
        late.take(seen)
    assert late.age_s == pytest.approx(0.023)
    assert late.jitter_s <= 0.003
    assert after([], [0] * 600).age_s == 0.0
    assert after([], [90_000] * 600).age_s == pytest.approx(0.004), "the newest of the streams counts"


def test_the_latest_of_the_three_streams_counts_by_its_own_period() -> None:
    for ages_s, late_s in (((0.015, 0.0, 0.0), 0.003), ((0.0, 0.0095, 0.001), 0.002), ((0.012, 0.0075, 0.0), 0.0)):
        assert lateness_s(ages_s) == pytest.approx(late_s, abs=1e-12)
