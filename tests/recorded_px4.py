"""The recorded PX4 flight for tests: topics as structured arrays, and the parameters; read by pyulog."""

from __future__ import annotations

import gzip
import io
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pyulog import ULog

FLIGHT = "px4_sih_flight.ulg.gz"


@cache
def read_flight(folder: Path) -> tuple[dict[str, Any], dict[str, tuple[str, float]]]:
    """(topic -> structured array of its first instance, parameter -> (type, value)) of the recorded PX4 SIH flight."""
    log = ULog(io.BytesIO(gzip.decompress((folder / FLIGHT).read_bytes())))
    topics = {dataset.name: _table(dataset.data) for dataset in log.data_list if dataset.multi_id == 0}
    params = {
        name: ("int32_t" if isinstance(value, int) else "float", value)
        for name, value in log.initial_parameters.items()
    }
    return topics, params


def _table(columns: dict[str, Any]) -> Any:
    """One structured array; the columns `q[0]`, `q[1]`, ... become one field `q` with a second axis."""
    grouped: dict[str, list[Any]] = {}
    for name, column in columns.items():
        grouped.setdefault(name.partition("[")[0], []).append(column)
    fields = {name: parts[0] if len(parts) == 1 else np.stack(parts, axis=-1) for name, parts in grouped.items()}
    rows = len(next(iter(fields.values())))
    table = np.empty(rows, [(name, column.dtype, column.shape[1:]) for name, column in fields.items()])
    for name, column in fields.items():
        table[name] = column
    return table


def latest(table: Any, t_us: int) -> Any:
    """The table's last row at or before `t_us`."""
    return table[max(0, int(np.searchsorted(table["timestamp"], t_us, side="right")) - 1)]
