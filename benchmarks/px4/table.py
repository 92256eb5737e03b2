"""docs/px4.md's tables: one block a subject between markers, so that a run replaces its own block and no other."""

from __future__ import annotations

import re
from pathlib import Path

from benchmarks.px4.records import Row

HEAD = """# On a real PX4

What flightstack does on a real PX4 (SITL), flown by `make px4`; nothing of PX4 is in this repository.  `PX4_HOME` names
a folder with an executable `run.sh INSTANCE [sih|hil]`, which runs a PX4 in the foreground until SIGTERM, at default
parameters where `FRESH=1` is set.

```sh
PX4_HOME=~/px4 make px4                                    # every subject in full: some hours
PX4_HOME=~/px4 .venv/bin/python -m benchmarks.px4 hover    # one subject; --runs N flies it N times
```

SIH is PX4's internal simulator; truth is what it simulates, as told over MAVLink.  `+-` is one standard deviation over
the runs.
"""


def block(subject: str, asked: str, rows: list[Row], made_with: str) -> str:
    """The Markdown of one subject."""
    lines = [f"## {subject}", "", asked, "", "| what | measured | runs | reached |", "| --- | --- | --- | --- |"]
    words = {True: "yes", False: "**no**", None: ""}
    lines += [f"| {row.what} | {row.measured} | {row.runs} | {words[row.reached]} |" for row in rows]
    notes = [f"* {row.what}: {note}" for row in rows for note in row.notes]
    return "\n".join([*lines, "", *notes, *([""] if notes else []), made_with])


def put(page: Path, subject: str, text: str) -> None:
    """Replace or append the subject's block."""
    begin, end = f"<!-- {subject}: begin -->", f"<!-- {subject}: end -->"
    whole = page.read_text() if page.exists() else HEAD
    new = f"{begin}\n{text}\n{end}"
    if begin in whole:
        whole = re.sub(re.escape(begin) + ".*?" + re.escape(end), lambda _: new, whole, flags=re.DOTALL)
    else:
        whole = whole.rstrip("\n") + "\n\n" + new + "\n"
    page.write_text(whole)
