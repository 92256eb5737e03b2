"""A user's text file is read as far as a text goes: what has no end, or is a log of gigabytes, is one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from flightstack.cli.campaign.spec import load_spec
from flightstack.cli.files import MOST_CHARACTERS, load_vehicle, read_text
from flightstack.gap.read import column_map
from flightstack.scenario import parse_scenario
from flightstack.types import InputError
from flightstack.vehicle import parse_vehicle
from flightstack.waypoints import parse_waypoints
from flightstack_logs.columns import parse_columns
from mavlink_bridge.param_file import parse_params


def test_a_file_without_an_end_does_not_take_all_memory() -> None:
    """`fly --vehicle /dev/zero` took 21 GB and was killed by the system, and others with it."""
    with pytest.raises(InputError, match=r"/dev/zero: is larger than the 10 MB that are read of a text file"):
        load_vehicle("/dev/zero")
    with pytest.raises(InputError, match="/dev/zero: is too large for a map of columns"):
        column_map("/dev/zero")


@pytest.mark.parametrize(("size", "is_read"), [(MOST_CHARACTERS, True), (MOST_CHARACTERS + 1, False)])
def test_the_largest_text_is_read_whole_and_a_larger_one_is_refused(tmp_path: Path, size: int, is_read: bool) -> None:
    path = tmp_path / "text"
    path.write_text("a" * size)
    if is_read:
        assert len(read_text(path).text) == size
    else:
        with pytest.raises(InputError, match="is larger than"):
            read_text(path)


@pytest.mark.parametrize("levels", [100, 330, 100_000])
@pytest.mark.parametrize("parse", [parse_vehicle, parse_scenario, parse_waypoints, parse_params, parse_columns])
def test_a_text_that_is_nested_without_end_is_one_line(parse: Callable[[str, str], object], levels: int) -> None:
    """The parser calls itself for each level: it ended in a traceback of thousands of lines."""
    with pytest.raises(InputError, match=r"^deep\.toml: nested too deeply$"):
        parse(f"a = {'[' * levels}{']' * levels}", "deep.toml")


@pytest.mark.parametrize("levels", [100, 330, 100_000])
def test_a_campaign_is_changed_by_no_nested_text(tmp_path: Path, levels: int) -> None:
    nested = f"x = {'[' * levels}{']' * levels}"
    path = tmp_path / "c.toml"
    path.write_text('schema = "flightstack.campaign/1"\nscenario = "hover"\n')
    with pytest.raises(InputError, match="not KEY=VALUE"):
        load_spec(path, [nested])
    path.write_text(nested)
    with pytest.raises(InputError, match="nested too deeply"):
        load_spec(path, ["seeds.count = 1"])
