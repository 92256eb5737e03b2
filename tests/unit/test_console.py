"""The console of a simulated vehicle: warnings once in a while, and never so many that a pipe fills."""

from __future__ import annotations

from flightstack_sim.autopilot.notices import CRITICAL, INFO, Notice
from flightstack_sim.console import AGAIN_AFTER_US, MOST_LINES, Console

PIPE_BYTES = 65_536
"""What Linux's pipe holds (pipe(7))."""


def test_a_warning_is_a_line_once_in_a_while_and_information_is_none() -> None:
    console = Console()
    for at_us in (0, 1, AGAIN_AFTER_US - 1, AGAIN_AFTER_US):
        console.add(Notice(0, 0, b"", CRITICAL, "no\t"), at_us)
        console.add(Notice(0, 0, b"", INFO, "yes"), at_us)
    assert console.take() == [(0, "no"), (AGAIN_AFTER_US, "no")]
    assert console.take() == []


def test_a_hostile_client_fills_nobodys_pipe() -> None:
    console, size = Console(), 0
    for k in range(100_000):
        console.add(Notice(0, 0, b"", CRITICAL, f"{k:0200d}"), k * AGAIN_AFTER_US)
        size += sum(len(text) + 40 for _, text in console.take())
    assert 200 * MOST_LINES <= size < PIPE_BYTES
