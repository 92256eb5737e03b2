"""The last few results of one function, so that whoever asks for the same again waits for nothing."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

T = TypeVar("T")


class Remembered(Generic[T]):
    """Results by the very objects that they were made of, and by bytes; not to be written to.

    The objects are kept along with a result, else others could come to have their numbers.
    """

    __slots__ = ("_known", "_lock", "_most")

    def __init__(self, most: int) -> None:
        """`most`: how many are kept."""
        self._most = most
        self._known: dict[tuple[object, ...], tuple[tuple[object, ...], T]] = {}
        self._lock = Lock()

    def __call__(self, made: Callable[[], T], *of: object, depends: bytes = b"") -> T:
        """What was made of these before, else what `made` makes now."""
        key = (depends, *map(id, of))
        with self._lock:
            found = self._known.pop(key, None)
        if found is None:
            found = (of, made())
        with self._lock:
            while len(self._known) >= self._most:
                del self._known[next(iter(self._known))]
            self._known[key] = found
        return found[1]
