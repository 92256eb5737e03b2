"""A recorded flight's inputs through today's stack: the same outputs bit for bit, and what changed is told."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit"))
from log_samples import tick_record

from flightstack.cli import certify as certify_module
from flightstack.cli import replay as module
from flightstack.cli.certify import certify
from flightstack.cli.flight import FlyOptions, fly, prepare
from flightstack.cli.main import main
from flightstack.cli.replay import replay
from flightstack.types import InputError
from flightstack_logs.reader import Log, read
from flightstack_logs.topics import Attachment
from flightstack_logs.writer import FlightLog


def flown(folder: Path, **options: Any) -> Path:
    result = fly(FlyOptions(out=folder, **options), report_wanted=lambda result: False)
    assert result.completed, result.reason
    return folder / "flight.mcap"


@pytest.fixture(scope="module")
def hovered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown(tmp_path_factory.mktemp("hover"), scenario="hover", duration_s=2.0, learning=False)


def test_a_flight_with_learner_and_filter_on_a_bad_link_is_the_same_bit_for_bit(tmp_path: Path) -> None:
    log = flown(tmp_path, scenario="paper-tracking", duration_s=4.0, seed=3, fault="link-degraded")
    again = replay(log)
    assert again.differences == []
    assert again.ticks > 1000
    assert again.lines == [f"{again.ticks} ticks: the same, bit for bit"]


def test_an_exploration_is_planned_again_the_same_bit_for_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its path, its certificates and its commands come of the recorded inputs alone.

    Other rules are refused: `test_provenance.py` has flown by such.  What is designed after landing is not replayed.
    """
    monkeypatch.setattr(certify_module, "settle", lambda certifier, last: [])
    options = FlyOptions(scenario="paper-barrier", seed=2, duration_s=12.0, out=tmp_path / "own")
    log = certify(options, stop_requested=lambda: "").flight.log
    assert log is not None
    again = replay(Path(log))
    assert again.lines == [f"{again.ticks} ticks: the same, bit for bit"]
    assert again.ticks > 3000


def test_settings_that_are_no_number_are_one_line(hovered: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = read(hovered)
    settings = {**whole.metadata["settings"], "planner": "ExplorationPlanner", "explore_s": "x"}
    monkeypatch.setattr(
        module,
        "read",
        lambda path, **how: dataclasses.replace(whole, metadata={**whole.metadata, "settings": settings}),
    )
    with pytest.raises(InputError, match="rules that it does not name"):
        replay(hovered)


def test_another_controller_shows_from_its_first_tick_on(
    hovered: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "prepare", lambda options: prepare(dataclasses.replace(options, controller="px4")))
    with pytest.raises(SystemExit) as stop:
        main(["log", "replay", str(hovered), "--json", str(tmp_path / "r.json")])
    assert stop.value.code == 1
    data = json.loads((tmp_path / "r.json").read_text())
    assert data["same"] is False
    first = data["differences"][0]
    assert first["first_s"] < 6.0  # at take-off
    assert any(row["topic"] == "/command" and row["greatest"] > 0.0 for row in data["differences"])
    assert f"differs from {first['first_s']:.3f} s on" in capsys.readouterr().out


def test_a_tolerance_lets_small_differences_pass(hovered: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if another machine had recorded it: thrusts off by a few units of the last place."""

    def elsewhere(path: Path, **how: Any) -> Log:
        log = read(path)
        if path == hovered:
            columns = log.tables["/command"].columns
            columns["thrust_n"] = columns["thrust_n"] * (1.0 + 1e-13)
        return log

    monkeypatch.setattr(module, "read", elsewhere)
    (only,) = replay(hovered).differences
    assert (only.topic, only.field) == ("/command", "thrust_n")
    assert only.greatest is not None
    assert 0.0 < only.greatest < 1e-10
    assert replay(hovered, tolerance=1e-9).differences == []


def test_what_never_armed_and_what_is_no_such_flight_is_one_line(hovered: Path, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,vel_n_mps,vel_e_mps,vel_d_mps\n0,0,0,0\n1,0,0,0\n")
    with pytest.raises(InputError, match="holds no flight"):
        replay(tmp_path / "a.csv")
    log = FlightLog.open(tmp_path / "b.mcap", metadata={"settings": {"pace": "lockstep"}})
    log.mavlink("rx", 0, b"x")
    log.close()
    with pytest.raises(InputError, match="nothing to replay"):
        replay(tmp_path / "b.mcap")
    whole = read(hovered)
    more = [*whole.attachments, Attachment("..", "", b"x"), Attachment("", "", b"x")]
    log = FlightLog.open(tmp_path / "d.mcap", metadata=whole.metadata, attachments=more)
    log.tick(tick_record(4000))
    log.close()
    with pytest.raises(InputError, match="has not kept all"):
        replay(tmp_path / "d.mcap")
    for settings, text, why in (
        ({"pace": "realtime", "connect": "udpin:127.0.0.1:14540"}, "", "when each step was"),
        ({"pace": "realtime"}, "filter: certifies nothing more (its process has ended)", "was lost"),
    ):
        log = FlightLog.open(tmp_path / "c.mcap", metadata={"settings": settings}, overwrite=True)
        log.tick(tick_record(4000))
        log.event(4000, "filter", text)
        log.close()
        with pytest.raises(InputError, match=why):
            replay(tmp_path / "c.mcap")


def test_a_flight_in_a_site_is_replayed_in_its_site(tmp_path: Path) -> None:
    site = tmp_path / "site.toml"
    site.write_text('schema = "flightstack.site/1"\ninside = [[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]]\n')
    again = replay(flown(tmp_path, scenario="hover", duration_s=1.0, learning=False, site=site))
    assert again.lines == [f"{again.ticks} ticks: the same, bit for bit"]
