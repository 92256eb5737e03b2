"""`make soak`: what it holds an hour of real time to."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.soak import shortcoming


def flown(
    p99_us: float, most_us: float, *, alone_us: float = 0.0, exit_code: int = 0, ahead: bool = True
) -> dict[str, Any]:
    loop = {"lateness_us": {"p50": 0.0, "p99": p99_us, "max": most_us}, "real_time_priority": ahead}
    return {"exit_code": exit_code, "reason": "why", "loop": loop, "bare": {"p99": alone_us}}


@pytest.mark.parametrize(
    ("name", "found", "words"),
    [
        ("real-time", flown(200.0, 2000.0), ""),
        ("real-time", flown(201.0, 2000.0), "late by 201 us (p99), 2000 us (most)"),
        ("real-time", flown(10.0, 2001.0), "late by 10 us (p99), 2001 us (most)"),
        ("real-time", flown(10.0, 1000.0, ahead=False), "the priority is not permitted here"),
        ("normal", flown(3600.0, 90_000.0, alone_us=3000.0), ""),
        ("normal", flown(3601.0, 4000.0, alone_us=3000.0), "late by 3601 us (p99) where a bare loop is by 3000"),
        ("normal", flown(1.0, 1.0, exit_code=3), "the flight was ended, why"),
    ],
)
def test_a_flight_is_held_to_what_is_asked(name: str, found: dict[str, Any], words: str) -> None:
    """0.2 ms (p99) and 2 ms (most) where real-time priority is granted; else 1.2 times a bare loop's p99."""
    assert shortcoming(name, found) == (f"{name}: {words}" if words else "")
