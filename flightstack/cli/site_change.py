"""A site that is replaced while it is kept: SIGUSR1 has its file read anew, beside the loop that flies."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

from flightstack.cli.site import load_site
from flightstack.site.shape import Site
from flightstack.types import InputError

_LOOKS_EVERY_S = 0.1


class SiteChanges:
    """Reads on a thread of its own: a site of 1,000 edges takes 0.15 s, and a tick has 4 ms."""

    def __init__(self, path: Path, place: tuple[float, float] | None) -> None:
        self._path, self._place = path, place
        self._asked, self._ended = False, threading.Event()
        self._read: Site | str | None = None
        signal.signal(signal.SIGUSR1, self._ask)
        threading.Thread(target=self._run, daemon=True, name="site").start()

    def take(self) -> Site | str | None:
        """A site that was read since the last call, or a line that says why it could not be; mostly None."""
        found, self._read = self._read, None
        return found

    def close(self) -> None:
        """Read no more."""
        self._ended.set()

    def _ask(self, *_: object) -> None:
        self._asked = True

    def _run(self) -> None:
        while not self._ended.wait(_LOOKS_EVERY_S):
            if not self._asked:
                continue
            self._asked = False
            try:
                self._read = load_site(self._path, self._place)
            except InputError as error:
                self._read = str(error)
