"""A flight of a campaign whose disk is full is flown without its log; it is not the flight that failed."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from flightstack.cli import flight
from flightstack.cli.campaign.single import fly_text
from flightstack.errors import InputError

FULL = os.strerror(errno.ENOSPC)


@dataclass
class Flown:
    """What `flight.fly` gives, as far as a campaign looks at it."""

    problem: str
    link_too_slow: bool = False
    contradictions: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        return not self.problem

    def failure(self) -> str:
        return self.problem

    def as_json(self) -> dict[str, Any]:
        return {"log_complete": not self.problem}


def _row(tmp_path: Path) -> dict[str, Any]:
    return fly_text("x", tmp_path / "flying", keep="failures", kept=False, on_progress=lambda share: None)


@pytest.mark.parametrize("where", ["at the log's opening", "in flight", "at the scenario"])
def test_a_full_disk_costs_the_log_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    def fly(options: Any, **_: Any) -> Flown:
        if options.out != tmp_path / "flying":
            return Flown("")
        if where == "in flight":
            return Flown(f"log flight.mcap: {FULL}; the log ends here")
        if where == "at the scenario":
            raise OSError(errno.ENOSPC, FULL)
        raise InputError(f"log flight.mcap: can't be written ({FULL}); choose another place")

    monkeypatch.setattr(flight, "fly", fly)
    row = _row(tmp_path)
    assert (row["outcome"], row["reason"]) == ("completed", "")
    assert row["result"] == {"log_complete": True}


def test_without_room_anywhere_it_counts_as_crashed_and_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flight, "fly", lambda options, **_: Flown(f"log flight.mcap: {FULL}; the log ends here"))
    row = _row(tmp_path)
    assert row["outcome"] == "crashed"
    assert FULL in row["reason"]


@pytest.mark.parametrize(
    ("keep", "kept", "written"), [("none", False, False), ("none", True, True), ("all", False, True)]
)
def test_a_log_that_nobody_keeps_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, keep: str, kept: bool, written: bool
) -> None:
    asked: list[bool] = []

    def fly(options: Any, **_: Any) -> Flown:
        asked.append(options.log_kept)
        return Flown("")

    monkeypatch.setattr(flight, "fly", fly)
    fly_text("x", tmp_path / "flying", keep=keep, kept=kept, on_progress=lambda share: None)
    assert asked == [written]
