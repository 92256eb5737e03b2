"""The Foxglove layouts name what the logs hold, and nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from flightstack_logs.topics import TOPICS, Kind

FOLDER = Path(__file__).parents[2] / "logs/layouts"
LAYOUTS = sorted(path.stem for path in FOLDER.glob("*.json"))


def panels(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text())["configById"]
    return found


def places(part: Any) -> list[str]:
    return [part] if isinstance(part, str) else places(part["first"]) + places(part["second"])


def test_there_is_one_for_flying_one_for_learning_and_safety_and_one_for_the_gap() -> None:
    assert LAYOUTS == ["flying", "gap", "learning-and-safety"]


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_series_is_a_number_of_a_topic_of_the_log(name: str) -> None:
    count = 0
    for panel in panels(name).values():
        for path in panel.get("paths", []):
            match = re.fullmatch(r"(/[a-z_/]+)\.([a-z_0-9]+)(?:\[(\d+)\])?", path["value"])
            assert match, path["value"]
            topic, column, index = match.groups()
            (field,) = [field for field in TOPICS[topic].fields if field.name == column]
            assert (index is None) == (field.size == 0), path["value"]
            assert int(index or 0) < max(field.size, 1), path["value"]
            count += 1
    assert count > 20


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_panel_has_a_place_and_a_name_and_the_3d_view_shows_views(name: str) -> None:
    layout = json.loads((FOLDER / f"{name}.json").read_text())
    assert sorted(places(layout["layout"])) == sorted(panels(name))
    for panel in panels(name).values():
        assert panel["foxglovePanelTitle"]
        assert {TOPICS[topic].kind for topic in panel.get("topics", {})} <= {Kind.VIEW}
