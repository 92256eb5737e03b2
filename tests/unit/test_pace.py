"""The pace of a real-time loop, against a clock that is told."""

from __future__ import annotations

import pytest

from mavlink_bridge import pace
from mavlink_bridge.pace import Pace


@pytest.mark.parametrize(("is_ahead", "spins"), [(True, True), (False, False)])
def test_who_shares_turns_sleeps_to_the_deadline_and_does_not_look_at_the_clock(
    monkeypatch: pytest.MonkeyPatch, is_ahead: bool, spins: bool
) -> None:
    """0.15 ms of every 4 are missing from the turns of a loop that has no priority: a thirtieth of a processor."""
    now_us, asked = [0], []

    def sleep_until_us(deadline_us: int, spin_us: int) -> None:
        asked.append((deadline_us, spin_us > 0))
        now_us[0] = deadline_us

    monkeypatch.setattr(pace, "sleep_until_us", sleep_until_us)
    monkeypatch.setattr(pace, "monotonic_us", lambda: now_us[0])
    loop = Pace(4_000, is_ahead=is_ahead)
    for _ in range(4):
        loop.wait()
        now_us[0] += 1_000
    assert asked == [(0, spins), (4_000, spins), (8_000, spins), (12_000, spins)]
    assert (loop.between_us, loop.missed) == (4_000, 0)
