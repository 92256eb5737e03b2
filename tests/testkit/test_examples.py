"""Every example runs, is short, and does what it says."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from flightstack.testkit import Px4Sim

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
pytest_plugins = ["pytester"]


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_there_are_six_of_at_most_60_lines() -> None:
    assert len(SCRIPTS) == 6
    assert all(len(path.read_text().splitlines()) <= 60 for path in SCRIPTS)


def test_the_examples_for_the_fixture_pass(pytester: pytest.Pytester) -> None:
    for name in ("test_script", "test_fault"):
        pytester.makepyfile(**{name: (EXAMPLES / f"{name}.py").read_text()})
    pytester.runpytest_inprocess().assert_outcomes(passed=3)


def test_two_controllers_are_compared() -> None:
    errors_m = load("compare_controllers").main(4.0)
    assert len(errors_m) == 2
    assert all(0.0 < error_m < 1.0 for error_m in errors_m.values())


def test_a_log_becomes_a_frame(px4_sim: Px4Sim) -> None:
    pytest.importorskip("pandas")
    px4_sim.step(1.0)
    frame = load("log_to_pandas").truth_of(str(px4_sim.log))
    assert list(frame.columns) == ["pos_n", "pos_e", "pos_d", "vel_n", "vel_e", "vel_d"]
    assert len(frame) == 250
    assert frame.index[-1] == pytest.approx(1.0)


def test_the_plant_alone_is_flown_to_two_metres() -> None:
    heights_m = load("plant_alone").fly(15.0)
    assert heights_m[-1] == pytest.approx(2.0, abs=0.1)


def test_a_hidden_load_is_found() -> None:
    result = load("find_gap").main(0.25)
    payload = next(each for each in result.found if each.name == "payload").parameters["mass_kg"]
    assert payload.low <= 0.25 <= payload.high
    assert payload.estimate == pytest.approx(0.25, abs=0.02)
