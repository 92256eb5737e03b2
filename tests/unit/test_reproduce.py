"""`reproduce` round its parts: the folder, the plan, the rows, the page.  No flight here."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flightstack.cli.main import main
from flightstack_paper.figures import FIGURES
from flightstack_paper.page import markdown, page
from flightstack_paper.parts import PartStore, sources_hash
from flightstack_paper.plan import PaperPart, parts_of
from flightstack_paper.rows import ResultLine, ResultTable, table
from flightstack_paper.run import ReproduceOptions, ReproduceResult, reproduce
from flightstack_paper.verb import show_reproduced

CONTRACT = {
    "ex1-lyapunov-area", "ex1-barrier-area", "ex1-ratio", "tracking-rmse-ratio", "gp-step-ms-max",
    "inputs-without-position-ratio", "mu-initial", "mu-final", "barrier-violations", "adaptive-vs-uniform-samples",
}  # fmt: skip
KEY = {"version": "1", "git_commit": "abc", "sources": "x", "seed": 0, "quick": True, "plants": ["native"]}


# ------------------------------------------------------------------ the folder


def test_a_part_is_taken_up_by_the_same_run_and_by_no_other(tmp_path: Path) -> None:
    PartStore(tmp_path, KEY).save("one", {"x": 1.5})
    assert PartStore(tmp_path, KEY).load("one") == {"x": 1.5}
    for name, other in (("seed", 1), ("quick", False), ("git_commit", "def"), ("sources", "y"), ("plants", ["jsbsim"])):
        PartStore(tmp_path, KEY).save("one", {"x": 1.5})
        assert PartStore(tmp_path, {**KEY, name: other}).load("one") is None
        assert not list((tmp_path / "parts").glob("*.json"))


def test_another_run_leaves_no_page_and_no_figure_behind_and_touches_nothing_else(tmp_path: Path) -> None:
    PartStore(tmp_path, KEY).save("one", {})
    flown = tmp_path / "parts" / "one"
    flown.mkdir()
    (flown / "flight.mcap").write_text("log")
    for name in ("results.json", "report.html", "table.md", "fig1-example1.png", "notes.txt"):
        (tmp_path / name).write_text("old")
    PartStore(tmp_path, {**KEY, "seed": 7})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "parts"]
    assert not flown.exists()


@pytest.mark.parametrize("content", ["", "{", "[1]", '{"key": 1}', '{"result": {}}', "\0\0"])
def test_a_part_that_was_cut_off_is_computed_again(tmp_path: Path, content: str) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "one.json").write_text(content)
    (tmp_path / "parts" / "two.json.part").write_text('{"key": ')
    parts = PartStore(tmp_path, KEY)
    assert parts.load("one") is None
    assert list((tmp_path / "parts").iterdir()) == []


def test_every_source_counts_in_the_key(tmp_path: Path) -> None:
    (tmp_path / "app").mkdir()
    code = tmp_path / "app" / "a.py"
    code.write_text("x = 1")
    before = sources_hash([tmp_path / "app"])
    assert before == sources_hash([tmp_path / "app"])
    code.write_text("x = 2")
    assert sources_hash([tmp_path / "app"]) != before
    code.rename(tmp_path / "app" / "b.py")
    assert sources_hash([tmp_path / "app"]) not in (before, "")


@pytest.mark.parametrize("place", ["file/out", "/proc/none/out"])
def test_a_folder_that_cannot_be_written_is_one_line_before_anything_is_computed(
    tmp_path: Path, place: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("flightstack_paper.run._compute", lambda *_: pytest.fail("it began to compute"))
    with pytest.raises(SystemExit) as done:
        main(["reproduce", "--quick", "--out", place])
    assert done.value.code == 2
    said = capsys.readouterr().err
    assert re.fullmatch(r"error: [^\n]*--out\n", said)


# ------------------------------------------------------------------ a run of one part


def _some(plants: tuple[str, ...], seed: int, quick: bool) -> list[PaperPart]:
    return [
        PaperPart("first", "example1", 9.0, {"starts": 5}),
        PaperPart("second", "example1", 1.0, {"starts": 5}),
        PaperPart("wrong", "theory", 1.0, {"no": "such argument"}),
    ]


def test_a_run_that_is_stopped_goes_on_where_it_was_and_a_part_that_fails_costs_the_others_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = tmp_path / "parts" / "first.json"
    shares: list[float] = []
    options = ReproduceOptions(out=tmp_path, quick=True)
    stopped = reproduce(
        options,
        stop_requested=lambda: "enough" if kept.exists() else "",
        on_progress=lambda share, _: shares.append(share),
        parts_wanted=_some,
    )
    assert (stopped.stopped, stopped.rows) == ("enough", [])
    assert not (tmp_path / "results.json").exists()
    assert shares == sorted(shares)
    found = json.loads(kept.read_text())
    found["result"]["ratio"] = 99.0  # what the second run takes up, it does not compute
    kept.write_text(json.dumps(found))
    seen: dict[str, dict[str, Any]] = {}
    monkeypatch.setattr(
        "flightstack_paper.run._write", lambda options, plants, results, head, failed: seen.update(results)
    )
    reproduce(options, parts_wanted=_some)
    assert set(seen) == {"first", "second", "wrong"}
    assert seen["first"]["ratio"] == 99.0
    assert seen["second"]["ratio"] == pytest.approx(1.672, abs=1e-3)
    assert "no" in seen["wrong"]["failed"]
    assert sorted(path.name for path in (tmp_path / "parts").glob("*.json")) == ["first.json", "second.json"]


# ------------------------------------------------------------------ plan and rows


def _failed(parts: list[PaperPart]) -> dict[str, dict[str, Any]]:
    return {part.name: {"failed": f"no luck with {part.name}"} for part in parts}


@pytest.mark.parametrize("quick", [True, False])
def test_rows_are_the_contracts_and_more_with_unique_ids(quick: bool) -> None:
    plants = ("native",) if quick else ("native", "jsbsim")
    rows = table(_failed(parts_of(plants, 3, quick=quick)), plants, 3, quick=quick)
    ids = [row.id for row in rows]
    assert len(set(ids)) == len(ids)
    assert set(ids) >= CONTRACT
    assert any(each.endswith("-jsbsim") for each in ids) is not quick


def test_a_full_run_has_every_row_of_a_quick_one_and_the_other_plant_beside_it() -> None:
    quick = {row.id for row in table(_failed(parts_of(("native",), 0, quick=True)), ("native",), 0, quick=True)}
    both = ("native", "jsbsim")
    full = {row.id for row in table(_failed(parts_of(both, 0, quick=False)), both, 0, quick=False)}
    assert quick <= full
    flown = {each for each in quick if each.startswith(("tracking-", "mu-final", "barrier-", "inputs-"))}
    assert {f"{each}-jsbsim" for each in flown} <= full


def test_what_could_not_be_measured_holds_nothing_and_says_why() -> None:
    parts = parts_of(("native",), 0, quick=True)
    for row in table(_failed(parts), ("native",), 0, quick=True):
        assert row.ours is None
        assert row.holds is False
        assert "no luck with" in row.note


def test_a_row_is_plain_numbers_whatever_it_was_made_of() -> None:
    run = ResultTable({"part": {"x": np.float64(2.0)}}, ("native",), 0, True)
    made = run.row("a", "claim", None, "1", ("part",), lambda found: (found["x"], found["x"] > 1.0, "note"))
    assert json.loads(json.dumps(made.as_json()))["holds"] is True
    endless = run.row("a", "claim", None, "1", ("part",), lambda found: (np.inf, True, "note"))
    assert (endless.ours, endless.holds) == (None, False)


def test_parts_are_named_once_and_the_longest_begin_first() -> None:
    parts = parts_of(("native", "jsbsim"), 0, quick=False)
    assert len({part.name for part in parts}) == len(parts)
    assert [part.cost_s for part in parts] == sorted((part.cost_s for part in parts), reverse=True)
    quick = parts_of(("native",), 0, quick=True)
    assert sum(part.cost_s for part in quick) < 0.25 * sum(part.cost_s for part in parts)
    assert all(part.given.get("plant", "native") == "native" for part in quick)


def test_figures_are_the_papers_eight_by_number_and_ours_by_letter() -> None:
    numbers = [int(found[1]) for row in FIGURES if (found := re.match(r"Fig\. (\d)\. ", row.title))]
    assert numbers == list(range(1, 9))
    for row in FIGURES:
        assert row.file.startswith("fig")
        assert row.title[:6] == f"Fig. {row.file[3]}" or row.title[:2] == f"{row.file[3].upper()}."


# ------------------------------------------------------------------ terminal and page


def test_the_terminal_says_claims_and_why_those_that_do_not_hold_do_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [
        ResultLine("kept", "this [is] kept", 2.0, 1.0, "m", True, "quietly"),
        ResultLine("broken", "this is not", None, 3.25, "1", False, "for [a] reason"),
    ]
    show_reproduced(ReproduceResult(rows, {}, []), tmp_path)
    said = capsys.readouterr().out
    for words in ("this [is] kept", "2 m", "1 m", "3.25", "broken: for [a] reason", "results.json"):
        assert words in said
    assert "quietly" not in said


def test_the_page_is_self_contained_and_what_it_is_given_stays_text(tmp_path: Path) -> None:
    rows = [
        ResultLine("a", "claim <b>", None, math.pi, "m|s", True, "why & how"),
        ResultLine("b", "c", 1.0, None, "1", False, "n"),
    ]
    head = {
        "date": "2026-01-01",
        "version": "1",
        "git_commit": "",
        "command": "run",
        "plants": ["native"],
        "wall_time_s": 1.0,
        "parts": 2,
        "taken_up": 0,
    }
    text = page(rows, [], head, {}, tmp_path)
    assert "<b>" not in text
    assert "claim &lt;b&gt;" in text
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    assert "not measured: b" in text


def test_the_table_for_the_docs_has_the_second_plant_beside_the_first() -> None:
    rows = [
        ResultLine("a", "claim", None, math.pi, "m|s", True, "why"),
        ResultLine("a-jsbsim", "claim", None, 3.0, "m|s", False, "why"),
        ResultLine("b", "c", 1.0, None, "1", False, "n"),
    ]
    head = {"plants": ["native", "jsbsim"], "command": "run", "date": "2026-01-01", "version": "1", "git_commit": "abc"}
    lines = markdown(rows, head).splitlines()
    assert "`run` on 2026-01-01 (version 1, commit abc): 1 of 3" in lines[0]
    assert "| `a` | claim | – | 3.1416 m\\|s | yes | why |" in lines
    assert "| `b` | c | 1 | – | not measured | n |" in lines
    assert "| `a` | 3.1416 m\\|s | 3 m\\|s | yes, no |" in lines
    alone = markdown(rows[:1], {**head, "plants": ["native"]}).splitlines()
    assert "| `a` | claim | – | 3.1416 m\\|s | yes | why |" in alone
