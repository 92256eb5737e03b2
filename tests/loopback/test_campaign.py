"""Campaigns from the command line: the same rows whoever flies, killed or not; replays; one line for each mistake."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from flightstack.cli import main as cli
from flightstack.cli.campaign.single import fly_text
from flightstack.cli.campaign.table import flight_row
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.shipped import path_of

pq = pytest.importorskip("pyarrow.parquet")

FLIGHTS = 4
FILE = f"""
schema = "flightstack.campaign/1"
scenario = "hover"
seeds = {{from = 5, count = 100}}
design = "sobol"
count = {FLIGHTS}
[vary]
"body.mass_kg" = [1.0, 3.2, -1.0, 1.8]
"fly.learning" = [true, false]
"fly.duration" = 1.0
"""


def _start(folder: Path, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "flightstack", "campaign", *(str(argument) for argument in arguments)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def _run(folder: Path, *arguments: object) -> tuple[int, str, str]:
    with _start(folder, *arguments) as process:
        out, err = process.communicate(timeout=300)
    return process.returncode, out, err


def _rows(folder: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(folder / "flights.parquet").to_pylist()
    return rows


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of two workers."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "c.toml").write_text(FILE)
    code, out, err = _run(folder, "c.toml", "--out", "two", "--workers", 2)
    assert (code, err) == (0, "")
    assert f"{FLIGHTS} flights" in out
    assert "refused" in out
    return folder


def test_every_flight_is_a_row_the_heavy_ones_fail_and_what_is_no_vehicle_is_refused(flown: Path) -> None:
    rows = _rows(flown / "two")
    assert [row["flight"] for row in rows] == list(range(FLIGHTS))
    assert [row["seed"] for row in rows] == [5 + i for i in range(FLIGHTS)]
    assert sorted(row["body.mass_kg"] for row in rows) == [-1.0, 1.0, 1.8, 3.2]  # four points of Sobol's: each once
    for row in rows:  # four rotors of 6.6 N lift 2.69 kg
        if row["body.mass_kg"] == 3.2:
            assert row["outcome"] == "failed"
            assert (flown / "two" / row["log"]).is_file()
            assert (flown / "two" / row["report"]).is_file()
        elif row["body.mass_kg"] < 0.0:
            assert row["outcome"] == "refused"
            assert "body.mass_kg" in row["reason"]
        else:
            assert row["outcome"] == "completed"
    summary = json.loads((flown / "two/summary.json").read_text())
    assert summary["schema"] == "flightstack.campaign-result/1"
    assert summary["flights"] == FLIGHTS == sum(summary["outcomes"].values())
    rate = next(row for row in summary["rates"] if row["of"] == "completed")
    assert rate["rate"] == summary["outcomes"]["completed"] / FLIGHTS
    assert rate["ci95"][0] < rate["rate"] < rate["ci95"][1]
    assert summary["reflown"]["flights"] == summary["reflown"]["equal"]
    assert not (flown / "two/flying").exists()


def test_killed_and_resumed_by_one_worker_it_is_the_same_byte_for_byte(
    flown: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = _start(flown, "c.toml", "--out", "one", "--workers", 1)
    journal = flown / "one/journal.jsonl"
    while not journal.is_file() or journal.read_text().count("\n") < 2:
        with suppress(subprocess.TimeoutExpired):  # its processor time is the campaign's
            campaign.wait(0.02)
            break
    campaign.kill()
    campaign.communicate()
    lines = journal.read_text().splitlines()[1:]
    assert 1 <= len(lines) < FLIGHTS
    with pytest.raises(SystemExit) as stop:
        cli.main(["campaign", str(flown / "c.toml"), "--out", str(flown / "one")])
    err = capsys.readouterr().err
    assert (stop.value.code, err.count("\n")) == (2, 1)
    assert "--resume" in err
    code, _, err = _run(flown, "c.toml", "--out", "one", "--workers", 1, "--resume")
    assert (code, err) == (0, "")
    flights = [json.loads(line) for line in journal.read_text().splitlines()[1:]]
    assert [f["flight"] for f in flights[: len(lines)]] == [json.loads(line)["flight"] for line in lines]
    assert sorted(f["flight"] for f in flights if "outcome" in f) == list(range(FLIGHTS))
    for name in ("flights.parquet", "summary.json"):
        assert (flown / "one" / name).read_bytes() == (flown / "two" / name).read_bytes()


def test_a_replay_is_the_flight_itself(flown: Path) -> None:
    worst = json.loads((flown / "two/summary.json").read_text())["worst"][0]
    replay = FlyOptions(scenario=str(flown / "two" / worst["replay"]), out=flown / "again")
    result = fly(replay, stop_requested=lambda: "").as_json()
    row = _rows(flown / "two")[worst["flight"]]
    assert result["tracking"]["rmse_m"] == row["tracking.rmse_m"] == worst["value"]
    assert result["flight_time_s"] == row["flight_time_s"]
    assert result["seed"] == row["seed"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("body.mass_kg", "body.mas_kg"), "the nearest known one is body.mass_kg"),
        (('scenario = "hover"', 'scenario = "hovre"'), "no scenario named"),
        (('"flightstack.campaign/1"', '"flightstack.campaign/2"'), "is not known"),
        (("[vary]", "[vary"), "not valid TOML"),
    ],
)
def test_bad_files_are_one_line_and_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], words: str
) -> None:
    (tmp_path / "c.toml").write_text(FILE.replace(*change))
    with pytest.raises(SystemExit) as stop:
        cli.main(["campaign", str(tmp_path / "c.toml"), "--out", str(tmp_path / "x")])
    err = capsys.readouterr().err
    assert stop.value.code == 2
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert words in err
    assert not (tmp_path / "x").exists()


def test_a_flight_without_a_log_has_the_row_of_one_with_it(tmp_path: Path) -> None:
    text = (
        path_of("scenarios", "hover")
        .read_text()
        .replace("\n[trajectory]", "\n[flight]\nduration = 1.0\n\n[trajectory]")
    )
    rows = []
    for keep in ("none", "all"):
        flown = fly_text(text, tmp_path / keep, keep=keep, kept=False, on_progress=lambda share: None)
        assert (tmp_path / keep / "flight.mcap").is_file() is (keep == "all")
        entry = {"flight": 0, "seed": 0, "scenario": "hover", "values": {}, "log": None, "report": None}
        rows.append(flight_row(entry | {name: flown[name] for name in ("outcome", "reason", "result")}))
    assert rows[0] == rows[1]
    assert rows[0]["outcome"] == "completed"
