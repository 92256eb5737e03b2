"""Explorations that are refused before take-off; one that flies is in `test_provenance.py`."""

from __future__ import annotations

from pathlib import Path

import pytest

from flightstack.cli.main import main


def test_knowledge_that_leaves_no_authority_is_refused_before_take_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (Path(__file__).resolve().parents[2] / "flightstack/data/scenarios" / "paper-barrier.toml").read_text()
    scenario = tmp_path / "heavy.toml"
    scenario.write_text(text.replace("mass_ratio = [0.8, 1.5]", "mass_ratio = [0.8, 1.6]"))
    with pytest.raises(SystemExit) as done:
        main(["certify", "--scenario", str(scenario), "--out", str(tmp_path / "out")])
    assert done.value.code == 2
    assert "0.05 g" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("scenario", "what"), [("paper-barrier", "position down"), ("paper-tracking", "position")])
def test_sensors_that_are_too_rough_for_the_region_are_refused_before_take_off(
    scenario: str, what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as done:
        main(["certify", "--scenario", scenario, "--sensors", "gps", "--out", str(tmp_path / "out")])
    assert done.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert said.count("\n") == 1
    assert f"{what}" in said
    assert "the region's semi-axis is" in said
    assert not (tmp_path / "out").exists()
