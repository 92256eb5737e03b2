"""Flights through the barrier filter, over UDP: it engages, it keeps inside, and what it says is in the log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from certified import for_the_papers_path, unchecked, write

from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.barrier.file import parse_certificate
from flightstack.barrier.premises import Premises
from flightstack.cli.files import load_vehicle
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.main import main
from flightstack.cli.result import FlightResult
from flightstack_logs.reader import Log, read
from flightstack_logs.topics import CERTIFICATE, FINAL_CERTIFICATE
from tests.thorough import ONLY_THEN


@pytest.fixture(autouse=True, scope="module")
def _unchecked() -> Iterator[None]:
    with unchecked():
        yield


def _fly(
    folder: Path, scenario: str, *, completes: bool = True, report: bool = False, **options: object
) -> tuple[FlightResult, Log]:
    folder.mkdir(exist_ok=True)
    result = fly(FlyOptions(scenario=scenario, out=folder, **options), report_wanted=lambda result: report)  # type: ignore[arg-type]
    assert result.completed is completes, result.reason
    return result, read(folder / "flight.mcap")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the certificates: of the whole region of the paper's path, and of a part too small for the path."""
    made, vehicle = tmp_path_factory.mktemp("barrier"), load_vehicle(None)[0]
    write(made / "whole.json", for_the_papers_path(), vehicle)
    write(made / "small.json", for_the_papers_path(0.8), vehicle)
    return made


@pytest.fixture(scope="module")
def tracked(folder: Path) -> tuple[FlightResult, Log]:
    """12 s of the paper's path inside its region."""
    given = folder / "whole.json"
    return _fly(folder / "tracked", "paper-tracking", report=True, duration_s=12.0, seed=21, certificate=given)


@pytest.fixture(scope="module")
def unfiltered(folder: Path) -> tuple[FlightResult, Log]:
    """The same without the filter, judged by the region in which it would be too fast."""
    small = folder / "small.json"
    return _fly(folder / "off", "paper-tracking", duration_s=12.0, seed=21, filtering=False, certificate=small)


def test_the_papers_path_is_flown_inside_its_region_with_the_filter_on(tracked: tuple[FlightResult, Log]) -> None:
    result, log = tracked
    assert result.passed, result.failure()
    assert result.barrier["enabled"]
    assert result.barrier["violations"] == 0
    assert result.barrier["min_h_truth"] > 0.0
    assert result.qp["infeasible"] == 0
    assert result.qp["solve_us"]["p50"] > 0.0
    assert result.gp["fed"] > 1000
    assert bool(log.tables["/vehicle/status"]["armed"].any())
    assert float(np.ptp(log.tables["/truth"]["pos_ned_m"][:, 0])) > 2.0
    acting = log.tables["/filter"]["status"] >= 2.0
    assert float(np.mean(acting[100:350])) == 1.0  # tick after tick, once it was up there
    assert result.region["filtered_ticks"] > 3000


def test_inside_its_region_the_filter_costs_no_accuracy(
    tracked: tuple[FlightResult, Log], unfiltered: tuple[FlightResult, Log]
) -> None:
    assert tracked[0].tracking["rmse_settled_m"] <= 1.3 * unfiltered[0].tracking["rmse_settled_m"]


def test_without_the_filter_its_fields_are_null_and_the_region_is_judged_all_the_same(
    unfiltered: tuple[FlightResult, Log],
) -> None:
    result, log = unfiltered
    assert "/filter" not in log.tables
    assert result.barrier == {
        "enabled": False, "min_h_truth": None, "min_h_estimate": None, "violations": None, "interventions": None,
        "protected": None, "engaged_share": None, "governor_share": None, "premises_broken": None,
    }  # fmt: skip
    assert result.protection == "off"
    assert result.qp["infeasible"] is None
    assert result.region["violations"] > 100
    assert result.passed


def test_a_path_that_leaves_the_region_is_bent_and_never_breaks_it(folder: Path) -> None:
    """The very path that leaves the small region unfiltered."""
    small = folder / "small.json"
    result, log = _fly(folder / "bent", "paper-tracking", duration_s=12.0, seed=21, certificate=small)
    assert result.passed, result.failure()
    assert result.barrier["violations"] == 0
    assert result.barrier["min_h_truth"] > 0.0
    assert result.barrier["interventions"] > 1000
    assert result.qp["infeasible"] == 0
    assert result.tracking["rmse_m"] > 0.05  # visibly
    told = [str(text) for name, text in zip(*(log.tables["/events"][k] for k in ("name", "text")), strict=True)
            if name == "filter"]  # fmt: skip
    assert [words.split(" (")[0].split(":")[1].strip() for words in told][:3] == [
        "certificate 5", "engaged", "first change",
    ]  # fmt: skip


