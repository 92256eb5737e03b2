"""The verb `shield`, told to end: at once while it prepares, by a hand-over once it routes."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from flightstack.cli import shield as routing
from flightstack.cli.main import main

ASKED = ["shield", "--connect", "udpin:127.0.0.1:1", "--serve", "udpin:127.0.0.1:2", "--site", "a.toml"]


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Of this process, given back."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    kept = [signal.getsignal(number) for number in numbers]
    yield
    for number, handler in zip(numbers, kept, strict=True):
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("routes", [False, True])
def test_a_signal_ends_what_flies_nothing_at_once_and_asks_the_other_for_its_end(
    number: signal.Signals, routes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It waited for a PX4 that was not there, 20 s and more."""
    said: list[str] = []

    def run(options: object, *, stop_requested: Callable[[], str], on_progress: Callable[..., None]) -> dict[str, Any]:
        if routes:
            on_progress(0.0, "routing")
        signal.raise_signal(number)
        said.append(stop_requested())
        return {"setpoints": 0, "ticks": 0, "changed_share": 0.0, "vehicle_heard": True, "ended": ""}

    monkeypatch.setattr(routing, "shield", run)
    with pytest.raises(SystemExit) as ended:
        main(ASKED)
    assert ended.value.code == 130
    assert [bool(word) for word in said] == ([True] if routes else [])
