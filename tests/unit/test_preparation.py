"""From options to the stack that flies: which controller, which learner, with which hyper-parameters."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
from shipped import ROOT, load_vehicle

from flightstack.cli.calibration import TimedLearner
from flightstack.cli.certify import certify
from flightstack.cli.controllers import CONTROLLERS
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.gap import GapOptions, find_gap
from flightstack.cli.offboard import OffboardOptions, offboard
from flightstack.cli.preparation import Prepared, prepare_flight
from flightstack.jit import code_folder
from flightstack.learning.learner import GpLearner
from flightstack.learning.priors import StorePrior, default_priors
from flightstack.learning.stored import StoredPriors, to_json, vehicle_hash
from flightstack.types import InputError


def prepared(**options: Any) -> Prepared:
    return prepare_flight(FlyOptions(scenario="hover", **options))


def attached(flight: Prepared) -> dict[str, str]:
    return {item.name: item.data.decode() for item in flight.attachments}


def stored_file(tmp_path: Path, vehicle: str = "quad-x", noise_var: float = 0.123) -> Path:
    """Hyper-parameters of a vehicle, told from the default ones by their noise."""
    believed = load_vehicle(vehicle)
    priors = default_priors()
    priors = dataclasses.replace(priors, vertical=StorePrior(priors.vertical.kernel, noise_var))
    path = tmp_path / "learned.json"
    path.write_text(to_json(StoredPriors(priors, believed.name, vehicle_hash(believed), "0" * 64, 100)))
    return path


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_of_the_table_can_be_named_and_its_name_is_in_the_settings(name: str) -> None:
    flight = prepared(controller=name)
    assert flight.settings["controller"] == name
    assert flight.settings["learning"] == ("on" if flight.stack.learner.enabled else "off")
    assert not prepared(controller=name, learning=False).stack.learner.enabled


def test_learning_is_on_and_its_steps_are_timed() -> None:
    learner = prepared().stack.learner
    assert isinstance(learner, TimedLearner)
    assert isinstance(learner._learner, GpLearner)


@pytest.mark.parametrize("site", [False, True])
@pytest.mark.parametrize("verb", ["fly", "fly on JSBSim", "certify", "offboard"])
def test_a_new_machine_compiles_before_anything_is_calculated_and_after_the_files_are_read(
    verb: str, site: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`fly` searched for its certificate first and compiled what that takes by itself: 20 of its first 79 seconds."""
    asked: list[tuple[str, ...]] = []

    class Searched(Exception):
        pass

    def search(*args: Any) -> None:
        raise Searched

    monkeypatch.setattr("flightstack.cli.compiled.ensure_compiled", lambda say, *parts: asked.append(parts))
    monkeypatch.setattr("flightstack.cli.preparation.protect", search)
    monkeypatch.setattr("flightstack.cli.offboard.ask_vehicle", lambda site, connect, wait_s: (site, (47.0, 8.0)))
    field = tmp_path / "field.toml"
    field.write_text('schema = "flightstack.site/1"\nceiling_m = 9.0\ninside = [[-9, -9], [9, -9], [9, 9], [-9, 9]]\n')

    def run(vehicle: str | None) -> None:
        given: dict[str, Any] = {"scenario": "hover", "site": field if site else None, "vehicle": vehicle}
        if verb == "offboard":
            offboard(OffboardOptions(connect="udpin:127.0.0.1:0", **given), stop_requested=str)
        elif verb == "certify":
            certify(FlyOptions(**given), stop_requested=str)
        else:
            fly(FlyOptions(plant="jsbsim" if "JSBSim" in verb else "native", **given))

    with pytest.raises(InputError, match=r"none\.toml"):
        run("none.toml")
    assert not asked
    with pytest.raises(Searched):
        run(None)
    assert asked == [("flight", *["site"] * site, *["jsbsim"] * ("JSBSim" in verb), *["certify"] * (verb == "certify"))]


def test_a_gap_compiles_ahead_where_none_of_its_code_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It compiled by itself, on one core and without a word: 14 s of the first 18, now 9."""
    done: list[tuple[str, ...]] = []

    def analyse(*args: Any, **more: Any) -> None:
        done.append(("analysed",))
        raise InputError("no log")

    monkeypatch.setattr("flightstack.jit.cache_folder", lambda: tmp_path)
    monkeypatch.setattr("flightstack.cli.compiled.ensure_compiled", lambda say, *parts: done.append(parts))
    monkeypatch.setattr("flightstack.gap.workflow.analyse", analyse)
    log = tmp_path / "log.csv"
    for there, wanted in (
        (False, []), (True, [("gap",), ("analysed",)]), (True, [("analysed",)])
    ):  # fmt: skip
        done.clear()
        if there:
            log.touch()
        with pytest.raises(InputError):
            find_gap(GapOptions(logs=(log,), vehicle="quad-x", out=tmp_path / "out"))
        assert done == wanted
        if there:
            folder = code_folder("flightstack.gap.evaluated")
            assert folder is not None
            (folder / "states_loop.nbi").touch()


def test_an_unknown_controller_is_one_line_that_names_those_there_are() -> None:
    with pytest.raises(InputError, match=r"bang-bang.*flatness") as error:
        prepared(controller="bang-bang")
    assert "\n" not in str(error.value)


def test_stored_hyper_parameters_are_what_the_learner_begins_with_and_are_in_the_log(tmp_path: Path) -> None:
    path = stored_file(tmp_path)
    flight = prepared(learned=path)
    learner: Any = flight.stack.learner
    assert learner._learner.config.priors.vertical.noise_var == 0.123
    assert flight.settings["learned"] == str(path)
    assert json.loads(attached(flight)["learned.json"])["schema"] == "flightstack.learned/1"


def test_hyper_parameters_of_another_vehicle_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    text = (ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text()
    other.write_text(text.replace("mass_kg = 1.2", "mass_kg = 1.3", 1))
    with pytest.raises(InputError, match=r"learned\.json"):
        prepared(learned=stored_file(tmp_path), vehicle=str(other))


@pytest.mark.parametrize("switched", [{"learning": False}, {"controller": "pid"}])
def test_stored_hyper_parameters_without_a_learner_to_take_them_are_a_mistake(
    tmp_path: Path, switched: dict[str, Any]
) -> None:
    with pytest.raises(InputError, match="--learned"):
        prepared(learned=stored_file(tmp_path), **switched)


@pytest.mark.parametrize(
    "given", [{"vehicle": "x"}, {"duration_s": 1.0}, {"controller": "pd"}, {"learning": False}, {"learned": Path("x")}]
)
def test_a_scenarios_checks_are_asked_of_the_flight_that_they_were_written_for_only(given: dict[str, Any]) -> None:
    assert FlyOptions().as_written
    assert OffboardOptions(connect="").as_written
    assert not FlyOptions(**given).as_written
    assert not OffboardOptions(connect="", **given).as_written


def test_truth_sensors_and_a_dry_run_make_it_another_flight_too_and_a_seed_does_not() -> None:
    assert FlyOptions(seed=7, realtime=True, out=Path("x")).as_written
    assert not FlyOptions(truth="quad-x").as_written
    assert not FlyOptions(sensors="gps").as_written
    assert not OffboardOptions(connect="", dry_run=True).as_written
