"""Numbers of a flight, tick by tick, for what is worked out at its end: eight bytes each.

Objects would take a hundred times as much: an hour of ticks kept as they came was a gigabyte of locked memory.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator

import numpy as np

from flightstack.types import F64

_PIECE = 8_192
"""Numbers; a piece that is full stays where it is: to move all of a flight's would stall a tick."""


class Column:
    """Numbers in the order in which they came; rows of several numbers one after the other."""

    __slots__ = ("_last", "_pieces", "_width")

    def __init__(self, width: int = 1) -> None:
        """`width`: numbers of a row."""
        self._width = width
        self._last = array("d")
        self._pieces = [self._last]

    def __len__(self) -> int:
        """Rows."""
        return sum(map(len, self._pieces)) // self._width

    def __iter__(self) -> Iterator[float]:
        """All numbers."""
        for piece in self._pieces:
            yield from piece

    def append(self, number: float) -> None:
        """A row of one number."""
        self._last.append(number)
        if len(self._last) >= _PIECE:
            self._begin_piece()

    def extend(self, row: Iterable[float]) -> None:
        """A row of `width` numbers."""
        self._last.extend(row)
        if len(self._last) >= _PIECE:
            self._begin_piece()

    def extend_bytes(self, row: bytes) -> None:
        """The same of the bytes of so many."""
        self._last.frombytes(row)
        if len(self._last) >= _PIECE:
            self._begin_piece()

    def table(self) -> F64:
        """(rows, width), or (rows,) of single numbers."""
        numbers = np.concatenate([np.frombuffer(piece, dtype=np.float64) for piece in self._pieces])
        return numbers if self._width == 1 else numbers.reshape(-1, self._width)

    def _begin_piece(self) -> None:
        self._last = array("d")
        self._pieces.append(self._last)
