"""From options to what keeps a flight inside its region, and one line where options, file and vehicle don't fit."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from certificates import certificate as proven
from certificates import resealed
from certified import certificate, unchecked, write
from shipped import ROOT, load_vehicle

from flightstack.barrier.file import certificate_to_json, parse_certificate
from flightstack.barrier.growing import GrowingCertifier
from flightstack.barrier.published_filter import PublishedFilter
from flightstack.barrier.records import Budget, Certificate
from flightstack.cli import protection
from flightstack.cli.barrier_score import TimedFilter
from flightstack.cli.files import TextFile
from flightstack.cli.flight import FlyOptions
from flightstack.cli.offboard import OffboardOptions
from flightstack.cli.preparation import Prepared, prepare_flight
from flightstack.cli.workshop import Appointed
from flightstack.learning.stored import vehicle_hash
from flightstack.safety_filter import BarrierFilter
from flightstack.types import InputError


@pytest.fixture(autouse=True)
def _unchecked(request: pytest.FixtureRequest) -> Iterator[None]:
    """Most certificates here are made up; those of tests marked so go through the checker."""
    if "checked" in request.keywords:
        yield
        return
    with unchecked():
        yield


def prepared(scenario: str = "paper-tracking", **options: Any) -> Prepared:
    return prepare_flight(FlyOptions(scenario=scenario, **options))


def file_of(tmp_path: Path, **changes: Any) -> Path:
    """A certificate for the shipped vehicle, or what is made of it."""
    path = write(tmp_path / "mine.json", certificate(**changes), load_vehicle("quad-x"))
    if "knowledge" in changes:
        path.write_text(certificate_to_json(certificate(**changes)))
    return path


def inside(safety_filter: object) -> object:
    """The filter whose steps are timed."""
    assert isinstance(safety_filter, TimedFilter)
    return safety_filter._filter


def refused(**options: Any) -> str:
    """The one line that is said."""
    with pytest.raises(InputError) as error:
        prepared(**options)
    assert "\n" not in str(error.value)
    return str(error.value)


# ---------------------------------------------------------------- which filter


def test_where_the_scenario_has_a_region_the_filter_is_on_and_its_steps_are_timed() -> None:
    flight = prepared()
    assert isinstance(inside(flight.stack.filter), BarrierFilter)
    assert flight.stack.certifier.enabled
    assert flight.protection.region is flight.scenario.region
    assert flight.settings["filter"].startswith("sound")


def test_no_filter_means_none_and_the_region_still_judges() -> None:
    flight = prepared(filtering=False)
    assert not flight.stack.filter.enabled
    assert not flight.stack.certifier.enabled
    assert flight.settings["filter"] == "off: --no-filter"
    assert flight.protection.region is flight.scenario.region


def test_in_real_time_certificates_are_made_beside_the_flight(tmp_path: Path) -> None:
    """A certificate takes many ticks' time to make: a tick of real time does not wait for it."""
    offboard = prepare_flight(OffboardOptions(connect="", scenario="paper-tracking"))
    for flight in (prepared(realtime=True), offboard):
        assert isinstance(inside(flight.stack.filter), BarrierFilter)
        assert flight.settings["filter"].startswith("sound")
        assert flight.protection.workshop is not None
        assert flight.protection.watched is not None
        assert flight.protection.watched.elsewhere is flight.protection.workshop
    lockstep = prepared().protection
    assert isinstance(lockstep.workshop, Appointed)
    assert lockstep.watched is not None
    assert lockstep.watched.elsewhere is lockstep.workshop
    given = prepared(realtime=True, certificate=file_of(tmp_path))
    assert given.stack.filter.enabled
    assert given.protection.workshop is None


def test_in_real_time_what_the_paper_publishes_is_not_certified_in_flight() -> None:
    flight = prepared(realtime=True, as_published=True)
    assert not flight.stack.filter.enabled
    assert "real time does not wait" in flight.settings["filter"]


def test_a_scenario_without_a_region_flies_unfiltered_and_says_why() -> None:
    flight = prepared("hover")
    assert not flight.stack.filter.enabled
    assert flight.settings["filter"] == "off: the scenario has no region, and no --certificate was given"


def test_a_certificate_makes_any_scenario_fly_inside_it(tmp_path: Path) -> None:
    path = file_of(tmp_path, version=7)
    flight = prepared("figure8", certificate=path)
    assert isinstance(inside(flight.stack.filter), BarrierFilter)
    assert flight.protection.region is None  # it is judged by the certificate
    watched = flight.protection.watched
    assert watched is not None
    _, first = watched.step(watched.init(), None, *[None] * 3)  # type: ignore[arg-type]
    assert first is not None
    assert (first.version, first.mode) == (7, "sound")
    assert flight.settings["certificate"] == str(path)
    (text,) = [item.data.decode() for item in flight.attachments if item.name == "certificate.json"]
    assert parse_certificate(text, "attached").version == 7


