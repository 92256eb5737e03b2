"""The judge of the blind cases: opens the sealed answer, reads what the workflow wrote, and says what was right.

A *name* is right in its class where the effect, or one that the workflow says it can't be told from, is hidden; it is
exact where it is the hidden effect itself.  Parameters and intervals are judged where the name is exact.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap.decisions import GAP_FROM
from flightstack.gap.simulate import value
from flightstack.gap.verdict import ONE_STEP
from flightstack.vehicle import Vehicle

Row = dict[str, Any]


def judge(answer: dict[str, Any], said: dict[str, Any], believed: Vehicle) -> Row:
    """One case's row: what was hidden, what was said, what of it was right; `said` is gap.json."""
    hidden: dict[str, dict[str, float]] = answer["effects"]
    names = []
    for effect in said["effects"]:
        twins = effect["indistinguishable_from"]
        exact = effect["name"] in hidden
        names.append(
            {
                "name": effect["name"],
                "twins": twins,
                "exact": exact,
                "class": exact or bool(set(twins) & set(hidden)),
                **(_parameters(effect, hidden[effect["name"]], believed) if exact else {}),
            }
        )
    covered = {each["name"] for each in names} | {twin for each in names for twin in each["twins"]}
    rest = said["unexplained"]
    silent = bool(hidden or answer["outside"]) and not names and not rest["significant"]
    return {
        "silent": silent,
        "floors": max(_floors(said["gap"]), default=1.0),
        "hidden": sorted(hidden),
        "outside": answer["outside"],
        "rich": answer["rich"],
        "names": names,
        "missed": sorted(set(hidden) - covered),
        "closed": said["gap"]["closed"],
        "unexplained": rest["significant"],
        "driver": bool(set(rest["depends_on"]) & set(answer["depends_on"])) if answer["outside"] else None,
        "depends_on": rest["depends_on"],
        "fraction": rest["fraction"],
    }


def _floors(gap: dict[str, Any]) -> Iterator[float]:
    """Held-out figures of one step with the model as it was, in noise floors."""
    for name in ONE_STEP:
        was, least = gap.get("before", {}).get(name), gap.get("noise_floor", {}).get(name)
        if was is not None and least:
            yield was / least


def _parameters(effect: dict[str, Any], hidden: dict[str, float], believed: Vehicle) -> dict[str, Any]:
    """Relative error of the change, and which intervals hold the truth.

    The parameters of an effect count together, as vectors; one whose interval is wider than the whole change (a log
    may show an offset along x and nothing along z) claims nothing and counts for its interval only.
    """
    off, change, width, within = [], [], [], []
    for spec in EFFECTS[effect["name"]].params:
        said = effect["parameters"].get(spec.name)
        before = value(believed, effect["name"], spec.name)
        true = hidden.get(spec.name, before if spec.null is None else spec.null)
        if spec.integer:
            if said is not None and said["estimate"] != true:
                return {"error": math.inf, "within": [False]}
            continue
        null = before if math.isfinite(before) else 0.0
        found = null if said is None else said["estimate"]
        off.append(found - true)
        change.append(true - null)
        known = said is not None and None not in said["ci95"]
        width.append(said["ci95"][1] - said["ci95"][0] if known else 0.0)
        if known:
            within.append(bool(said["ci95"][0] <= true <= said["ci95"][1]))
    told = np.array(width) < float(np.linalg.norm(change))
    size = float(np.linalg.norm(np.array(change)[told]))
    return {"error": float(np.linalg.norm(np.array(off)[told])) / size if size > 0.0 else math.inf, "within": within}


# --- over all cases


def summary(rows: list[Row]) -> dict[str, Any]:
    """The figures that the campaign is judged by; shares are None where there is nothing to count."""
    judged = [row for row in rows if "lost" not in row]
    clean = [row for row in judged if not row["hidden"] and not row["outside"]]
    hidden = [row for row in judged if row["hidden"]]
    outside = [row for row in judged if row["outside"]]
    names = [name for row in hidden for name in row["names"]]
    alone = [name for name in names if not name["twins"]]
    errors = [name["error"] for name in names if "error" in name and math.isfinite(name["error"])]
    within = [hit for name in names for hit in name.get("within", [])]
    closed = [row["closed"] for row in hidden if row["names"] and row["closed"] is not None]
    return {
        "cases": len(rows),
        "lost": len(rows) - len(judged),
        "clean": len(clean),
        "false_names_clean": _share([bool(row["names"]) for row in clean]),
        "false_alarms_clean": _share([row["unexplained"] for row in clean]),
        "named": len(names),
        "right_class": _share([name["class"] for name in names]),
        "exact_alone": _share([name["exact"] for name in alone]),
        "with_twins": _share([bool(name["twins"]) for name in names]),
        "found": _share([not row["missed"] for row in hidden]),
        "median_error": float(np.median(errors)) if errors else None,
        "coverage": _share(within),
        "intervals": len(within),
        "closed_90": _share([share >= 0.9 for share in closed]),
        "closed_median": float(np.median(closed)) if closed else None,
        "outside": len(outside),
        "outside_unnamed": _share([not row["names"] for row in outside]),
        "outside_noticed": _share([row["unexplained"] for row in outside]),
        "outside_driver": _share([row["driver"] for row in outside if row["unexplained"]]),
        "silent": sum(row["silent"] for row in judged),
        "silent_gaps": sum(row["silent"] and row["floors"] >= GAP_FROM for row in judged),
        "silent_most": max((row["floors"] for row in judged if row["silent"]), default=None),
    }


def _share(values: list[Any]) -> float | None:
    return sum(map(bool, values)) / len(values) if values else None


def confusion(rows: list[Row]) -> list[dict[str, Any]]:
    """A line for each hidden effect (of cases that hide one alone), each thing outside the table, and none."""
    lines = []
    judged = [row for row in rows if "lost" not in row]
    alone = {name: [row for row in judged if row["hidden"] == [name]] for name in EFFECTS}
    outside = sorted({row["outside"] for row in judged if row["outside"]})
    groups = {"nothing": [row for row in judged if not row["hidden"] and not row["outside"]], **alone}
    groups |= {f"{name} (outside the table)": [r for r in judged if r["outside"] == name] for name in outside}
    groups |= {f"{count} effects": [r for r in judged if len(r["hidden"]) == count] for count in (2, 3)}
    for name, cases in groups.items():
        if not cases:
            continue
        names = [said for row in cases for said in row["names"]]
        errors = [said["error"] for said in names if math.isfinite(said.get("error", math.inf))]
        within = [hit for said in names for hit in said.get("within", [])]
        wrong = Counter(said["name"] for said in names if not said["class"])
        lines.append(
            {
                "hidden": name,
                "cases": len(cases),
                "exact": sum(said["exact"] for said in names),
                "class": sum(said["class"] and not said["exact"] for said in names),
                "missed": sum(len(row["missed"]) for row in cases),
                "wrong": dict(wrong.most_common()),
                "unexplained": sum(bool(row["unexplained"]) for row in cases),
                "error": float(np.median(errors)) if errors else None,
                "coverage": _share(within),
            }
        )
    return lines
