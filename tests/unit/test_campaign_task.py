"""Campaigns of a function instead of flights: rows, figures by factor, changes of the file from the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from scipy.stats import binom

from flightstack.cli.campaign.design import Design
from flightstack.cli.campaign.grouped import figure, grouped, markdown, parse_table
from flightstack.cli.campaign.plan import Planner
from flightstack.cli.campaign.result import assess
from flightstack.cli.campaign.single import fly_text
from flightstack.cli.campaign.spec import CampaignSpec, load_spec, parse_spec
from flightstack.errors import InputError

HEAD = 'schema = "flightstack.campaign/1"\ntask = "test_campaign_task:halve"\nseeds = { from = 7, count = 2 }\n'


def halve(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """The task of these tests."""
    if values["x"] > 8:
        raise InputError("too great")
    failure = "six" if values["x"] == 6 else ""
    return {"half": values["x"] / 2, "seed": seed, "odd": bool(values["x"] % 2), "failure": failure}


def _spec(text: str, *, head: str = HEAD) -> CampaignSpec:
    return parse_spec(head + text, Path("c.toml"))


def _rows(spec: CampaignSpec, folder: Path) -> list[dict[str, Any]]:
    planner, design, rows = Planner(spec), Design(spec), []
    for flight in range(spec.count):
        values = design.values(flight)
        plan = planner.plan(flight, values, spec.seed_of(flight))
        row = fly_text(plan.text, folder, keep="none", kept=False, on_progress=lambda share: None)
        rows.append({"flight": flight, "values": values, "log": None, "report": None} | row)
    return rows


def test_a_task_gives_rows_and_says_what_failed_or_was_refused(tmp_path: Path) -> None:
    spec = _spec('count = 8\ndesign = "grid"\nmost_failures = 1\n[vary]\nx = [1, 6, 7, 9]\nname = "a"\n')
    rows = _rows(spec, tmp_path)
    assert [row["outcome"] for row in rows[::2]] == ["completed", "failed", "completed", "refused"]
    assert (rows[2]["reason"], rows[6]["reason"]) == ("six", "too great")
    assert [row["result"]["seed"] for row in rows[:3]] == [7, 8, 7]
    assert assess(spec, rows).too_many_failures == "2 flights went wrong, most_failures = 1"


def not_plain(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """A task that breaks its word."""
    return {"path": folder}


def test_what_is_no_plain_data_is_a_crash_that_says_so(tmp_path: Path) -> None:
    (row,) = _rows(_spec("count = 1\n", head=HEAD.replace("halve", "not_plain")), tmp_path)
    assert row["outcome"] == "crashed"
    assert "not JSON serializable" in row["reason"]


def test_a_flights_file_is_a_campaign_that_flies_it_again(tmp_path: Path) -> None:
    spec = _spec('count = 1\n[vary]\nx = { low = 1.0, high = 2.0 }\nname = ["a \\"b\\"", "c"]\n')
    plan = Planner(spec).plan(4, Design(spec).values(4), 11)
    (tmp_path / "again.toml").write_text(plan.text)
    (row,) = _rows(load_spec(tmp_path / "again.toml"), tmp_path)
    assert row["values"] == Design(spec).values(4)
    assert row["result"] == {"half": row["values"]["x"] / 2, "seed": 11, "odd": True}


def test_values_are_drawn_by_their_weights() -> None:
    spec = _spec('count = 4000\n[vary]\nx = { values = ["a", "b", "c"], weights = [1, 2, 7] }\n')
    drawn = [Design(spec).values(flight)["x"] for flight in range(spec.count)]
    for value, share in (("a", 0.1), ("b", 0.2), ("c", 0.7)):
        assert 0.001 < binom.cdf(drawn.count(value), len(drawn), share) < 0.999


def test_figures_by_factor() -> None:
    table = parse_table(
        {"by": "k", "columns": {"n": "flights", "left": "sum bad.left", "least": "min h", "share": "ratio bad.left of",
                                "at most": "limit bad.left of", "lost": "crashed"}}, "c",
    )  # fmt: skip
    rows = [
        {"values": {"k": k}, "outcome": "completed" if result else "crashed", "result": result}
        for k, result in (
            ("a", {"bad": {"left": 0}, "of": 12, "h": 0.5}), ("a", {"bad": {"left": 1}, "of": 8, "h": -0.25}),
            ("b", None),
        )
    ]  # fmt: skip
    first, second = grouped(table, rows)
    limit = first.pop("at most")
    assert first == {"k": "a", "n": 2, "left": 1, "least": -0.25, "share": 0.05, "lost": 0}
    assert binom.cdf(1, 20, limit) == pytest.approx(0.05)  # what Clopper and Pearson's limit is
    assert second == {"k": "b", "n": 1, "left": 0, "least": None, "share": None, "at most": None, "lost": 1}
    assert markdown([second]).splitlines()[-1] == "| b | 1 | 0 | – | – | – | 1 |"
    none_left = [{"values": {}, "outcome": "completed", "result": {"left": 0, "of": 5000}}]
    assert figure(("limit", "left", "of"), none_left) == pytest.approx(1.0 - 0.05 ** (1.0 / 5000), rel=1e-9)


def test_the_command_line_changes_the_file(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text(HEAD + 'count = 5\n[vary]\nx = { low = 1.0, high = 2.0 }\n"a.b" = [1, 2]\n')
    spec = load_spec(file, ("count=3", "seeds.from=100", "vary.x=4", "vary.a.b=[2]", "search.target='half'"))
    assert (spec.count, spec.seed_of(0), spec.seeds) == (3, 100, 2)
    assert Design(spec).values(0) == {"x": 4, "a.b": 2}
    assert spec.search is not None
    with pytest.raises(InputError, match="not KEY=VALUE"):
        load_spec(file, ("count=three",))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('task = "halve"\n', "MODULE:FUNCTION"),
        ('task = "no_such_module:f"\ncount = 1\n', "No module named"),
        ('task = "os:no_such"\ncount = 1\n', "no function no_such"),
        ('task = "os:getcwd"\nscenario = "hover"\ncount = 1\n', "scenario"),
        ('task = "os:getcwd"\ncount = 1\n[search]\ntarget = "x"\nadversary = true\n', "adversary"),
        ('task = "os:getcwd"\ncount = 1\n[vary]\nx = { values = [1, 2], weights = [1] }\n', "one for each"),
        ('task = "os:getcwd"\ncount = 1\n[table]\ncolumns = { a = "mean x" }\n', "known are flights, sum"),
        ('task = "os:getcwd"\ncount = 1\n[table]\ncolumns = { a = "sum" }\n', "takes 1 field"),
        ('task = "os:getcwd"\ncount = 1\n[table]\nbye = "x"\n', "nearest known one is by"),
        (
            'task = "os:getcwd"\ncount = 1\n[vary]\nkind = [1]\n[table]\nby = "kin"\ncolumns = { a = "flights" }\n',
            "is kind",
        ),
        ('task = "test_campaign_task_broken:f"\ncount = 1\n', "broken on purpose"),
    ],
)
def test_each_mistake_is_one_line(text: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "test_campaign_task_broken.py").write_text('raise RuntimeError("broken\\non purpose")')
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=words) as error:
        Planner(_spec(text, head='schema = "flightstack.campaign/1"\n'))
    assert "\n" not in str(error.value)
