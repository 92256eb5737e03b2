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
from tests.thorough import thorough


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


@pytest.mark.parametrize("case", [thorough("rotor drag"), "slosh"])
def test_a_frozen_verdict_is_said_again(case: str) -> None:
    then = json.loads(FROZEN.read_text(encoding="utf-8"))[case]
    assert different(then, json.loads(json.dumps(verdict(case)))) == []
