"""Intervals against SciPy's exact ones, and factors whose influence is known beforehand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from flightstack.cli.campaign.journal import Journal
from flightstack.cli.campaign.statistics import clopper_pearson, holm, influences, worst
from flightstack.cli.campaign.table import flight_row, timing_row, write_tables
from flightstack.errors import InputError


@pytest.mark.parametrize(("hits", "trials"), [(0, 10), (10, 10), (3, 17), (1, 1000)])
def test_intervals_are_clopper_and_pearsons(hits: int, trials: int) -> None:
    exact = binomtest(hits, trials).proportion_ci(0.95, "exact")
    assert clopper_pearson(hits, trials) == pytest.approx((exact.low, exact.high), abs=1e-12)


def test_holm_by_hand() -> None:
    """3 x 0.01, then 2 x 0.02, then 0.03, which may not fall below the one before."""
    assert holm([0.02, 0.01, 0.03]) == pytest.approx([0.04, 0.03, 0.04])


def _entry(flight: int, values: dict[str, Any], failed: bool) -> dict[str, Any]:
    return {
        "flight": flight, "seed": flight, "scenario": "hover", "values": values, "log": None, "report": None,
        "outcome": "failed" if failed else "completed", "reason": "", "timing": {"wall_s": 1.0},
        "result": {"tracking": {"rmse_m": 0.1 * flight}, "wall_time_s": 3.0, "gp": {"step_us": {"p50": 1.0}}},
    }  # fmt: skip


def test_the_factor_that_drives_the_failures_leads() -> None:
    rng = np.random.default_rng(0)
    entries = []
    for i in range(300):
        mass, wind, fault = rng.uniform(1.0, 2.0), rng.uniform(0.0, 8.0), str(rng.choice(["none", "gps-loss"]))
        entries.append(_entry(i, {"mass": mass, "wind": wind, "fault": fault}, mass > 1.8))
    found = influences(entries, ["wind", "mass", "fault"])
    assert found[0].factor == "mass"
    assert found[0].effect == pytest.approx(1.0)
    assert "greater" in found[0].words
    assert all(each.p_value > 0.05 for each in found[1:])
    assert sum(each.flights for each in found[0].bins) == 300
    assert influences([_entry(0, {"mass": 1.0}, False)], ["mass"]) == []
    assert worst(entries, "tracking.rmse_m", True, 2) == [(299, pytest.approx(29.9)), (298, pytest.approx(29.8))]


def test_measured_times_stand_in_their_own_table() -> None:
    entry = _entry(3, {"mass": 1.0}, False)
    row, timing = flight_row(entry), timing_row(entry)
    assert row["tracking.rmse_m"] == pytest.approx(0.3)
    assert not {"wall_time_s", "gp.step_us.p50", "wall_s"} & set(row)
    assert {"wall_time_s", "gp.step_us.p50", "wall_s"} <= set(timing)


def test_the_same_entries_in_any_order_are_the_same_bytes(tmp_path: Path) -> None:
    entries = [_entry(i, {"mass": 1.0 + i, "fault": "none"}, i % 2 == 0) for i in range(20)]
    for name, order in (("a", entries), ("b", entries[::-1])):
        (tmp_path / name).mkdir()
        write_tables(order, tmp_path / name)
    assert (tmp_path / "a/flights.parquet").read_bytes() == (tmp_path / "b/flights.parquet").read_bytes()


HEAD = {"schema": "x", "campaign": "c", "version": "v"}


def test_a_journal_survives_whatever_cut_it_off(tmp_path: Path) -> None:
    journal = Journal(tmp_path, HEAD, resume=False)
    for i in range(3):
        journal.add(_entry(i, {}, False))
    journal.add(_entry(1, {"late": True}, True))  # a second row of a flight does not count
    journal.close()
    whole = journal.path.read_bytes()
    for cut in (len(whole), len(whole) - 1, whole.rfind(b"\n", 0, -1) + 10):
        journal.path.write_bytes(whole[:cut])
        again = Journal(tmp_path, HEAD, resume=True)
        known = 3 if cut == len(whole) else 2
        assert sorted(again.entries) == list(range(known))
        for i in range(3):
            again.add(_entry(i, {}, False))
        again.close()
        assert journal.path.read_bytes() == whole


def test_a_journal_of_something_else_is_refused(tmp_path: Path) -> None:
    Journal(tmp_path, HEAD, resume=False).close()
    with pytest.raises(InputError, match="--resume"):
        Journal(tmp_path, HEAD, resume=False)
    with pytest.raises(InputError, match="another campaign file"):
        Journal(tmp_path, HEAD | {"campaign": "d"}, resume=True)
    with pytest.raises(InputError, match="another version"):
        Journal(tmp_path, HEAD | {"version": "w"}, resume=True)
    first = Journal(tmp_path, HEAD, resume=True)
    with pytest.raises(InputError, match="another process"):
        Journal(tmp_path, HEAD, resume=True)
    first.close()


def test_a_full_disk_is_told_and_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import flightstack.cli.campaign.journal as module

    journal = Journal(tmp_path, HEAD, resume=False)
    write, full = module.os.write, True

    def on_full_disk(file: int, data: bytes) -> int:
        return write(file, data[: len(data) // 2]) if full else write(file, data)

    monkeypatch.setattr(module.os, "write", on_full_disk)
    journal.add(_entry(0, {}, False))
    journal.add(_entry(1, {}, False))
    assert "2 flights are not on disk yet" in journal.problem
    full = False
    journal.add(_entry(2, {}, False))
    assert journal.problem == ""
    journal.close()
    again = Journal(tmp_path, HEAD, resume=True)
    assert sorted(again.entries) == [0, 1, 2]
    again.close()
