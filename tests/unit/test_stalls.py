"""What becomes of a stall that the dead-man answered, and what is said of it."""

from __future__ import annotations

import pytest

from mavlink_bridge import px4
from mavlink_bridge.dead_man_frames import NOBODY
from mavlink_bridge.stalls import Stalls

MS = 1_000_000
SECOND_US = 1_000_000


def test_the_words_are_of_the_stall_that_was_judged_whatever_is_reported_since() -> None:
    """A new silence resets the time of the Hold: 7 698 s after boot that read "Hold after -7698678 ms"."""
    stalls = Stalls()
    stalls.hear(NOBODY._replace(acts=1, silent_ns=7_000_000 * MS, hold_ns=7_000_062 * MS, alive_ns=7_000_070 * MS))
    assert stalls.is_held
    assert stalls.judge(7_000_000_000 + 130_000) == ""
    stalls.hear(NOBODY._replace(acts=2, silent_ns=7_698_678 * MS, hold_ns=0))
    assert stalls.words == "no setpoint for 130 ms, the dead-man commanded Hold after 62 ms"
    assert not stalls.is_held


def _stalled(stalls: Stalls, acts: int, began_us: int, stall_us: int, *, is_taking_back: bool = False) -> str:
    """The verdict on a stall."""
    ended_us = began_us + stall_us
    hold_ns = (began_us + 60_000) * 1000
    stalls.hear(NOBODY._replace(acts=acts, silent_ns=began_us * 1000, hold_ns=hold_ns, alive_ns=ended_us * 1000))
    assert stalls.is_held
    return stalls.judge(ended_us, is_taking_back=is_taking_back)


def test_offboard_is_taken_back_at_most_once_in_ten_seconds() -> None:
    stalls = Stalls()
    assert _stalled(stalls, 1, 5 * SECOND_US, 100_000) == ""
    assert "taken back 9.9 s ago already" in _stalled(stalls, 2, 14_900_000, 100_000)
    assert _stalled(stalls, 3, 15_000_000, 100_000) == ""


def test_stalls_while_offboard_is_being_taken_back_may_last_a_second_in_all() -> None:
    stalls = Stalls()
    assert _stalled(stalls, 1, 5 * SECOND_US, 400_000) == ""
    assert _stalled(stalls, 2, 5_500_000, 400_000, is_taking_back=True) == ""
    assert "nobody steered for 1.1 s" in _stalled(stalls, 3, 6_000_000, 100_000, is_taking_back=True)


@pytest.mark.parametrize(
    ("hold_seen", "mode", "after_us", "answered", "late"),
    [(False, px4.MODE_HOLD, 900_000, True, True), (False, px4.MODE_HOLD, 1_100_000, True, False),
     (True, px4.MODE_HOLD, 1, True, False), (False, px4.MODE_LAND, 1, True, False),
     (False, px4.MODE_HOLD, 900_000, False, False)],
)  # fmt: skip
def test_a_hold_that_was_taken_for_lost_is_known_when_it_comes(
    hold_seen: bool, mode: int, after_us: int, answered: bool, late: bool
) -> None:
    """A PX4 on a busy machine obeyed 0.24 s later; once seen, or not granted to us, Hold is a pilot's."""
    stalls = Stalls()
    stalls.mode_was_granted(SECOND_US)  # OFFBOARD, long before
    assert _stalled(stalls, 1, 5 * SECOND_US, 100_000) == ""
    back_us = 5 * SECOND_US + 230_000
    stalls.is_back(back_us, hold_seen=hold_seen)
    if answered:
        stalls.mode_was_granted(back_us)
    assert stalls.is_late_hold(mode, back_us + after_us) is late


@pytest.mark.parametrize(
    ("mode", "after_us", "said"),
    [(px4.MODE_HOLD, 400_000, ", 0.4 s after the dead-man had asked for Hold"), (px4.MODE_HOLD, 1_000_001, ""),
     (px4.MODE_LAND, 400_000, "")],
)  # fmt: skip
def test_a_hold_that_may_be_the_dead_mans_is_not_told_as_a_pilots(mode: int, after_us: int, said: str) -> None:
    """A PX4 on a busy machine obeyed 0.25 s late, in the next silence, whose report knows of no Hold."""
    stalls = Stalls()
    assert stalls.asked_lately(px4.MODE_HOLD, 0) == ""
    stalls.hear(NOBODY._replace(acts=3, silent_ns=5_000 * MS, hold_ns=5_070 * MS, alive_ns=5_080 * MS))
    stalls.hear(NOBODY._replace(acts=4, silent_ns=5_200 * MS, hold_ns=0, touched=1, alive_ns=5_330 * MS))
    assert not stalls.own_hold(mode)
    assert stalls.asked_lately(mode, 5_070_000 + after_us) == said
