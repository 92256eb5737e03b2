"""From a log file to a `Flight`: which of a log's topics is which signal, for each kind of file.

What counts is what was measured on board: a log's truth topics are never looked at.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np

from flightstack.gap.records import Flight, Signal
from flightstack.gap.sources import DERIVED, crazyflie, mcap, ulog
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle
from flightstack_logs.columns import PLACES, ColumnMap, apply, parse_columns
from flightstack_logs.reader import Log, read
from flightstack_logs.readers.csv_file import TABLE
from flightstack_logs.standard import with_vehicle_topics

_UNIT = 0.1
"""By which a quaternion's length may be off."""
_MOST_CHARACTERS = 1_000_000
"""Read of a map of columns, which has some dozen lines."""


def flight(path: Path | str, vehicle: Vehicle, columns: Path | str | None = None) -> Flight:
    """The flight in a log; InputError, one line, where there is none.

    `columns` is a TOML file that says what the columns of a CSV (or of a Crazyflie log) mean; the name of one that
    comes with the program (crazyflie, gazebo_iris, nanobench) will do.
    """
    mapped = None if columns is None else column_map(columns)
    log = read(path, mapped)
    if mapped is not None and log.kind not in ("csv", "cfusdlog"):
        raise InputError(f"log {path}: is {log.kind}, whose topics are known; --columns is for CSV and Crazyflie logs")
    if log.kind == "mcap":
        signals, notes = mcap.signals(log)
    elif log.kind in ("tlog", "dataflash"):
        signals, notes = mcap.signals(with_vehicle_topics(log))
    elif log.kind == "ulog":
        signals, notes = ulog.signals(log, vehicle)
    elif log.kind == "cfusdlog":
        signals, notes = _crazyflie(log, vehicle, mapped)
    else:
        signals, notes = _csv(log, vehicle)
    if not signals:
        raise InputError(f"log {path}: holds no signal of a flight; it needs velocity or acceleration, and motors")
    return Flight(Path(path).name, log.kind, signals, (*log.notes, *notes))


def column_map(name: Path | str) -> ColumnMap:
    """A map of columns, from a file or by the name of one that comes with the program."""
    own = resources.files("flightstack.gap").joinpath("columns", f"{name}.toml")
    if str(name).isidentifier() and own.is_file():
        return parse_columns(own.read_text("utf-8"), f"columns {name}")
    try:
        with Path(name).open(encoding="utf-8") as file:
            text = file.read(_MOST_CHARACTERS + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"columns {name}: can't be read ({error}); check the path".replace("\n", " ")) from None
    if len(text) > _MOST_CHARACTERS:
        raise InputError(f"columns {name}: is too large for a map of columns")
    return parse_columns(text, f"columns {name}")


def _csv(log: Log, vehicle: Vehicle) -> tuple[dict[str, Signal], list[str]]:
    table = log.tables[TABLE]
    places = {name: tuple(said.split(", ")) for name, said in log.metadata.get("places", {}).items()}
    return _signals(table.t_us, table.columns, log.metadata["columns"], places, vehicle)


def _crazyflie(log: Log, vehicle: Vehicle, mapped: ColumnMap | None) -> tuple[dict[str, Signal], list[str]]:
    """Of the table that has the most rows: the one logged at a fixed rate."""
    table = max(log.tables.values(), key=len)
    values, sources, places = apply(mapped or column_map("crazyflie"), table.columns, f"log {log.path}")
    notes = []
    if "q_ned_frd" not in values and "acc_ned_mps2" in values:
        attitude = crazyflie.attitude_from_tilt(table.t_us, table.columns, values["acc_ned_mps2"])
        if attitude is not None:
            values["q_ned_frd"], sources["q_ned_frd"] = attitude, f"{DERIVED} roll, yaw and acceleration"
            notes.append(
                "attitude: the log has roll and yaw only; pitch was taken from the acceleration, drag neglected"
            )
    signals, more = _signals(table.t_us, values, sources, places, vehicle)
    return signals, [*notes, *more]


def _signals(
    t_us: np.ndarray,
    values: dict[str, F64],
    sources: dict[str, str],
    places: dict[str, tuple[str, ...]],
    vehicle: Vehicle,
) -> tuple[dict[str, Signal], list[str]]:
    """Signals out of columns: of each the rows that it has; motors in the vehicle file's order."""
    notes: list[str] = []
    signals: dict[str, Signal] = {}
    for name, rows in values.items():
        if name in places:
            order = rotor_order(places[name], vehicle)
            rows = rows[:, order]
            notes.append(f"motors put into the vehicle file's order by where they sit: columns {sources[name]}")
        good = np.isfinite(rows) if rows.ndim == 1 else np.isfinite(rows).all(axis=1)
        if name == "q_ned_frd":
            good &= np.abs(np.linalg.norm(np.nan_to_num(rows), axis=1) - 1.0) < _UNIT
        if not good.any():
            notes.append(f"{name}: holds no {'attitude' if name == 'q_ned_frd' else 'numbers'}")
            continue
        lost = int(np.sum(~good))
        if lost:
            notes.append(f"{name}: {lost} of {len(rows)} rows hold no numbers and were left out")
        signals[name] = Signal(t_us[good] * 1e-6, rows[good], sources.get(name, name))
    return signals, notes


def rotor_order(places: tuple[str, ...], vehicle: Vehicle) -> list[int]:
    """Which column is the vehicle file's first, second ... rotor, by where the rotors sit; else in PX4's order."""
    said = [
        f"{'front' if x > 0 else 'rear'} {'right' if y > 0 else 'left'}"
        for x, y, _ in vehicle.rotors.position_m.tolist()
    ]
    wanted = said if sorted(said) == sorted(PLACES) else list(PLACES)
    return [places.index(place) for place in wanted]
