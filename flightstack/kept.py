"""Results of long searches, kept on disk beside the compiled code of the sources that they follow from.

A search with given inputs, sources and processor finds the same numbers each time, and every start asks for the same
ones.  They lie in their code's cache folder (`jit.code_folder`): an edit of any source that the search's module imports
begins another.  What can't be read as it was written is worked out anew; where nothing can be written nothing is kept.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from flightstack.jit import code_folder, machine_key

_MOST = 10_000
"""Results in one folder: vehicles and loads that repeat are far fewer, a learned one is asked for once."""


def kept(module: str, question: object, search: Callable[[], list[float]]) -> list[float]:
    """What `search` finds: read, or found and kept.

    `question` holds whatever the result depends on apart from the sources of `module` and what it imports; its `repr`
    must tell it exactly, as that of numbers, tuples and named tuples of them does.
    """
    folder = code_folder(module)
    if folder is None:
        return search()
    about = f"{np.__version__} {machine_key()} {question!r}"
    file = folder / f"kept-{hashlib.sha256(about.encode()).hexdigest()[:32]}"
    known = _read(file)
    if known is None:
        known = search()
        _write(file, known)
    return known


def _signed(text: str) -> str:
    return f"{text}\n{hashlib.sha256(text.encode()).hexdigest()}\n"


def _read(file: Path) -> list[float] | None:
    """The numbers of a file; None where there is none, or another than was written."""
    try:
        whole = file.read_text(encoding="ascii")
    except (OSError, ValueError):
        return None
    text = whole.partition("\n")[0]
    return [float.fromhex(each) for each in text.split()] if whole == _signed(text) else None


def _write(file: Path, numbers: list[float]) -> None:
    """Whole or not at all: another process may read it."""
    try:
        if sum(1 for _ in file.parent.glob("kept-*")) >= _MOST:
            return
        with tempfile.NamedTemporaryFile("w", dir=file.parent, prefix="new-", delete=False, encoding="ascii") as new:
            new.write(_signed(" ".join(float(each).hex() for each in numbers)))
        os.replace(new.name, file)
    except OSError:
        return
