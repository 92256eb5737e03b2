"""The tables of the blind campaign, as Markdown between two marks of docs/gap-measured.md; 1 where a bar is missed.

python -m benchmarks.gap_tables FOLDER...      of campaigns by campaigns/gap-blind.toml; cases of the present rules
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

from benchmarks import campaign
from benchmarks.gap_judge import Row, confusion, summary
from benchmarks.gap_rules import rules

BEGIN, END = "<!-- blind campaign: begin -->", "<!-- blind campaign: end -->"


class Bar(NamedTuple):
    """One figure that the campaign is judged by."""

    key: str
    words: str
    least: float | None
    most: float | None


BARS = (
    Bar("false_names_clean", "clean flights with a name", None, 0.01),
    Bar("right_class", "names that are right in their class", 0.98, None),
    Bar("exact_alone", "names without a twin that are exact", 0.95, None),
    Bar("coverage", "95 % intervals that hold the truth", 0.90, 0.98),
    Bar("median_error", "median error of a named effect's parameters", None, 0.05),
    Bar("closed_90", "named cases whose held-out gap closes by 90 %", 0.95, None),
    Bar("outside_unnamed", "effects outside the table that are not named", 0.95, None),
)


def kept(bar: Bar, figures: dict[str, Any]) -> bool | None:
    """Whether the bar is kept; None where nothing was counted."""
    value = figures[bar.key]
    if value is None:
        return None
    return (bar.least is None or value >= bar.least) and (bar.most is None or value <= bar.most)


def shown(bar: Bar, figures: dict[str, Any]) -> str:
    """The figure and whether it keeps its bar."""
    verdict = {True: "kept", False: "MISSED", None: "nothing counted"}[kept(bar, figures)]
    return f"{percent(figures[bar.key])} ({verdict})"


def percent(value: float | None) -> str:
    """A share in per cent, one decimal."""
    return "–" if value is None else f"{100.0 * value:.1f} %"


def _asked(bar: Bar) -> str:
    if bar.least is not None and bar.most is not None:
        return f"{percent(bar.least)} to {percent(bar.most)}"
    return f"at least {percent(bar.least)}" if bar.least is not None else f"at most {percent(bar.most)}"


def tables(rows: list[Row], entries: list[dict[str, Any]], command: str) -> str:
    """The whole section."""
    figures = summary(rows)
    counted = (
        f"{figures['cases']} cases ({figures['clean']} clean, {figures['outside']} with something outside the table, "
        f"{figures['lost']} lost)"
    )
    lines = [
        campaign.about(entries, command, counted),
        "",
        "| figure | measured | asked for |",
        "| --- | --: | --: |",
    ]
    for bar in BARS:
        mark = {True: "", False: " **missed**", None: ""}[kept(bar, figures)]
        lines.append(f"| {bar.words} | {percent(figures[bar.key])}{mark} | {_asked(bar)} |")
    for key, text in (
        ("found", "cases in which every hidden effect is named (itself or by a twin)"),
        ("with_twins", "names with a twin that the log can't tell apart"),
        ("closed_median", "median share of the held-out gap that is closed"),
        ("outside_noticed", "effects outside the table that are noticed as unexplained"),
        ("outside_driver", "of these: the right driver"),
        ("false_alarms_clean", "clean flights called unexplained"),
    ):
        lines.append(f"| {text} | {percent(figures[key])} | |")
    mark, most = " **missed**" if figures["silent_gaps"] else "", figures["silent_most"]
    floors = "" if most is None else f" (the largest held-out figure of these: {most:.2f} floors)"
    lines += [
        f'| "no gap" with something hidden{floors} | {figures["silent"]} | |',
        f"| of these at 1.2 floors or more | {figures['silent_gaps']}{mark} | 0 |",
        "",
        "| hidden | cases | named exactly | in its class | missed | named instead | unexplained | median error | "
        "intervals that hold |",
        "| --- | --: | --: | --: | --: | --- | --: | --: | --: |",
    ]
    for line in confusion(rows):
        instead = ", ".join(f"{name} {count}" for name, count in line["wrong"].items())
        lines.append(
            f"| {line['hidden']} | {line['cases']} | {line['exact']} | {line['class']} | {line['missed']} | {instead} "
            f"| {line['unexplained']} | {percent(line['error'])} | {percent(line['coverage'])} |"
        )
    return "\n".join(lines) + "\n"


def present(entries: list[dict[str, Any]]) -> list[Row]:
    """The cases that the present rules judged, and those that were lost."""
    return [row for entry in entries if (row := campaign.result(entry)).get("rules", rules()) == rules()]


if __name__ == "__main__":
    entries = campaign.flown(sys.argv[1:])
    cases = present(entries)
    campaign.put(tables(cases, entries, "make gap-blind"), BEGIN, END)
    figures = summary(cases)
    for each in BARS:
        print(f"{each.words}: {shown(each, figures)}")
    print(f'"no gap" with a gap: {figures["silent_gaps"]}')
    whole = all(kept(each, figures) is not False for each in BARS)
    sys.exit(0 if whole and not figures["lost"] and not figures["silent_gaps"] else 1)
