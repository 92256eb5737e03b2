"""The table of decisions, and verdicts that no commit changes unsaid (all of them: `make gap-frozen`)."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest

from benchmarks.gap_frozen import CASES, FROZEN, different, verdict
from benchmarks.gap_sensitivity import Watched, holding, rows
from flightstack.gap import decisions, workflow
from flightstack.gap import verdict as verdict_module


def calls() -> dict[str, list[object]]:
    """Name -> unit, reason and counts of every row."""
    source = Path(decisions.__file__).read_text(encoding="utf-8")
    found = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            assert isinstance(node.targets[0], ast.Name)
            found[node.targets[0].id] = [ast.literal_eval(argument) for argument in node.value.args[1:]]
    return found


def test_every_decision_stands_in_the_table_with_unit_reason_and_what_it_changes() -> None:
    assert len(rows()) <= 60
    for name, (unit, why, *counts) in calls().items():
        assert unit, name
        assert why, name
        ((could, less, of_less, more, of_more),) = counts
        assert 0 <= could <= len(CASES), name
        assert 0 <= less <= of_less, name
        assert 0 <= more <= of_more, name


def test_another_value_of_a_row_reaches_all_that_is_derived_from_it_and_every_module() -> None:
    before = workflow.MOSTLY
    with holding({"TENTH": 0.2, "GAP_FROM": 2.0}):
        assert pytest.approx(0.8) == workflow.MOSTLY
        assert verdict_module.GAP_FROM == 2.0
    assert before == workflow.MOSTLY


def test_a_number_that_watches_itself_notes_comparisons_that_would_come_out_otherwise() -> None:
    noted: set[str] = set()
    number = Watched.made(1.0, 0.5, 1.5, noted)
    assert not number < 0.4
    assert not noted
    assert 2.0 * number > 1.2
    assert noted == {"low"}
    assert not number > 1.4
    assert noted == {"low", "high"}


@pytest.mark.parametrize("case", ["rotor drag", "slosh"])
def test_a_frozen_verdict_is_said_again(case: str) -> None:
    then = json.loads(FROZEN.read_text(encoding="utf-8"))[case]
    assert different(then, json.loads(json.dumps(verdict(case)))) == []


def test_a_straight_thrust_curve_is_named_where_every_number_of_the_file_is_wrong() -> None:
    """The truth: curve 0, lag 28.9 ms, drag 0.149, 0.208, 0.167 kg/s at 0.518 kg, inertia over mass 0.89, 0.86, 0.87.

    With three effects the curve seemed more than straight, was given up for good, and a constant force was named.
    """
    said = verdict("all guessed")
    found = {name: {p: v[0] for p, v in each["parameters"].items()} for name, each in said["names"].items()}
    assert set(found) == {"linear_drag", "thrust_curve", "motor_lag", "inertia"}
    assert found["thrust_curve"]["thrust_model_factor"] == pytest.approx(0.0, abs=0.01)
    assert found["motor_lag"]["time_constant_s"] == pytest.approx(0.0289, rel=0.06)
    share = 0.655619 / 0.51818  # mass, thrust, inertia and drag have a common scale that no log shows
    for axis, drag, inertia in zip("xyz", (0.1490, 0.2079, 0.1669), (0.7057, 0.6770, 0.6836), strict=True):
        assert found["linear_drag"][f"d_{axis}_kgps"] == pytest.approx(drag * share, rel=0.03)
        assert found["inertia"][f"scale_{axis}"] == pytest.approx(inertia * share, rel=0.06)
    assert said["closed"] > 0.98
