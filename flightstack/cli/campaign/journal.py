"""What a campaign has flown so far: one line of JSON for each flight, on disk before the next is counted.

A line that was cut off when the campaign was killed does not count, and is cut away before anything is added.  One
process at a time writes a journal; a disk that is full is tried again at the next flight.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections import Counter
from pathlib import Path
from typing import Any

from flightstack.errors import InputError

NAME = "journal.jsonl"
Entry = dict[str, Any]


class Journal:
    """An open journal; `entries`: flight -> what is known of it."""

    def __init__(self, folder: Path, head: Entry, *, resume: bool) -> None:
        """Begin, or go on with, the journal of the campaign that `head` names."""
        self.path = folder / NAME
        self.entries: dict[int, Entry] = {}
        self.outcomes: Counter[str] = Counter()
        self.problem = ""
        """Why not everything is on disk, one line; empty where it is."""
        self._unwritten: list[bytes] = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise InputError(f"{folder}: {error.strerror}; choose another place with --out") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise InputError(f"{folder}: another process is at this campaign") from None
        try:
            self._open(folder, head, resume)
        except BaseException:
            self.close()
            raise

    def _open(self, folder: Path, head: Entry, resume: bool) -> None:
        text = self.path.read_bytes()
        whole = text[: text.rfind(b"\n") + 1]
        lines = whole.splitlines()
        if not lines:
            os.ftruncate(self._file, 0)
            self._append(head)
            if self.problem:
                raise InputError(f"{folder}: {self.problem}")
            return
        if not resume:
            raise InputError(f"{folder}: holds a campaign already; go on with it by --resume, or choose another --out")
        self._check(folder, json.loads(lines[0]), head)
        for line in lines[1:]:
            entry = json.loads(line)
            self.entries[int(entry["flight"])] = self.entries.get(int(entry["flight"]), {}) | entry
        self.outcomes.update(str(entry["outcome"]) for entry in self.entries.values())
        os.ftruncate(self._file, len(whole))
        os.lseek(self._file, 0, os.SEEK_END)

    @staticmethod
    def _check(folder: Path, found: Entry, head: Entry) -> None:
        words = {"campaign": "another campaign file (or its scenarios were changed)", "version": "another version"}
        for key, what in words.items():
            if found.get(key) != head[key]:
                raise InputError(
                    f"{folder}: was flown with {what}: {found.get(key)}, now {head[key]}; choose another --out"
                )

    def add(self, entry: Entry) -> None:
        """Keep what is known of a flight; the first that comes counts."""
        if entry["flight"] not in self.entries:
            self.entries[entry["flight"]] = entry
            self.outcomes[entry["outcome"]] += 1
            self._append(entry)

    def update(self, flight: int, fields: Entry) -> None:
        """Something more of a flight that is kept already."""
        self.entries[flight] = self.entries[flight] | fields
        self._append({"flight": flight} | fields)

    def ordered(self, count: int | None) -> list[Entry]:
        """Flights by number, those below `count`."""
        return [self.entries[flight] for flight in sorted(self.entries) if count is None or flight < count]

    def _append(self, entry: Entry) -> None:
        self._unwritten.append(json.dumps(entry, separators=(",", ":")).encode() + b"\n")
        self.flush()

    def flush(self) -> None:
        """Try to bring to disk what is not there yet; `problem` says why that failed."""
        end = os.lseek(self._file, 0, os.SEEK_END)
        try:
            while self._unwritten:
                line = self._unwritten[0]
                if os.write(self._file, line) != len(line):
                    raise OSError(28, "No space left on device")
                os.fsync(self._file)
                end += len(line)
                del self._unwritten[0]
            self.problem = ""
        except OSError as error:
            os.ftruncate(self._file, end)
            self.problem = f"{error.strerror}: {len(self._unwritten)} flights are not on disk yet"

    def close(self) -> None:
        """Let another process have it."""
        os.close(self._file)
