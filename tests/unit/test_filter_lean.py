"""How fast an engaged filter lets the vehicle lean: no faster than the governor stops it within the certificate."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from lagging_plant import authority
from shipped import load_vehicle
from test_safety_filter import HOVER_N, LIMITS, MODEL, QUAD, TILT, Hand, at, certified, command

from flightstack.barrier.torque import governor_terms
from flightstack.barrier.turning import turning
from flightstack.frames import quat_from_rotation_vector, quat_to_matrix
from flightstack.safety_filter import CHANGED, WAITING
from flightstack.types import changed

TERMS = governor_terms(load_vehicle("quad-x"), QUAD, LIMITS, (1e-3, 1e-3, 7e-4))
GOVERNED = dataclasses.replace(
    certified(4000),
    axes=tuple(
        dataclasses.replace(axis, authority=axis.authority if axis.axis == 2 else authority(-2.4, 2.4, 0.1))
        for axis in certified(4000).axes
    ),
    governor=TERMS,
)
MOST = math.sin(TILT) * math.sqrt(0.5)
INTO_THE_WIND = dataclasses.replace(
    GOVERNED,
    budget=dataclasses.replace(GOVERNED.budget, north_least=-0.05, east_least=-0.05, north_most=0.3, east_most=0.3),
)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("lean", "place", "speed"), [(-0.25, 0.1, 0.2), (-0.25, 0.2, 0.0), (-0.1, 0.2, 0.4), (0.1, 0.2, 0.6)]
)
def test_a_barrier_in_need_turns_the_lean_no_faster_than_can_be_stopped(
    axis: int, lean: float, place: float, speed: float
) -> None:
    """A lean rate w goes on for the time t0 and is then taken back at s: it stops at lean + w t0 + w^2 / (2 s)."""
    hand = Hand(GOVERNED).engaged()
    turn = np.zeros(3)
    turn[1 - axis] = math.asin(lean) * (1.0 if axis == 0 else -1.0)
    along = np.eye(3)[axis]
    seen = changed(at(), pos_ned_m=place * along, vel_ned_mps=speed * along, q_ned_frd=quat_from_rotation_vector(turn))
    r = quat_to_matrix(seen.q_ned_frd)
    assert r[axis, 2] == pytest.approx(lean)
    sent, filtered = hand.step(seen)
    w = float(sent.rate_frd_radps[1] * r[axis, 0] - sent.rate_frd_radps[0] * r[axis, 1])
    s, t0 = turning(TERMS, MODEL, GOVERNED.budget.low_mps2)
    assert filtered.status == CHANGED
    assert filtered.high_ned_mps2[axis] < -1.5  # of 2.4 that the barrier may want
    assert w > 0.2
    assert lean + w * t0 + w * w / (2.0 * s) <= MOST + 1e-3


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("lean", [0.0, 0.15])
def test_a_lean_keeps_within_its_own_axis_range_whatever_the_controller_wants(
    axis: int, way: float, lean: float
) -> None:
    hand = Hand(INTO_THE_WIND).engaged()
    turn, rate = np.zeros(3), np.zeros(3)
    turn[1 - axis] = math.asin(lean) * (1.0 if axis == 0 else -1.0)
    seen = changed(at(), q_ned_frd=quat_from_rotation_vector(turn))
    rate[1 - axis] = 6.0 * way * (1.0 if axis == 0 else -1.0)
    sent, _ = hand.step(seen, command(hand.t_us, HOVER_N, rate))
    r = quat_to_matrix(seen.q_ned_frd)
    w = float(sent.rate_frd_radps[1] * r[axis, 0] - sent.rate_frd_radps[0] * r[axis, 1])
    s, t0 = turning(TERMS, MODEL, INTO_THE_WIND.budget.low_mps2)
    end = lean + w * t0 + way * w * w / (2.0 * s)
    assert -0.05 - 1e-3 <= end <= 0.3 + 1e-3
    assert way * w > 0.1, "as far as the range reaches it is let through"


def stops_at(lean: float, lean_rate: float) -> float:
    """Where a governed lean comes to rest: it goes on for t0, then is taken back at s."""
    s, t0 = turning(TERMS, MODEL, INTO_THE_WIND.budget.low_mps2)
    return lean + lean_rate * t0 + lean_rate * abs(lean_rate) / (2.0 * s)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("lean", "lean_rate"), [(0.2, 1.2), (0.05, -1.0), (-0.1, 0.0), (0.35, -0.5)])
def test_it_does_not_engage_in_a_lean_that_cannot_be_stopped_within_the_range(
    axis: int, lean: float, lean_rate: float
) -> None:
    """The range is -0.05 to 0.3 to either side: engaged in such a lean a premise would break at once."""
    assert not -0.05 <= min(lean, stops_at(lean, lean_rate)) <= max(lean, stops_at(lean, lean_rate)) <= 0.3
    hand, turn, rate = Hand(INTO_THE_WIND), np.zeros(3), np.zeros(3)
    sign = 1.0 if axis == 0 else -1.0
    turn[1 - axis], rate[1 - axis] = math.asin(lean) * sign, lean_rate / math.cos(math.asin(lean)) * sign
    seen = changed(at(), q_ned_frd=quat_from_rotation_vector(turn), rate_frd_radps=rate)
    for _ in range(300):
        hand.sent = command(hand.t_us, HOVER_N, rate)
        sent, filtered = hand.step(seen, command(hand.t_us, HOVER_N, rate))
        assert (filtered.status, filtered.intervened) == (WAITING, 0.0)
        assert sent is hand.wanted
        assert hand.filter.governed(hand.state) is None
    hand.sent = command(hand.t_us, HOVER_N)
    hand.engaged()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_half_a_second_before_it_engages_the_lean_already_keeps_within_the_range(axis: int, way: float) -> None:
    hand, rate, sign = Hand(INTO_THE_WIND), np.zeros(3), 1.0 if axis == 0 else -1.0
    hand.step(at())
    rate[1 - axis] = 6.0 * way * sign
    sent, filtered = hand.step(at(), command(hand.t_us, HOVER_N, rate))
    assert (filtered.status, filtered.intervened) == (WAITING, 1.0)
    assert hand.filter.governed(hand.state) == TERMS.limits
    end = stops_at(0.0, float(sent.rate_frd_radps[1 - axis]) * sign)
    assert -0.05 - 1e-3 <= end <= 0.3 + 1e-3
    assert abs(sent.rate_frd_radps[1 - axis]) > 0.1, "as far as the range reaches it is let through"
    assert sent.thrust_n == pytest.approx(HOVER_N, rel=0.02)
