"""Build hook: what is built of a checkout says which commit that was (`flightstack/_commit.py` in wheel and sdist)."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_PLACE = "flightstack/_commit.py"


class CommitHook(BuildHookInterface):  # type: ignore[type-arg]
    """Puts the commit into the package; of a tree that is no checkout, what it was built with stays."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Before the build; an editable install looks at its checkout itself."""
        root = Path(self.root)
        if version == "editable" or not (root / ".git").exists():
            return
        command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
        try:
            answer = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
        except (OSError, subprocess.SubprocessError):
            return
        self._folder = tempfile.TemporaryDirectory()
        made = Path(self._folder.name) / "_commit.py"
        made.write_text(f'"""Written by the build."""\n\nCOMMIT = "{answer.stdout.strip()}"\n', encoding="utf-8")
        build_data["force_include"][str(made)] = _PLACE

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """After the build."""
        folder = getattr(self, "_folder", None)
        if folder is not None:
            folder.cleanup()
