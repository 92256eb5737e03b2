"""Where words go: as wide as the terminal where there is one; else plain lines, neither wrapped nor padded.

Where nobody takes them (a closed pipe, a full disk) they stop, and nothing else does: a flight goes on.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Protocol

from rich.console import Console, Group
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text


class _Words(Console):
    """A console that falls silent where it can't write; rich's own ends the program."""

    def print(self, *objects: Any, **options: Any) -> None:
        try:
            super().print(*objects, **options)
        except OSError:
            self.on_broken_pipe()

    def on_broken_pipe(self) -> None:
        """Silent from now on; what is still in the file's buffer must not fail at the program's end."""
        self.quiet = True
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.file.fileno())
            os.close(nowhere)


errors = _Words(stderr=True, highlight=False, soft_wrap=True, emoji=False)
output = _Words(highlight=False, emoji=False)
_EVERY_S = 10.0
"""Without a terminal progress is told when the phase changes, and so often."""


class OnProgress(Protocol):
    """Share done (0..1) and what is going on."""

    def __call__(self, share: float, phase: str) -> None:
        """Show it."""


def show(what: Any) -> None:
    """A table, a text (with markup), or a group of them."""
    if output.is_terminal:
        output.print(what)
        return
    for line in _lines(what):
        output.print(Text(line), soft_wrap=True)


def facts(rows: Iterable[tuple[str, str]], title: str = "") -> None:
    """Names and what is said of each (with markup), in two columns."""
    table = Table(title=title or None, title_justify="left", show_header=False, box=None)
    table.add_column(style="dim")
    table.add_column()
    for row in rows:
        table.add_row(*row)
    show(table)


def say(text: str) -> None:
    """One line, as it is: paths are never cut, wrapped or taken for markup."""
    output.print(text, soft_wrap=True, markup=False)


def _lines(what: Any) -> Iterator[str]:
    if isinstance(what, Group):
        for part in what.renderables:
            yield from _lines(part)
    elif isinstance(what, Table):
        if what.title:
            yield _plain(what.title)
        columns = [list(column.cells) for column in what.columns]
        if what.show_header:
            yield "  ".join(_plain(column.header) for column in what.columns)
        for cells in zip(*columns, strict=True):
            yield "  ".join(" ".join(_plain(cell).split()) for cell in cells).rstrip()
    else:
        yield _plain(what)


def _plain(what: Any) -> str:
    return what.plain if isinstance(what, Text) else Text.from_markup(str(what), emoji=False).plain


@contextmanager
def progress(title: str) -> Iterator[OnProgress]:
    """A progress bar on stderr where a person looks at it, else lines on stdout: stderr is for what went wrong."""
    if not errors.is_terminal:
        yield _lines_of_progress(title)
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=errors, transient=True) as bars:
        task = bars.add_task(title, total=1.0)

        def show(share: float, phase: str) -> None:
            bars.update(task, completed=share, description=f"{title}: {phase}")

        yield show


def _lines_of_progress(title: str) -> OnProgress:
    told, due_s = "", 0.0

    def show(share: float, phase: str) -> None:
        nonlocal told, due_s
        now_s = time.monotonic()
        if phase == told and now_s < due_s:
            return
        told, due_s = phase, now_s + _EVERY_S
        output.print(Text(f"{title}: {phase}, {100.0 * share:.0f} %"), soft_wrap=True)

    return show
