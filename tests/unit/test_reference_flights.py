"""The reference flights of the repository through today's stack: outputs as recorded, to 1e-9 on the same kind of
processor."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import reference_flights as reference
from flightstack.jit import machine_key


@pytest.mark.parametrize("name", reference.FLIGHTS)
def test_todays_stack_does_what_is_recorded(name: str) -> None:
    today = reference.outputs(reference.FOLDER / f"{name}.mcap")
    assert len(today) > 15
    recorded = reference.read_outputs(reference.FOLDER / f"{name}.csv")
    assert reference.differences(recorded, today, reference.allowed()) == []


def test_a_change_is_told_with_its_column_its_first_time_and_its_size(tmp_path: Path) -> None:
    rows = [{"t_s": 0.2 * k, "h": 0.5, "thrust": float("nan")} for k in range(5)]
    reference.write_outputs(rows, tmp_path / "a.csv")
    then = reference.read_outputs(tmp_path / "a.csv")
    assert reference.differences(then, rows) == []
    changed = [dict(row, h=row["h"] + (2e-9 if row["t_s"] > 0.5 else 0.0)) for row in rows]
    (told,) = reference.differences(then, changed)
    assert told.startswith("h: from 0.600 s on")
    assert told.endswith("by 2e-09 at most")
    assert reference.differences(then, rows[:-1]) == ["other ticks: 5 rows recorded, 4 today"]


def test_on_another_processor_more_is_allowed_and_only_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "processor.txt"
    monkeypatch.setattr(reference, "_PROCESSOR", file)
    file.write_text(f"{machine_key()} this\n")
    assert reference.allowed() == reference.TOLERANCE == 1e-9
    file.write_text("0123456789ab another\n")
    assert reference.allowed() == reference.OTHER_TOLERANCE


def test_the_files_are_small() -> None:
    sizes = [path.stat().st_size for path in reference.FOLDER.iterdir()]
    assert sum(sizes) < 900_000
