"""`reproduce --quick`, flown over UDP: its rows against what is known of the paper, and the same run again.

Two minutes of processor time: the run itself is left to `make thorough`; `test_reproduce.py` runs all round the parts.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flightstack.cli.main import main
from flightstack_paper.run import ReproduceOptions, plants_of
from flightstack_paper.tracking import TrackingFlight, fly
from flightstack_paper.work import PartContext
from tests.thorough import ONLY_THEN

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one quick run."""
    folder = tmp_path_factory.mktemp("paper")
    with pytest.raises(SystemExit) as done:
        main(["reproduce", "--quick", "--out", str(folder), "--json", str(folder / "again.json")])
    assert done.value.code == 0
    return folder


@pytest.fixture(scope="module")
def rows(out: Path) -> dict[str, dict[str, Any]]:
    """Its rows by their ids."""
    found = json.loads((out / "results.json").read_text())
    assert found["schema"] == "flightstack.paper/1"
    assert found == json.loads((out / "again.json").read_text())
    for row in found["rows"]:
        assert set(row) == {"id", "claim", "paper", "ours", "unit", "holds", "note"}
        assert isinstance(row["holds"], bool)
        assert isinstance(row["ours"], float), row
        assert row["claim"]
        assert row["note"]
    return {row["id"]: row for row in found["rows"]}


def ours(rows: dict[str, dict[str, Any]], row_id: str, holds: bool) -> float:
    """The measured value of a row that must hold, or must not."""
    assert rows[row_id]["holds"] is holds, rows[row_id]
    return float(rows[row_id]["ours"])


@ONLY_THEN
def test_example_1(rows: dict[str, dict[str, Any]]) -> None:
    for name, printed, rate, lowered, best in (
        ("lyapunov", 2.58176, -2.96e-4, 2.5803, 2.585),
        ("barrier", 4.25294, -2.5e-5, 4.2511, 4.32),
    ):
        assert ours(rows, f"ex1-{name}-area", True) == pytest.approx(printed, abs=1e-3)
        assert ours(rows, f"ex1-{name}-least-rate", False) == pytest.approx(rate, rel=0.05)
        assert ours(rows, f"ex1-{name}-lowered-area", True) == pytest.approx(lowered, abs=1e-3)
        assert ours(rows, f"ex1-{name}-strict-area", False) >= best
    assert ours(rows, "ex1-ratio", True) == pytest.approx(1.647, abs=1e-3)
    assert ours(rows, "ex1-ratio-strict", True) == pytest.approx(1.672, abs=1e-3)


@ONLY_THEN
def test_learning_tracks_better_and_fast_enough(rows: dict[str, dict[str, Any]]) -> None:
    assert ours(rows, "tracking-rmse-ratio", True) < 0.15
    assert ours(rows, "tracking-rmse-over-pd", True) < 0.15
    assert ours(rows, "tracking-rmse-over-pid", True) < 1.0
    assert ours(rows, "inputs-without-position-ratio", True) < 0.2
    assert rows["gp-step-ms-max"]["ours"] > 0.0  # how long it takes is the machine's business


@ONLY_THEN
def test_the_region_grows_to_what_physics_allows_and_is_never_left(rows: dict[str, dict[str, Any]]) -> None:
    """mu of physics with the wind balanced by tilt: 0.6029; a certificate below it would be a lie."""
    assert ours(rows, "mu-initial", True) == pytest.approx(6.3)
    assert 0.6029 <= ours(rows, "mu-final", True) < 0.65
    assert 0.64 <= ours(rows, "mu-final-sound", False) < 1.5
    assert ours(rows, "barrier-violations", True) == 0.0
    assert 2.2 < ours(rows, "area-as-published", True) < np.pi * 0.6 / np.sqrt(0.6029)
    assert 2.0 < rows["area-sound"]["ours"] < 5.957  # the kernel of the exact model
    assert 0.3 < ours(rows, "area-left-by-margins", False) < 0.9
    assert ours(rows, "adaptive-vs-uniform-samples", True) < 0.5
    assert ours(rows, "adaptive-vs-uniform-samples-sound", True) < 0.5


@ONLY_THEN
def test_what_is_wrong_is_said_to_be(rows: dict[str, dict[str, Any]]) -> None:
    assert ours(rows, "mu-physics", False) == pytest.approx(0.602849, abs=2e-4)
    assert ours(rows, "mu-state-only", False) == pytest.approx(0.4247, abs=1e-4)
    assert ours(rows, "sampling-lemma", False) <= 0.5
    assert ours(rows, "filter-sampled-max-e", False) == pytest.approx(0.695, abs=0.1)
    assert ours(rows, "five-term-rate", False) == pytest.approx(-1.25, abs=5e-3)
    assert ours(rows, "gp-joint-confidence", False) == pytest.approx(0.756, abs=1e-3)


@ONLY_THEN
def test_every_figure_is_there_and_in_the_page(out: Path) -> None:
    figures = json.loads((out / "results.json").read_text())["figures"]
    page = (out / "report.html").read_text()
    assert [name[:4] for name in figures[:8]] == [f"fig{number}" for number in range(1, 9)]
    for name in figures:
        data = (out / name).read_bytes()
        assert data.startswith(PNG)
        assert len(data) > 10_000
    assert page.count("data:image/png;base64,") == len(figures)
    assert "://" not in page


@ONLY_THEN
def test_the_same_command_takes_up_what_is_there_and_writes_the_same(
    out: Path, rows: dict[str, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object) -> None:
        raise AssertionError("a part was computed again")

    monkeypatch.setattr("flightstack_paper.run.ProcessPoolExecutor", none)
    with pytest.raises(SystemExit) as done:
        main(["reproduce", "--quick", "--out", str(out)])
    assert done.value.code == 0
    again = json.loads((out / "results.json").read_text())["rows"]
    assert {row["id"]: row for row in again} == rows


@ONLY_THEN
def test_the_same_seed_flies_the_same_flight_and_another_does_not() -> None:
    first, again, other = (
        fly(TrackingFlight(plant="native", pilot="none", seed=seed, duration_s=2.0), PartContext(Path("unused")))
        for seed in (4, 4, 5)
    )
    assert first == again
    assert first["trace_m"] != other["trace_m"]


def test_a_quick_run_flies_the_native_plant_unless_another_is_named() -> None:
    assert plants_of(ReproduceOptions(out=Path("x"), quick=True)) == ("native",)
    assert plants_of(ReproduceOptions(out=Path("x"), plant="native")) == ("native",)
    assert plants_of(ReproduceOptions(out=Path("x")))[0] == "native"