def test_a_certificate_without_a_filter_judges_only(tmp_path: Path) -> None:
    flight = prepared("figure8", certificate=file_of(tmp_path), filtering=False)
    assert not flight.stack.filter.enabled
    assert flight.protection.watched is not None
    assert flight.settings["filter"] == "off: --no-filter"


def test_as_published_flies_the_papers_filter_and_at_will_its_learner() -> None:
    flight = prepared("paper-barrier", as_published=True)
    assert isinstance(inside(flight.stack.filter), PublishedFilter)
    assert flight.settings["controller"] == "flatness"
    assert flight.settings["filter"].startswith("as-published")
    state_only = prepared("paper-barrier", as_published=True, controller="state-gp")
    assert isinstance(inside(state_only.stack.filter), PublishedFilter)
    learner: Any = state_only.stack.learner
    assert learner._learner.config == prepared("paper-barrier", controller="state-gp").stack.learner._learner.config  # type: ignore[attr-defined]


def test_an_ellipsoid_is_certified_up_and_down_in_a_region_that_grows() -> None:
    watched = prepared("paper-barrier").protection.watched
    assert watched is not None
    assert isinstance(watched._certifier, GrowingCertifier)
    assert set(watched._certifier._first.safe) == {0, 1, 2}
    assert watched._certifier._first.config.axes == (2,)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"learning": False}, "without the learner"),
        ({"controller": "pid"}, "without the learner"),
        ({"controller": "dob"}, "without the learner"),
        ({"controller": "state-gp"}, "of the state alone"),
    ],
)
def test_without_a_learner_that_can_certify_the_filter_flies_under_a_given_certificate_only(
    tmp_path: Path, options: dict[str, Any], words: str
) -> None:
    flight = prepared(**options)
    assert not flight.stack.filter.enabled
    assert words in flight.settings["filter"]
    assert flight.protection.region is flight.scenario.region
    assert prepared(certificate=file_of(tmp_path), **options).stack.filter.enabled


def test_the_certifier_counts_on_the_scenarios_knowledge_and_on_the_sensors_that_fly() -> None:
    watched = prepared().protection.watched
    assert watched is not None
    certifier: Any = watched._certifier
    assert certifier.initial == prepared().scenario.knowledge
    assert certifier.initial is not None
    rough = prepared(sensors="gps").protection  # too rough for this region: nothing is certified, and that is told
    assert rough.watched is None
    assert rough.asked


def test_a_vehicle_that_can_hardly_lift_itself_is_refused_before_take_off(tmp_path: Path) -> None:
    text = (ROOT / "flightstack/data/scenarios" / "paper-tracking.toml").read_text()
    path = tmp_path / "heavy.toml"
    path.write_text(text.replace("mass_ratio = [0.8, 1.5]", "mass_ratio = [0.8, 1.6]"))
    assert "0.05 g is needed" in refused(scenario=str(path))
    assert not prepared(str(path), filtering=False).stack.filter.enabled


# ---------------------------------------------------------------- what does not fit


