"""What reading gives: a `Log` of typed tables, whatever kind of file it came from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flightstack.types import I64, InputError
from flightstack_logs.topics import Attachment

if TYPE_CHECKING:
    import pandas
    import polars


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The messages of one topic as columns."""

    name: str
    t_us: I64
    """(N,) log time, microseconds, ascending: this project's logs count from 0 at their start, others as they do."""
    columns: dict[str, np.ndarray]
    """Field -> (N,) or (N, k); float64, int64, bool or str.  The vehicle's stamps are on the log's time line."""
    units: dict[str, str]
    """Field -> unit, as the log says."""
    place: I64 | None = None
    """(N,) place of each row among everything that was written packed (`rows`)."""

    def __len__(self) -> int:
        return len(self.t_us)

    def __getitem__(self, column: str) -> np.ndarray:
        return self.columns[column]

    def to_pandas(self) -> pandas.DataFrame:
        """A pandas frame with log time in seconds as its index, `t_s`; parts of a vector are columns `NAME_0`, ...

        InputError where pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise InputError("this needs pandas: pip install 'flightstack[pandas]'") from None
        return pandas.DataFrame(self._flat(), index=pandas.Index(self.t_us / 1e6, name="t_s"))

    def to_polars(self) -> polars.DataFrame:
        """A polars frame with log time in seconds as its first column, `t_s`; parts of a vector as in `to_pandas`.

        InputError where polars is not installed.
        """
        try:
            import polars
        except ImportError:
            raise InputError("this needs polars: pip install 'flightstack[polars]'") from None
        return polars.DataFrame({"t_s": self.t_us / 1e6, **self._flat()})

    def _flat(self) -> dict[str, np.ndarray]:
        flat: dict[str, np.ndarray] = {}
        for name, values in self.columns.items():
            if values.ndim == 1:
                flat[name] = values
            else:
                flat |= {f"{name}_{part}": np.ascontiguousarray(column) for part, column in enumerate(values.T)}
        return flat


def plain(values: np.ndarray) -> np.ndarray:
    """A column (N,) or (N, k) as a table holds it: float64, int64, bool or str; bytes are taken for UTF-8."""
    if values.dtype.kind == "S":
        return np.array([value.decode("utf-8", "replace") for value in values.tolist()], dtype=np.str_)
    if values.dtype.kind in "bU":
        return values
    return values.astype(np.float64 if values.dtype.kind == "f" else np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """The messages of one topic as they were logged: raw MAVLink, viewer messages, anything that is no table."""

    name: str
    t_us: I64
    """(N,) as in `Table`."""
    data: list[bytes]
    place: I64 | None = None
    """As in `Table`."""

    def __len__(self) -> int:
        return len(self.t_us)


@dataclass(frozen=True, slots=True)
class About:
    """What a log says about one of its topics."""

    kind: str
    """table, raw, log or view; empty in a log of other origin."""
    schema: str
    description: str
    source: str
    rate_hz: float
    """Nominal, 0 where none."""


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A whole log."""

    path: Path
    kind: str
    """Kind of file: mcap, ulog, tlog, dataflash, csv, cfusdlog."""
    complete: bool
    """False where the file was cut off or is damaged; `notes` says how."""
    notes: tuple[str, ...]
    tables: dict[str, Table]
    messages: dict[str, Messages]
    about: dict[str, About]
    metadata: dict[str, dict[str, str]]
    attachments: tuple[Attachment, ...]
    size_bytes: int

    @classmethod
    def of_tables(
        cls, path: Path, kind: str, about: About, tables: dict[str, Table], notes: list[str], size_bytes: int,
        *, complete: bool = True, metadata: dict[str, dict[str, str]] | None = None,
    ) -> Log:  # fmt: skip
        """A log of other origin: tables alone, of each of which the same is to be said."""
        said = dict.fromkeys(tables, about)
        return cls(path, kind, complete, tuple(notes), tables, {}, said, metadata or {}, (), size_bytes)

    @property
    def span_us(self) -> tuple[int, int]:
        """First and last log time; (0, 0) in an empty log."""
        all_times = [table.t_us for table in self.tables.values()] + [raw.t_us for raw in self.messages.values()]
        times = [t for t in all_times if len(t)]
        if not times:
            return 0, 0
        return min(int(t[0]) for t in times), max(int(t[-1]) for t in times)

    def attachment(self, name: str) -> bytes | None:
        """Content of the attachment of that name."""
        return next((item.data for item in self.attachments if item.name == name), None)
