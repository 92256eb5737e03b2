"""What a shield says of a flight in which it flies nothing: else nobody would know why."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flightstack.cli.shield_words import ShieldWords

SECOND_US = 1_000_000


def said(*seen: tuple[float, bool, bool, float]) -> list[tuple[float, str]]:
    """When and what: of (until s, armed, placed, last heard s before), a hundred times a second."""
    words, now_s, lines = ShieldWords(), 0.0, []
    for until_s, armed, placed, before_s in seen:
        while now_s < until_s:
            now_s += 0.01
            router: Any = SimpleNamespace(
                system=1, is_lost=False, flies=True, origin_ned_m=np.zeros(3) if placed else None,
                after_stall=SimpleNamespace(look=list),
                view=SimpleNamespace(armed=armed, heard_at_us=round((now_s - before_s) * SECOND_US)),
            )  # fmt: skip
            lines += [(now_s, line) for line in words.look(router, round(now_s * SECOND_US))]
    return lines


def test_a_shield_that_is_started_in_flight_says_why_nothing_is_flown() -> None:
    """On a real PX4 it took 1,610 setpoints, passed none, OFFBOARD was refused, and it said nothing."""
    lines = said((10.0, True, False, 0.0), (20.0, False, False, 0.0), (30.0, True, True, 0.0))
    assert len(lines) == 1
    at_s, line = lines[0]
    assert at_s == pytest.approx(1.0, abs=0.05)
    assert "armed before the shield heard it" in line
    assert said((0.9, True, False, 0.0), (5.0, True, True, 0.0)) == []


def test_a_vehicle_that_is_not_heard_any_more_is_told_once_and_so_is_its_return() -> None:
    """A real PX4 that was killed: fifteen seconds without a word."""
    lines = said((5.0, True, True, 0.0), (20.0, True, True, 3.1), (25.0, True, True, 0.0))
    assert [line for _, line in lines] == [
        "nothing heard of the vehicle for 3 s: nothing is flown until it is",
        "the vehicle is heard again",
    ]
    assert [at_s for at_s, _ in lines] == pytest.approx([5.0, 20.0], abs=0.05)


def test_before_a_vehicle_is_known_nothing_is_said() -> None:
    router: Any = SimpleNamespace(system=0)
    assert ShieldWords().look(router, 60 * SECOND_US) == []


def test_satellites_that_are_lost_in_flight_are_told_once_each_time() -> None:
    words, lines = ShieldWords(), []
    quiet = {"system": 1, "origin_ned_m": np.zeros(3), "after_stall": SimpleNamespace(look=list),
             "view": SimpleNamespace(armed=True, heard_at_us=0)}  # fmt: skip
    for lost, flies in ((False, True), (True, False), (True, True), (True, True), (True, False), (True, True),
                        (False, True), (True, True)):  # fmt: skip
        router: Any = SimpleNamespace(is_lost=lost, flies=flies, **quiet)
        lines.append(words.look(router, 0))
    assert [bool(each) for each in lines] == [False, False, True, False, False, False, False, True]
    assert "the satellites are lost" in lines[2][0]
