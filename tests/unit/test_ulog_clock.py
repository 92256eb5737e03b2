"""A ULog whose clock jumps: what is true of each message's time is known here, as its file was written by it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flightstack.gap.checks.clocks import settle_clocks
from flightstack.gap.records import Signal
from flightstack_logs.reader import read
from flightstack_logs.tables import Log
from tests.ulog_bytes import as_logged, ulog

PERIODS_US = {"vehicle_attitude": 4000, "sensor_combined": 5000, "actuator_motors": 10_000, "battery_status": 200_000,
              "vehicle_land_detected": 1_000_000}  # fmt: skip
BEGINS_US, SECONDS = 7_000_000, 12
JUMP_US = 13_000_000


def content() -> bytes:
    topics = {}
    for name, period in PERIODS_US.items():
        t_us = np.arange(BEGINS_US, BEGINS_US + SECONDS * 1_000_000, period)
        topics[name] = ({"true_us": ("d", 1)}, np.column_stack([t_us, t_us]))
    bursts = np.repeat(np.arange(BEGINS_US, BEGINS_US + SECONDS * 1_000_000, 500_000), 4) + np.tile([0, 1, 2, 3], 24)
    topics["event"] = ({"true_us": ("d", 1)}, np.column_stack([bursts, bursts]))
    return ulog(topics, {}, begins_us=BEGINS_US)


def spoilt(folder: Path, stamp_us: Callable[[str, int], int]) -> Log:
    (folder / "log.ulg").write_bytes(as_logged(content(), stamp_us))
    return read(folder / "log.ulg")


def late_us(log: Log, name: str) -> np.ndarray:
    return log.tables[name].t_us - log.tables[name]["true_us"]


def test_a_good_clock_is_left_alone(tmp_path: Path) -> None:
    log = spoilt(tmp_path, lambda _, t: t)
    assert not any(late_us(log, name).any() for name in log.tables)
    assert len(log.tables["event"]) == 96
    assert log.notes == ()


@pytest.mark.parametrize("back_us", [40_000, 3_000_000, 12_900_000])
def test_a_clock_that_goes_back_goes_on_a_second_later_for_all_topics_alike(back_us: int, tmp_path: Path) -> None:
    log = spoilt(tmp_path, lambda _, t: t - back_us if t >= JUMP_US else t)
    for name, period in PERIODS_US.items():
        table = log.tables[name]
        assert len(table) == SECONDS * 1_000_000 // period
        assert np.all(np.diff(table.t_us) > 0)
        after = table["true_us"] >= JUMP_US
        assert not late_us(log, name)[~after].any()
        assert late_us(log, name)[after] == pytest.approx(1e6, abs=20e3)
    moved = {int(late_us(log, name)[-1]) for name in PERIODS_US}
    assert len(moved) == 1
    assert len(log.notes) == 1
    assert "its clock goes back by" in log.notes[0]


@pytest.mark.parametrize("jump_us", [-2_000_000, 2_000_000, 60_000_000, -400_000])
def test_a_topic_that_leaves_the_others_clock_is_left_out_from_there(jump_us: int, tmp_path: Path) -> None:
    log = spoilt(tmp_path, lambda name, t: t + jump_us * (name == "vehicle_attitude" and t >= JUMP_US))
    attitude = log.tables["vehicle_attitude"]
    assert attitude["true_us"][-1] < JUMP_US
    assert len(attitude) == (JUMP_US - BEGINS_US) // PERIODS_US["vehicle_attitude"]
    assert not any(late_us(log, name).any() for name in log.tables)
    assert "by another clock" in log.notes[0]
    assert "vehicle_attitude" in log.notes[0]


def test_single_wrong_stamps_are_left_out(tmp_path: Path) -> None:
    wrong = set(range(BEGINS_US + 1_000_000, BEGINS_US + SECONDS * 1_000_000, 700_000))
    log = spoilt(tmp_path, lambda name, t: t + (-1) ** (t // 100_000) * 5_000_000 * (name[0] == "v" and t in wrong))
    assert not late_us(log, "vehicle_attitude").any()
    assert not set(log.tables["vehicle_attitude"]["true_us"].astype(int)) & wrong


@pytest.mark.parametrize("stamp_us", [2**63 + 5, 2**64 - 1])
def test_stamps_that_no_clock_has_are_left_out_however_many(stamp_us: int, tmp_path: Path) -> None:
    """They were summed into times beyond 64 bits."""
    log = spoilt(tmp_path, lambda _, t: stamp_us if t // 1000 % 100 < 60 else t)
    table = log.tables["vehicle_attitude"]
    assert len(table) == pytest.approx(0.4 * SECONDS * 1e6 / PERIODS_US["vehicle_attitude"], rel=0.01)
    assert not late_us(log, "vehicle_attitude").any()
    assert any("another clock" in note for note in log.notes)


def test_topics_that_lie_one_behind_the_other_in_the_file_count_until_their_clock_goes_back(tmp_path: Path) -> None:
    """A converter's file: nothing is known of it but each topic's own order."""
    rows = np.arange(BEGINS_US, BEGINS_US + 8_000_000, 5000)
    said = np.where(rows >= JUMP_US, rows - 3_000_000, rows)
    topics = {name: ({"true_us": ("d", 1)}, np.column_stack([said, rows])) for name in PERIODS_US}
    (tmp_path / "log.ulg").write_bytes(ulog(topics, {}, begins_us=BEGINS_US))
    log = read(tmp_path / "log.ulg")
    assert all(not late_us(log, name).any() for name in log.tables)
    assert [len(table) for table in log.tables.values()] == [1200] * len(PERIODS_US)


def test_a_gap_of_all_topics_is_no_third_of_the_flight() -> None:
    t_s = np.arange(0.0, 40.0, 0.01)
    jumped = np.where(t_s < 20.0, t_s, t_s + 50.0)
    signals = {name: Signal(jumped, np.sin(t_s), name) for name in ("motor", "vel_ned_mps")}
    volts = np.array([0.0, 10.0, 30.0, 50.0, 69.0, 75.0])
    signals["battery_v"] = Signal(volts, volts, "battery_v")
    settled, findings = settle_clocks(signals, "ulog")
    steps = np.diff(settled["motor"].t_s)
    assert steps.max() == pytest.approx(2.0)
    assert np.sort(steps)[:-1] == pytest.approx(0.01)
    assert settled["battery_v"].t_s[[0, 1, 5]] == pytest.approx([0.0, 10.0, 75.0 - 48.01])
    assert np.all(np.diff(settled["battery_v"].t_s) >= 0.0)
    assert "put 2 s apart" in findings[-1].text


def test_a_short_gap_stays() -> None:
    t_s = np.arange(0.0, 40.0, 0.01)
    signals = {"motor": Signal(np.where(t_s < 20.0, t_s, t_s + 3.0), np.sin(t_s), "motor")}
    settled, findings = settle_clocks(signals, "ulog")
    assert np.array_equal(settled["motor"].t_s, signals["motor"].t_s)
    assert findings == []
