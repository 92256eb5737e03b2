"""The learning campaign: every bar, every baseline, every figure of docs/learning.md (make campaign-learning).

    python -m benchmarks.learning file           the campaign's file: each flight and study is a value of its factor
    python -m benchmarks.learning page FOLDER    docs/learning.md, of the folder that `flightstack campaign` wrote
    python -m benchmarks.learning page           the tables and figures anew from docs/learning/results.json

`--quick`: one seed of the main cases; the page goes into FOLDER.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from datetime import date
from pathlib import Path
from typing import Any

from benchmarks import campaign
from benchmarks.learning_cases import FIRST_SEED, PILOTS, Flight, flights
from flightstack.toml_text import toml_text

SCHEMA = "flightstack.campaign-learning/1"
_TRACED = "paper-tracking"
_STUDY_SEEDS = 3
_WORLDS = ("air", "ground")


def one(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """A task of a campaign: `job` is KIND/NAME/PILOT/SEED, kind flight or study, name its case or world."""
    kind, name, pilot, number = str(values["job"]).split("/")
    if kind == "study":
        from flightstack_paper.inputs import Study, study

        return {"inputs": study(Study(world=name, seed=int(number)))}
    from benchmarks.learning_flights import fly_scored

    row = fly_scored(Flight(name, pilot, int(number)))
    return row | {"failure": "" if row["completed"] else row["reason"] or "not completed"}


def jobs_of(quick: bool) -> list[str]:
    """The campaign, seed by seed; the studies come first: they take longest."""
    seeds = range(FIRST_SEED, FIRST_SEED + (1 if quick else _STUDY_SEEDS))
    studies = [f"study/{world}//{seed}" for world in _WORLDS for seed in seeds]
    return studies + [f"flight/{each.case}/{each.pilot}/{each.seed}" for each in flights(quick=quick)]


def file(quick: bool) -> str:
    """The campaign's file."""
    return toml_text(
        {
            "schema": "flightstack.campaign/1", "task": "benchmarks.learning:one", "design": "grid",
            "timeout_s": 3600.0, "most_failures": 0, "vary": {"job": jobs_of(quick)},
        }
    )  # fmt: skip


def gathered(entries: list[campaign.Entry]) -> dict[str, Any]:
    """The results: flights by case, pilot and seed; their traces only where a figure shows them."""
    from benchmarks.learning_stats import of, trace
    from benchmarks.learning_timing import timing

    rows = [_row(entry) for entry in entries if entry["values"]["job"].startswith("flight")]
    traces = {}
    for pilot in PILOTS:
        shown = [row for row in of(rows, _TRACED, pilot) if row["completed"]]
        if shown and pilot in ("learning", "none", "exact"):
            traces[f"{_TRACED}/{pilot}"] = trace(shown)
    for row in rows:
        row.pop("trace_m", None)
        row.pop("trace_from_s", None)
        if row["seed"] != FIRST_SEED and "change" in row:
            row["change"].pop("shown", None)
    return {
        "schema": SCHEMA, "date": str(date.today()), "machine": platform.machine(), "cores": campaign.processor(),
        "python": platform.python_version(),
        "git_commit": ", then ".join(dict.fromkeys(entry["version"] for entry in entries)),
        "wall_s": sum(entry["timing"]["wall_s"] for entry in entries), "timing": timing(),
        "inputs": [row for entry in entries for row in (entry["result"] or {}).get("inputs", [])],
        "traces": traces,
        "flights": sorted(rows, key=lambda row: (row["case"], row["pilot"], row["seed"])),
    }  # fmt: skip


def _row(entry: campaign.Entry) -> dict[str, Any]:
    """A flight; one that could not be flown is a row that did not complete."""
    if entry["result"] is not None:
        return dict(entry["result"])
    _, case, pilot, seed = entry["values"]["job"].split("/")
    return {
        "case": case, "pilot": pilot, "seed": int(seed), "completed": False, "reason": entry["reason"], "rmse_m": None,
        "max_m": None, "rmse_settled_m": None, "track_s": None, "trace_m": [], "trace_from_s": 0.0, "wall_s": 0.0,
    }  # fmt: skip


def write_results(results: dict[str, Any], path: Path) -> None:
    """JSON, a line for each flight."""
    head = {key: value for key, value in results.items() if key != "flights"}
    text = "{\n" + "".join(f" {json.dumps(key)}: {json.dumps(value)},\n" for key, value in head.items())
    rows = ",\n  ".join(json.dumps(_rounded(row)) for row in results["flights"])
    path.write_text(text + f' "flights": [\n  {rows}\n ]\n}}\n', encoding="utf-8")


def _rounded(value: Any) -> Any:
    """Floats to six digits."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value


def write_page(folder: Path | None, quick: bool) -> Path:
    """Results, figures and the page."""
    from benchmarks.learning_plots import draw
    from benchmarks.learning_report import report

    page = (folder if quick and folder else campaign.ROOT / "docs") / "learning.md"
    stored = page.with_suffix("") / "results.json"
    stored.parent.mkdir(parents=True, exist_ok=True)
    if folder is not None:
        write_results(gathered(campaign.flown([folder])), stored)
    results = json.loads(stored.read_text(encoding="utf-8"))
    figures = draw(results, page.with_suffix(""))
    command = f"make campaign-learning{'-quick' if quick else ''}"
    page.write_text(report(results, figures, command), encoding="utf-8")
    return page


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("file", "page"))
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    sys.stdout.write(file(given.quick) if given.what == "file" else f"wrote {write_page(given.folder, given.quick)}\n")
