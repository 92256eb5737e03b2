"""What subjects work with and what they give back."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Bench:
    """Where PX4 stands and where files go."""

    home: Path
    """Folder with `run.sh`."""
    out: Path
    """Folder for logs and results."""
    instance: int = 0
    """Of the first PX4; ports follow from it."""
    prefix: tuple[str, ...] = ()
    """Words before every command of the companion, such as a scheduling policy."""
    px4_prefix: tuple[str, ...] = ()
    """And before PX4's."""


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the table."""

    what: str
    measured: str
    reached: bool | None
    """None: measured without a target."""
    runs: int
    notes: list[str] = field(default_factory=list)
    """One line for each run that failed."""
