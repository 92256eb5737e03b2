"""The report: one self-contained page with the table and the figures, and the table alone as Markdown."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from flightstack_logs.report.still import still_page
from flightstack_paper.figures import Figure
from flightstack_paper.rows import ResultLine

PAPER = "L. Wang, E. A. Theodorou, M. Egerstedt: Safe Learning of Quadrotor Dynamics Using Barrier Certificates, 2018"


def page(
    rows: Sequence[ResultLine],
    figures: Sequence[Figure],
    head: Mapping[str, Any],
    results: Mapping[str, dict[str, Any]],
    folder: Path,
) -> str:
    """The page; figures are read from `folder`."""
    hold = sum(row.holds for row in rows)
    failed = [row.id for row in rows if row.ours is None]
    good = "bad" if failed else "good" if hold == len(rows) else "partly"
    words = f"{hold} of {len(rows)} claims hold as worded" if not failed else f"not measured: {', '.join(failed)}"
    pictures = "".join(_picture(figure, folder) for figure in figures)
    table = f'<section class="panel"><h2>Claims and measurements</h2>{_table(rows)}</section>'
    return still_page(
        "The paper, side by side",
        [PAPER, _made(head)],
        f'<main>{table}<div class="pictures">{pictures}</div>{_files(results, folder)}</main>',
        state=good,
        verdict=words,
        footer="Every number was computed by this run. e: distance from the region's centre, v: its rate; "
        "north-east-down, so down is positive.",
        css=("flightstack_paper", "page.css"),
        policy="; img-src data:",
    )


def markdown(rows: Sequence[ResultLine], head: Mapping[str, Any]) -> str:
    """What docs/paper.md holds of a run: when and how, the table, and the second plant beside the first."""
    first, *others = head["plants"]
    ends = tuple(f"-{plant}" for plant in others)
    lines = [
        f"Written by `{head['command']}` on {head['date']} (version {head['version']}, commit {head['git_commit']}): "
        f"{sum(row.holds for row in rows)} of {len(rows)} claims hold as worded.",
        "",
        "| row | the paper's claim | paper | ours | holds | why |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        if not row.id.endswith(ends) or not ends:
            figures = shown(row.paper, row.unit), shown(row.ours, row.unit)
            lines.append(_line(f"`{row.id}`", row.claim, *figures, _word(row), row.note))
    by_id = {row.id: row for row in rows}
    for plant in others:
        lines += ["", f"The same on the {plant} plant:", "", f"| row | {first} | {plant} | holds ({first}, {plant}) |"]
        lines.append("| --- | --- | --- | --- |")
        for row in rows:
            if row.id.endswith(f"-{plant}"):
                one = by_id[row.id.removesuffix(f"-{plant}")]
                both = shown(one.ours, one.unit), shown(row.ours, row.unit)
                lines.append(_line(f"`{one.id}`", *both, f"{_word(one)}, {_word(row)}"))
    return "\n".join(lines) + "\n"


def _line(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def shown(value: float | None, unit: str) -> str:
    """Five digits and the unit; in words where the paper has no figure."""
    if value is None:
        return "–"
    digits = f"{value:.5g}" if value == 0.0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"
    return digits if unit == "1" else f"{digits} {unit}"


def _made(head: Mapping[str, Any]) -> str:
    return (
        f"{head['date']}, version {head['version']} ({head['git_commit'] or 'no commit'}), {head['command']}, plants: "
        f"{', '.join(head['plants'])}; {head['wall_time_s']:.0f} s, parts taken up from an earlier run: "
        f"{head['taken_up']} of {head['parts']}"
    )


def _word(row: ResultLine) -> str:
    return "yes" if row.holds else "not measured" if row.ours is None else "no"


def _table(rows: Sequence[ResultLine]) -> str:
    lines = "".join(
        f"<tr><td>{escape(row.claim)}<br><code>{escape(row.id)}</code></td>"
        f'<td class="value" data-name="paper">{escape(shown(row.paper, row.unit))}</td>'
        f'<td class="value" data-name="ours">{escape(shown(row.ours, row.unit))}</td>'
        f'<td class="{"yes" if row.holds else "no"}" data-name="holds">{_word(row)}</td>'
        f'<td class="note">{escape(row.note)}</td></tr>'
        for row in rows
    )
    head = "".join(f"<th>{words}</th>" for words in ("The paper's claim", "Paper", "Ours", "Holds", "Why, and how"))
    return f'<table class="paper"><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>'


def _picture(figure: Figure, folder: Path) -> str:
    data = base64.b64encode((folder / figure.file).read_bytes()).decode("ascii")
    return (
        f'<figure class="panel"><h2>{escape(figure.title)}</h2>'
        f'<img alt="{escape(figure.title)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
    )


def _files(results: Mapping[str, dict[str, Any]], folder: Path) -> str:
    """Logs, pages and certificates of the explorations, by their place beside this page."""
    found = [
        (name, kind, Path(path))
        for name, result in sorted(results.items())
        for kind, path in result.get("files", {}).items()
    ]
    if not found:
        return ""
    lines = "".join(
        f"<li>{escape(name)}: {escape(kind)} <code>{escape(_beside(path, folder))}</code></li>"
        for name, kind, path in found
    )
    return f'<section class="panel"><h2>What the explorations left</h2><ul>{lines}</ul></section>'


def _beside(path: Path, folder: Path) -> str:
    try:
        return str(path.resolve().relative_to(folder.resolve()))
    except ValueError:
        return str(path)