def test_a_certificate_of_another_vehicle_is_falsified_in_flight_and_the_flight_lands(folder: Path) -> None:
    """It is true of a vehicle 1.4 times as heavy: thrust does 40 % more here than it says."""
    small = folder / "small.json"
    result, log = _fly(folder / "wrong", "hover", completes=False, duration_s=8.0, seed=25, certificate=small)
    assert "handed over" in result.reason
    assert 6.0 in log.tables["/filter"]["status"]
    assert abs(float(log.tables["/truth"]["pos_ned_m"][-1, 2])) < 0.1  # on the ground again
    assert float(np.abs(log.tables["/truth"]["vel_ned_mps"]).max()) < 3.0  # and nothing wild before


def test_what_is_in_the_json_is_what_the_log_shows(tracked: tuple[FlightResult, Log]) -> None:
    """h of the certificate's ellipses by the true states of the log, from when it counts to the command to land."""
    result, log = tracked
    truth, events = log.tables["/truth"], log.tables["/events"]
    named = zip(events.t_us, events["name"], events["text"], strict=True)
    phases = {str(text): int(t_us) for t_us, name, text in named if name == "phase"}
    flown = (truth.t_us >= phases["takeoff"]) & (truth.t_us < phases["land"])
    e = truth["pos_ned_m"][flown] - truth["pos_ned_m"][flown][0] - [0.0, 0.0, -1.5]
    x, y = e / [2.0, 1.5, 1.0], truth["vel_ned_mps"][flown] / [1.2, 1.35, 0.6]
    h = np.min(1.0 - (x * x + y * y + 2.0 * 0.3 * x * y) / (1.0 - 0.3**2), axis=1)
    engaged = round(25 * result.region["engaged_s"])
    assert (h[engaged - 10 : engaged] > 0.03).all()
    assert result.barrier["min_h_truth"] == pytest.approx(float(h[engaged:].min()), abs=0.01)


def test_the_log_carries_the_certificate_of_the_flight(folder: Path, tracked: tuple[FlightResult, Log]) -> None:
    result, log = tracked
    given = log.attachment(CERTIFICATE)
    last = log.attachment(FINAL_CERTIFICATE)
    assert given == (folder / "whole.json").read_bytes()
    assert last is not None
    assert parse_certificate(last.decode(), "attached").version == 5
    assert set(log.tables["/filter"]["version"][10:].tolist()) == {5.0}
    page = Path(str(result.report)).read_text()
    assert 'id="barrier-ledger"' in page
    assert 'id="barrier-solve"' in page


def test_the_papers_own_filter_flies_as_published(tmp_path: Path) -> None:
    result, log = _fly(tmp_path, "paper-barrier", duration_s=4.0, seed=23, as_published=True)
    assert result.barrier["enabled"]
    assert result.controller == "flatness"
    last = log.attachment(FINAL_CERTIFICATE)
    assert last is not None
    mu = parse_certificate(last.decode(), "attached").axes[2].barrier.rows[0][5]
    assert 0.6029 <= mu < 0.66  # from 6.3 towards what physics allows with 0.1 g aside, balanced by tilt (gravity 9.81)


def test_with_the_papers_learner_of_the_state_alone_it_claims_what_physics_refutes(tmp_path: Path) -> None:
    """So do 8 of the 10 seeds 20 to 29."""
    result, log = _fly(tmp_path, "paper-barrier", duration_s=4.0, seed=24, as_published=True, controller="state-gp")
    last = log.attachment(FINAL_CERTIFICATE)
    assert last is not None
    assert result.controller == "state-gp"
    mu = parse_certificate(last.decode(), "attached").axes[2].barrier.rows[0][5]
    # 1 / (0.6 m (thrust of hover less the weight)), that thrust with 1.4 times the mass and 0.1 g sideways
    assert 0.999 / 0.6 / ((1.4 * np.hypot(1.0, 0.1) - 1.0) * 9.80665) <= mu < 0.6


@ONLY_THEN
def test_a_filtered_flight_is_the_same_again_byte_for_byte(folder: Path) -> None:
    for name in ("a", "b"):
        given = folder / "small.json"
        _fly(folder / name, "paper-tracking", duration_s=3.0, seed=24, certificate=given)
    assert (folder / "a" / "flight.mcap").read_bytes() == (folder / "b" / "flight.mcap").read_bytes()


def test_a_link_slower_than_a_certificate_holds_for_is_refused_before_take_off(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """15 ms more each way, where the certificate counts commands as late as 10 ms; without the delay it flies."""
    given = for_the_papers_path()
    any_speed, any_lean, anything = ((-9.0, 9.0),) * 3, ((-1.0, 1.0),) * 2, (0.0, 99.0)
    premises = Premises(
        "mocap", "", EstimateBounds((0.02,) * 3, (0.1,) * 3, (0.2,) * 3, 4.3), any_speed, any_lean,
        anything, anything, anything, (0.004, 0.008), 0.002, 0.002, 0.004, anything,
    )  # fmt: skip
    path = write(folder / "late.json", replace(given, premises=premises), load_vehicle(None)[0])
    arguments = ["fly", "paper-tracking", "--duration", "2", "--certificate", str(path), "--out", str(folder / "late")]
    with pytest.raises(SystemExit) as stop:
        main([*arguments, "--fault", "link-delay:15"])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert "link too slow: " in error
    assert error.count("\n") == 1
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 0
