"""Algorithm 1 over UDP: a short exploration that really flies, learns, grows and comes out with a file that holds."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit"))
from certificates import resealed

from flightstack.certificate_check import check
from flightstack.cli.certify import CertifyResult, certify
from flightstack.cli.flight import FlyOptions, prepare
from flightstack.cli.main import main
from flightstack.explore import ExploreConfig
from flightstack.types import InputError
from flightstack_logs.reader import Log, read
from tests.simulator import free_tcp_pair, watching

SHORT = ExploreConfig(axes=(2,), rounds_max=3)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> tuple[CertifyResult, list[dict[str, Any]]]:
    """One exploration of three rounds, and what the live page showed of it."""
    out, port = tmp_path_factory.mktemp("certify"), free_tcp_pair()
    options = FlyOptions(scenario="paper-barrier", seed=21, duration_s=60.0, out=out, live=port)
    with watching(port) as seen:
        return certify(options, stop_requested=lambda: "", config=SHORT), seen


@pytest.fixture(scope="module")
def flown(watched: tuple[CertifyResult, list[dict[str, Any]]]) -> tuple[CertifyResult, Log]:
    result, _ = watched
    assert result.flight.log is not None
    return result, read(result.flight.log)


def test_it_is_watched_while_it_grows(watched: tuple[CertifyResult, list[dict[str, Any]]]) -> None:
    _, seen = watched
    assert any(state["scene"].get("certified") for state in seen)
    assert any(state["now"].get("h") is not None for state in seen)


def test_it_really_flew_and_was_filtered_and_fed(flown: tuple[CertifyResult, Log]) -> None:
    result, log = flown
    assert result.flight.completed, result.flight.reason
    truth = log.tables["/truth"]
    height = -truth["pos_ned_m"][:, 2]
    assert height.max() > 0.7
    exploring = (height > 0.3) & (truth.t_us > truth.t_us[0] + 5_000_000)
    assert np.ptp(truth["vel_ned_mps"][exploring, 2]) > 0.5  # it went up and down
    assert result.flight.gp["fed"] > 1000
    status = log.tables["/filter"]["status"]
    assert (status >= 2.0).sum() > 100  # engaged: passed or changed


def test_the_region_grew_and_was_never_left(flown: tuple[CertifyResult, Log]) -> None:
    result, _ = flown
    assert result.state is not None
    areas = [row.area_m2ps for row in result.state.rounds]
    assert len(areas) >= 2
    assert areas[-1] > 1.02 * areas[0] or result.figures.area_m2ps > 1.2 * result.figures.area_initial_m2ps  # type: ignore[union-attr, operator]
    assert result.flight.barrier["violations"] == 0
    assert result.flight.qp["infeasible"] == 0
    found = result.as_json()
    assert found["mu_final"] >= found["mu_physics"]
    assert found["area_m2ps"] < found["area_kernel_m2ps"]
    assert found["samples"] < found["samples_uniform"]


def test_the_file_convinces_the_checker_and_not_once_a_number_is_changed(
    flown: tuple[CertifyResult, Log], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    result, _ = flown
    assert result.passed, result.failure()
    assert result.certificate is not None
    text = Path(result.certificate).read_text()
    assert check(text).valid
    with pytest.raises(SystemExit) as done:
        main(["certify", "--check", result.certificate])
    assert done.value.code == 0
    data = json.loads(text)
    data["axes"][0]["cells"][0][5] += 10.0
    changed = tmp_path / "changed.json"
    changed.write_text(json.dumps(data))
    with pytest.raises(SystemExit) as done:
        main(["certify", "--check", str(changed)])
    assert done.value.code == 1
    capsys.readouterr()
    with pytest.raises(SystemExit) as done:
        main(["certify", "--check", str(tmp_path / "missing.json")])
    assert done.value.code == 2
    assert capsys.readouterr().err.startswith("error:")


def test_what_came_out_may_be_flown_by_the_vehicle_and_sensors_that_it_names(
    flown: tuple[CertifyResult, Log], tmp_path: Path
) -> None:
    """With the independent checker asked, as `fly --certificate` does."""
    certificate = flown[0].certificate
    assert certificate is not None
    ready = prepare(FlyOptions(scenario="paper-barrier", certificate=Path(certificate))).flight.protection
    assert ready.given is not None
    assert ready.words.startswith("sound, certificate ")
    with pytest.raises(InputError, match="holds with mocap sensors, this flight has px4-sih"):
        prepare(FlyOptions(scenario="paper-barrier", certificate=Path(certificate), sensors="px4-sih"))
    data = json.loads(Path(certificate).read_text())
    data["axes"][0]["margins"][0]["mps2"] *= 0.5
    other = tmp_path / "other.json"
    other.write_text(resealed(data))
    with pytest.raises(InputError, match="the independent checker refuses it: "):
        prepare(FlyOptions(scenario="paper-barrier", certificate=other))


def test_the_page_lies_beside_the_flights_own(flown: tuple[CertifyResult, Log]) -> None:
    result, _ = flown
    assert result.report is not None
    assert "<svg" in Path(result.report).read_text()
    assert Path(result.report).with_name("flight.html").exists()


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
