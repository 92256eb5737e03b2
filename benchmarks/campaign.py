"""What the pages of campaigns share: the flights of a campaign's folder, where they were flown, a page's part.

python -m benchmarks.campaign PAGE NAME FOLDER     a campaign's table.md between the marks of that name
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
Entry = dict[str, Any]


def flown(folders: Sequence[str | Path]) -> list[Entry]:
    """Every flight of these campaigns, with the version that flew it; a last line that was cut off does not count."""
    entries = []
    for folder in folders:
        head, *lines = (Path(folder) / "journal.jsonl").read_text(encoding="utf-8").rpartition("\n")[0].splitlines()
        found: dict[int, Entry] = {}
        for entry in map(json.loads, lines):
            found[entry["flight"]] = found.get(entry["flight"], {}) | entry
        version = json.loads(head)["version"]
        entries += [entry | {"version": version} for _, entry in sorted(found.items())]
    return entries


def result(entry: Entry) -> dict[str, Any]:
    """What the task gave back; `lost` says why it gave nothing."""
    found: dict[str, Any] | None = entry["result"]
    return {"lost": entry["reason"]} if found is None else found


def processor() -> str:
    """What the machine computes with; times mean little without it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text("utf-8").splitlines() if info.exists() else []
    names = [line.split(": ", 1)[1] for line in lines if line.startswith("model name")]
    return f"{os.cpu_count()} cores of {names[0] if names else platform.processor() or platform.machine()}"


def about(entries: Sequence[Entry], command: str, counted: str) -> str:
    """One line: when, where, by which version, how long."""
    walls = [entry["timing"]["wall_s"] for entry in entries] or [0.0]
    by = ", then ".join(dict.fromkeys(entry["version"] for entry in entries))
    return (
        f"{date.today()}, {processor()}, Python {platform.python_version()}, flightstack {by}; `{command}`: "
        f"{counted}; one takes {statistics.median(walls):.1f} s (median), all {sum(walls) / 60.0:.0f} min."
    )


def put(text: str, begin: str, end: str, page: Path = ROOT / "docs" / "gap-measured.md") -> None:
    """Put a text between the two marks of a page."""
    old = page.read_text(encoding="utf-8")
    before, after = old.split(begin)[0], old.split(end)[1]
    page.write_text(f"{before}{begin}\n{text.rstrip()}\n{end}{after}", encoding="utf-8")


def stamp(words: str) -> str:
    """Today, the commit, and these words."""
    from flightstack.cli.versions import versions

    return f"{date.today()}, commit {versions()['git_commit']}; {words}"


if __name__ == "__main__":
    to, name, folder = sys.argv[1:]
    entries = flown([folder])
    head = about(entries, f"make campaign-{name}", f"{len(entries)} truths")
    text = Path(folder, "table.md").read_text(encoding="utf-8")
    put(f"{head}\n\n{text}", f"<!-- {name}: begin -->", f"<!-- {name}: end -->", Path(to))
