"""A turn that the governor holds back is told: on a real PX4 MAVSDK asked for 40 deg/s, got 11, and nobody knew why."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flightstack.cli.shield_turns import HeldTurns

TICK_US, YAW_MAX = 4_000, 0.0154
_GYRO = np.random.default_rng(0)


def tick(t_us: int, asked: float, flown: float, sent: float, *, governed: bool = True) -> Any:
    rates = (SimpleNamespace(rate_frd_radps=np.array((0.0, 0.0, yaw))) for yaw in (asked, flown, sent))
    proposal, measurement, command = rates
    record = SimpleNamespace(t_us=t_us, proposal=proposal, measurement=measurement, command=command, governed=governed)
    return SimpleNamespace(flies=True, record=record)


def said(turns: HeldTurns, asked: float, flown: float, sent: float, seconds: float, begin_s: float = 0.0) -> list[str]:
    """deg/s; the gyro is as noisy as SIH's."""
    lines = []
    for n in range(1, round(1e6 * seconds / TICK_US)):
        noisy = math.radians(flown) + _GYRO.normal(0.0, 0.03)
        governed = asked != sent
        seen = tick(
            round(1e6 * begin_s) + n * TICK_US, math.radians(asked), noisy, math.radians(sent), governed=governed
        )
        lines += turns.look(seen)
    return lines


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_asked_what_is_flown_and_why_is_said_once(sign: float) -> None:
    turns = HeldTurns(YAW_MAX)
    lines = said(turns, sign * 40.0, sign * 11.0, sign * 13.0, 20.0)
    assert len(lines) == 1
    assert "asks to turn at 40 deg/s and gets 11:" in lines[0]
    assert "1.5 %" in lines[0]
    result = turns.as_json()
    assert result is not None
    assert result["seconds"] == pytest.approx(18.0, abs=0.1), "whole windows of 3 s"
    assert result["asked_radps"] == pytest.approx(math.radians(40.0))
    assert result["flown_radps"] == pytest.approx(math.radians(11.0), abs=0.01)
    assert result["torque_share"] == YAW_MAX
    assert "18 s" in turns.summary


def test_a_rate_that_is_reached_is_not() -> None:
    turns = HeldTurns(YAW_MAX)
    assert not said(turns, 40.0, 15.0, 18.0, 1.9)  # quad-x on its way there
    assert not said(turns, 40.0, 40.0, 40.0, 10.0, begin_s=1.9)
    assert not turns.summary
    assert turns.as_json() is None


def test_nor_is_one_that_others_cut() -> None:
    turns, router = HeldTurns(YAW_MAX), None
    for n in range(1, 5_000):
        router = tick(n * TICK_US, 0.7, 0.2, 0.2, governed=False)
        assert not turns.look(router)


def test_nor_is_what_nobody_flies_or_what_goes_to_and_fro() -> None:
    turns = HeldTurns(YAW_MAX)
    for n in range(1, 5_000):
        sign = 1.0 if n // 250 % 2 else -1.0
        seen = tick(n * TICK_US, sign * 0.7, sign * 0.1, sign * 0.2)
        assert not turns.look(seen)
    seen.flies = False
    assert not turns.look(seen)
    assert not turns.look(SimpleNamespace(flies=True, record=None))


def test_a_second_turn_is_told_after_a_minute_at_the_soonest() -> None:
    turns = HeldTurns(YAW_MAX)
    assert said(turns, 40.0, 11.0, 13.0, 6.5)
    assert not said(turns, 0.0, 0.0, 0.0, 5.0, begin_s=6.5)
    assert not said(turns, 40.0, 11.0, 13.0, 6.5, begin_s=12.0)
    assert not said(turns, 0.0, 0.0, 0.0, 60.0, begin_s=18.5)
    assert said(turns, 40.0, 11.0, 13.0, 6.5, begin_s=79.0)