def test_a_certificate_of_another_vehicle_is_refused_by_its_hash(tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    text = (ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text()
    other.write_text(text.replace("mass_kg = 1.2", "mass_kg = 1.3", 1))
    said = refused(certificate=file_of(tmp_path), vehicle=str(other))
    assert "mine.json" in said
    assert "another vehicle" in said
    assert "--vehicle" in said
    assert "another vehicle" in refused(certificate=file_of(tmp_path, knowledge={}))


@pytest.mark.checked
def test_a_certificate_that_the_checker_refuses_is_not_flown(tmp_path: Path) -> None:
    path = write(tmp_path / "mine.json", certificate(), load_vehicle("quad-x"))
    said = refused(certificate=path)
    assert "the independent checker refuses it: " in said
    assert "mine.json" in said
    assert "the independent checker refuses it: " in refused(certificate=path, filtering=False)

    path.write_text(certificate_to_json(stamped()))
    data = json.loads(path.read_text())
    data["axes"][0]["margins"][0]["mps2"] *= 0.5
    path.write_text(resealed(data))
    assert "the independent checker refuses it: " in refused(scenario="hover", certificate=path)


def stamped(**premises: Any) -> Certificate:
    """A proven one, made out for the shipped vehicle; `premises`: what is changed of them."""
    good = proven()
    assert good.premises is not None
    stamp = {"vehicle": "quad-x", "vehicle_hash": vehicle_hash(load_vehicle("quad-x"))}
    given = {"sensors": "mocap", "vehicle_hash": stamp["vehicle_hash"], **premises}
    named = dataclasses.replace(good.premises, **given)
    return dataclasses.replace(good, knowledge={**good.knowledge, **stamp}, premises=named)


@pytest.mark.checked
def test_a_certificate_for_other_sensors_or_quicker_commands_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mine.json"
    path.write_text(certificate_to_json(stamped(sensors="made up")))
    said = refused(scenario="hover", certificate=path, sensors="gps")
    assert "holds with made up sensors, this flight has gps" in said
    monkeypatch.setattr(protection, "require_checked", lambda path: None)
    path.write_text(certificate_to_json(stamped(command_interval_s=0.002)))
    assert "a command every 2 ms, this loop gives one every 4 ms" in refused(scenario="hover", certificate=path)
    path.write_text(certificate_to_json(dataclasses.replace(stamped(), premises=None)))
    assert "names no premises" in refused(scenario="hover", certificate=path)


def test_what_is_flown_is_the_text_that_was_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, checked = file_of(tmp_path), []

    def changed_meanwhile(file: TextFile) -> None:
        checked.append(file.text)
        path.write_text("{}")

    monkeypatch.setattr(protection, "require_checked", changed_meanwhile)
    assert prepared("hover", certificate=path).protection.certificate == checked[0]


def test_a_certificate_bounds_the_round_trip_of_the_link(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(certificate_to_json(stamped(delay_s=(0.004, 0.006), jitter_s=0.002)))
    assert prepared("hover", certificate=path).protection.round_trip_max_s == pytest.approx(0.012)
    assert prepared("hover").protection.round_trip_max_s == pytest.approx(0.055)
    path.write_text(certificate_to_json(stamped(delay_s=(0.004, 0.06), jitter_s=0.002)))
    assert prepared("hover", certificate=path).protection.round_trip_max_s == pytest.approx(0.055)


@pytest.mark.checked
def test_a_file_larger_than_any_certificate_is_not_even_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.json"
    with path.open("wb") as file:
        file.truncate(5 << 30)  # sparse
    assert "are more than the 10 MB looked at" in refused(certificate=path)


def test_a_certificate_of_the_other_mode_is_refused(tmp_path: Path) -> None:
    published = file_of(tmp_path, mode="as-published")
    assert "with --as-published" in refused(certificate=published)
    assert prepared(certificate=published, as_published=True).stack.filter.enabled
    assert "without --as-published" in refused(certificate=file_of(tmp_path), as_published=True)


@pytest.mark.parametrize(
    ("budget", "words"),
    [
        (Budget.square(5.0, 15.0, 17.66, 0.6), "17.66 m/s^2 of thrust"),  # 1.8 weights are 17.652
        (Budget.square(5.0, 15.0, 17.65, 1.0), "1.00 rad of tilt"),  # 55 degrees are 0.96
    ],
)
def test_a_certificate_that_counts_on_more_than_the_flight_allows_is_refused(
    tmp_path: Path, budget: Budget, words: str
) -> None:
    assert words in refused(certificate=file_of(tmp_path, budget=budget))
    fits = dataclasses.replace(budget, thrust_max_mps2=17.65, tilt_max_rad=0.95)
    assert prepared(certificate=file_of(tmp_path, budget=fits)).stack.filter.enabled


def test_a_file_that_is_none_or_damaged_is_one_line(tmp_path: Path) -> None:
    assert "missing.json" in refused(certificate=tmp_path / "missing.json")
    path = file_of(tmp_path)
    data = json.loads(path.read_text())
    data["delta"] = 0.2
    path.write_text(json.dumps(data))
    assert "seal" in refused(certificate=path)
    path.write_text("{")
    assert "mine.json" in refused(certificate=path)


@pytest.mark.parametrize(
    "options", [{"filtering": False}, {"controller": "pid"}, {"learning": False}, {"learned": ROOT / "README.md"}]
)
def test_as_published_goes_with_nothing_that_changes_it(options: dict[str, Any]) -> None:
    assert "--as-published" in refused(as_published=True, **options)


@pytest.mark.parametrize("given", [{"filtering": False}, {"as_published": True}, {"certificate": Path("x")}])
def test_a_scenarios_checks_are_asked_of_the_flight_that_they_were_written_for_only(given: dict[str, Any]) -> None:
    assert FlyOptions().as_written
    assert not FlyOptions(**given).as_written
    assert not OffboardOptions(connect="", **given).as_written
