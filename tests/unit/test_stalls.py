"""What becomes of a stall that the dead-man answered, and what is said of it."""

from __future__ import annotations

from mavlink_bridge.dead_man_frames import NOBODY
from mavlink_bridge.stalls import Stalls

MS = 1_000_000


def test_the_words_are_of_the_stall_that_was_judged_whatever_is_reported_since() -> None:
    """A new silence resets the time of the Hold: 7 698 s after boot that read "Hold after -7698678 ms"."""
    stalls = Stalls()
    stalls.hear(NOBODY._replace(acts=1, silent_ns=7_000_000 * MS, hold_ns=7_000_062 * MS, alive_ns=7_000_070 * MS))
    assert stalls.is_held
    assert stalls.judge(7_000_000_000 + 130_000) == ""
    stalls.hear(NOBODY._replace(acts=2, silent_ns=7_698_678 * MS, hold_ns=0))
    assert stalls.words == "no setpoint for 130 ms, the dead-man commanded Hold after 62 ms"
    assert not stalls.is_held
