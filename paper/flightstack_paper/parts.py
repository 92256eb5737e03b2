"""The run's parts on disk: what is computed is kept at once, and only what fits this very run is taken up again.

Each part is one file, DIR/parts/NAME.json: its key and its result, renamed into place when it is whole.  The key says
what the numbers depend on: the sources' hash, version and commit, seed, length of the run, plants.  A part of another
key is deleted before anything is computed, and with it every page and figure of that run: a report is never mixed.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from flightstack.cli import files
from flightstack.types import InputError

SCHEMA = "flightstack.paper-part/1"
_PACKAGES = ("flightstack", "flightstack_logs", "flightstack_paper", "flightstack_sim", "mavlink_bridge")
_PAGES = ("results.json", "report.html", "table.md")


class PartStore:
    """The folder of one run."""

    def __init__(self, out: Path, key: dict[str, Any]) -> None:
        """Make the folder and clear it of other runs; InputError, one line, where it can't be written."""
        self.out, self.folder = out, out / "parts"
        self._key = {"schema": SCHEMA, **key}
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            probe = self.folder / ".probe"
            probe.write_text("")
            probe.unlink()
            self._clear()
        except OSError as error:
            raise InputError(f"{out}: {error.strerror or error}; choose another folder with --out") from None

    def load(self, name: str) -> dict[str, Any] | None:
        """The result of a part of this very run, or nothing."""
        found = _read(self.folder / f"{name}.json")
        return found["result"] if found is not None and found["key"] == self._key else None

    def save(self, name: str, result: dict[str, Any]) -> None:
        """Keep a result; InputError where that can't be done."""
        path = self.folder / f"{name}.json"
        part = path.with_name(path.name + ".part")
        files.write_text(part, json.dumps({"key": self._key, "result": result}))
        part.replace(path)

    def place(self, name: str) -> Path:
        """The folder of the files that a part leaves behind, empty: a flight's log, its page, its certificate."""
        folder = self.folder / name
        shutil.rmtree(folder, ignore_errors=True)
        return folder

    def _clear(self) -> None:
        for name in _PAGES:
            (self.out / name).unlink(missing_ok=True)
        for picture in self.out.glob("fig*.png"):
            picture.unlink()
        for path in self.folder.glob("*.json*"):
            found = _read(path)
            if found is None or found["key"] != self._key:
                path.unlink()
                shutil.rmtree(self.folder / path.name.split(".")[0], ignore_errors=True)


def _read(path: Path) -> dict[str, Any] | None:
    """What a part's file holds; nothing where it is not whole or no part's."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and {"key", "result"} <= found.keys() else None


def sources_hash(folders: Iterable[Path] | None = None) -> str:
    """SHA-256 over every source and data file that a number may depend on (default: the project's packages)."""
    digest = hashlib.sha256()
    for folder in _package_folders() if folders is None else folders:
        for path in sorted(folder.rglob("*")):
            if path.suffix in {".py", ".toml", ".json", ".xml"} and path.is_file():
                digest.update(os.fsencode(path.relative_to(folder.parent)) + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _package_folders() -> list[Path]:
    found = (importlib.util.find_spec(package) for package in _PACKAGES)
    return [Path(place) for spec in found if spec is not None for place in spec.submodule_search_locations or ()]
