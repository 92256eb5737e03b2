"""CSV in: this project's header (`time_s,pos_n_m,...`), or any other with a map of its columns.

The log has one table, `flight`, whose columns are signals in SI, NED and FRD; what a row lacks is NaN there.
"""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from flightstack.types import F64, InputError
from flightstack_logs.columns import SCHEMA, ColumnMap, apply, parse_columns
from flightstack_logs.tables import About, Log, Table

_ABOUT = About("table", "csv", "", "", 0.0)
TABLE = "flight"
HEADER = (
    *("time_s", "pos_n_m", "pos_e_m", "pos_d_m", "vel_n_mps", "vel_e_mps", "vel_d_mps", "q_w", "q_x", "q_y", "q_z"),
    *("rate_x_radps", "rate_y_radps", "rate_z_radps", "accel_x_mps2", "accel_y_mps2", "accel_z_mps2"),
    *("motor_1", "motor_2", "motor_3", "motor_4", "battery_v"),
)
_OWN = f"""
schema = "{SCHEMA}"
lenient = true
time = {{ column = "time_s" }}
position = {{ columns = ["pos_n_m", "pos_e_m", "pos_d_m"] }}
velocity = {{ columns = ["vel_n_mps", "vel_e_mps", "vel_d_mps"] }}
kinematic_acceleration = {{ columns = ["acc_n_mps2", "acc_e_mps2", "acc_d_mps2"] }}
attitude = {{ columns = ["q_w", "q_x", "q_y", "q_z"] }}
rates = {{ columns = ["rate_x_radps", "rate_y_radps", "rate_z_radps"] }}
specific_force = {{ columns = ["accel_x_mps2", "accel_y_mps2", "accel_z_mps2"] }}
motors = {{ columns = ["motor_1", "motor_2", "motor_3", "motor_4"] }}
rotor_speeds = {{ columns = ["motor_rpm_1", "motor_rpm_2", "motor_rpm_3", "motor_rpm_4"] }}
battery = {{ columns = ["battery_v"] }}
landed = {{ columns = ["landed"] }}
height = {{ columns = ["height_m"] }}
"""
UNITS = {"pos_ned_m": "m", "vel_ned_mps": "m/s", "acc_ned_mps2": "m/s^2", "q_ned_frd": "1", "rate_frd_radps": "rad/s",
         "accel_frd_mps2": "m/s^2", "motor": "1", "rotor_speed_radps": "rad/s",
         "battery_v": "V", "height_m": "m", "landed": ""}  # fmt: skip
_KNOWN = frozenset(re.findall(r'"([a-z0-9_]+)"', _OWN))
_UNIT = re.compile(r"_(s|m|mps|radps|mps2|v)$")
_MOTION = frozenset(("pos_n_m", "vel_n_mps", "acc_n_mps2", "accel_x_mps2"))
_TIMES = frozenset(("time_s", "time", "t"))
"""Names of this project's first column, as strangers write it."""
_FIRST, _LONGEST = 24, 40
"""Names that a line lists, and letters of each."""
_LATEST_S = 4e9
_MOST_BACK = 50.0
"""Usual steps that time may go back by, in a few rows that came late."""
_UNSORTED = 0.01
"""Share of rows from which a table is merely unsorted."""


def is_text_table(data: bytes) -> bool:
    """Whether the header is printable text of several fields, and rows of numbers follow (or none at all)."""
    header, body = _from_header(data[:65536])
    try:
        text = header.decode("utf-8-sig")
    except UnicodeDecodeError:
        return False
    separator = _separator(text)
    if separator is None or not text.replace("\t", " ").isprintable():
        return False
    return bool(_TIMES & {name.strip(' "') for name in text.lower().split(separator)}) or _has_rows(body, separator)


def _has_rows(body: bytes, separator: str) -> bool:
    """Whether no line follows, or as many lines as not hold a number: prose has commas, too, but hardly such lines."""
    lines = [line for line in body.splitlines() if line.strip()]
    mark = separator.encode()
    numbers = sum(any(map(_is_number, line.split(mark))) for line in lines)
    return 2 * numbers >= len(lines)


def _from_header(data: bytes) -> tuple[bytes, bytes]:
    """The header's line and what follows; lines of comment before are left out.

    Where numbers follow comments at once, the last of these is the header (`numpy.savetxt` writes it so).
    """
    line, after, comment = b"", data.removeprefix(codecs.BOM_UTF8), b""
    while after:
        rest = after
        line, _, after = (part.strip(b"\r") for part in rest.partition(b"\n"))
        if not line.startswith(b"#") and line.strip():
            return (line, after) if not (comment and _is_number(line)) else (comment.lstrip(b"# "), rest)
        comment = line or comment
    return comment, after


def _is_number(line: bytes) -> bool:
    """Whether its first cell is one."""
    try:
        float(line.replace(b";", b",").replace(b"\t", b",").split(b",")[0])
    except ValueError:
        return False
    return True


def _separator(header: str) -> str | None:
    return max((mark for mark in ",;\t" if mark in header), key=header.count, default=None)


def read_csv(path: Path, data: bytes, columns: ColumnMap | None) -> Log:
    """The log in `data`; InputError where its columns are not known or it has no rows."""
    where = f"log {path}"
    raw, notes = raw_table(data, where)
    if columns is None:
        raw, more = _by_our_names(raw)
        notes += more
        if "time_s" not in raw:
            raise InputError(f"{where}: is a CSV with other columns than time_s,pos_n_m,...: {_listed(raw)}; say what "
                             "they are with --columns FILE (docs/gap-logs.md)")  # fmt: skip
        _check_motors(raw, where)
        columns = parse_columns(_OWN, "header")
    if columns.time is None or columns.time[0] not in raw:
        name = columns.time[0] if columns.time else "[time]"
        raise InputError(f"{where}: has no column {name} for the time; it has {_listed(raw)}")
    signals, sources, places = apply(columns, raw, where)
    if not signals:
        raise InputError(f"{where}: has none of the columns of a flight beside time_s; it needs at least velocity")
    t_us, signals, more = _in_time(raw[columns.time[0]] * columns.time[1], signals, where)
    table = Table(TABLE, t_us, dict(signals), {name: UNITS[name] for name in signals})
    metadata = {"columns": sources}
    if places:
        metadata["places"] = {name: ", ".join(said) for name, said in places.items()}
    return Log.of_tables(path, "csv", _ABOUT, {TABLE: table}, notes + more, len(data), metadata=metadata)


def _by_our_names(raw: dict[str, F64]) -> tuple[dict[str, F64], list[str]]:
    """The columns under this project's names, and what is said of it.

    Capitals don't matter, and names that lack their unit (pos_n, accel_x, time) are SI.  Other names are not used.
    """
    ours = {**{name.rpartition("_")[0]: name for name in _KNOWN if _UNIT.search(name)}, "t": "time_s"}
    out: dict[str, F64] = {}
    bare: list[str] = []
    for name, column in raw.items():
        low = name.lower()
        own = low if low in _KNOWN else ours.get(low, name)
        if own in out or (own != name and own in raw):
            own = name
        out[own] = column
        bare += [name] if own not in (name, low) else []
    unused = [name for name in out if name not in _KNOWN]
    if "time_s" not in out or not (_MOTION & out.keys() or "time_s" in raw):
        return raw, []
    notes = [f"columns without a unit were taken for SI: {_listed(bare)}"] if bare else []
    return out, notes + ([f"columns that are not known were not used: {_listed(unused)}"] if unused else [])


def _listed(names: Iterable[str]) -> str:
    """The first of these names."""
    few = list(names)
    return ", ".join(name[:_LONGEST] for name in few[:_FIRST]) + (
        f" and {len(few) - _FIRST} more" if len(few) > _FIRST else ""
    )


def _check_motors(raw: dict[str, F64], where: str) -> None:
    """All vehicles have four rotors here: more that move, or fewer, are another vehicle's."""
    motors = [name for name in raw if name.startswith("motor_") and name[6:].isdigit() and np.any(raw[name] > 0.0)]
    named = [name for name in raw if name.startswith("motor_") and name[6:].isdigit()]
    if motors and (len(motors) > 4 or len(named) < 4):
        raise InputError(f"{where}: has {len(motors)} motors, a vehicle file has 4 rotors; name a quadrotor's flight")


def raw_table(data: bytes, where: str) -> tuple[dict[str, F64], list[str]]:
    """Column name -> numbers (NaN where a cell is none) and what was noticed."""
    header, body = (part.decode("utf-8", "replace") for part in _from_header(data))
    separator = _separator(header) or ","
    if separator == ";" and "." not in body:  # decimal commas
        body = body.replace(",", ".")
    names = [name.strip().strip('"') for name in header.split(separator)]
    named = [name for name in names if name]
    if len(set(named)) != len(named):
        twice = next(name for name in named if named.count(name) > 1)
        raise InputError(f"{where}: has two columns named {twice}; name them apart")
    if not body.strip():
        raise InputError(f"{where}: has a header and no rows; nothing was recorded")
    try:
        values = np.loadtxt(io.StringIO(body), delimiter=separator, ndmin=2, comments=None)
        notes: list[str] = []
    except ValueError:
        values, notes = _tolerant(body, separator, len(names))
    if values.shape[1] != len(names):
        raise InputError(f"{where}: rows have {values.shape[1]} cells, the header {len(names)}; it is damaged")
    return {name: values[:, place] for place, name in enumerate(names) if name}, notes


def _tolerant(body: str, separator: str, width: int) -> tuple[F64, list[str]]:
    """Cells that are no numbers are NaN; rows that aren't as wide as the header are left out."""
    rows, left_out, odd = [], 0, 0
    for line in body.splitlines():
        if not line.strip():
            continue
        cells = line.split(separator)
        if len(cells) != width:
            left_out += 1
            continue
        row = []
        for cell in cells:
            try:
                row.append(float(cell))
            except ValueError:
                row.append(_word(cell))
                odd += row[-1] != row[-1] and bool(cell.strip())
        rows.append(row)
    notes = [f"{left_out} rows are not as wide as the header and were left out"] if left_out else []
    notes += [f"{odd} cells are no numbers and count as missing"] if odd else []
    return np.array(rows, np.float64).reshape(len(rows), width), notes


def _word(cell: str) -> float:
    """True and False as numbers; anything else is missing."""
    return {"true": 1.0, "false": 0.0}.get(cell.strip().strip('"').lower(), float("nan"))


def _stray(t_s: F64) -> np.ndarray:
    """Single rows (N,) whose time is far from both neighbours', which are near each other."""
    far = _MOST_BACK * float(np.median(np.abs(np.diff(t_s)))) if len(t_s) > 1 else np.inf
    stray = np.zeros(len(t_s), dtype=bool)
    before, own, after = t_s[:-2], t_s[1:-1], t_s[2:]
    stray[1:-1] = (np.abs(after - before) <= far) & (np.minimum(np.abs(own - before), np.abs(own - after)) > far)
    return stray


def _in_time(t_s: F64, signals: dict[str, F64], where: str) -> tuple[np.ndarray, dict[str, F64], list[str]]:
    """Rows in ascending order of time, each time once; InputError where there is no time to speak of."""
    notes = []
    good = np.isfinite(t_s) & (np.abs(t_s) < _LATEST_S * 1e9)
    if not good.any():
        raise InputError(f"{where}: its time column holds no numbers; it needs the time of each row")
    if not good.all():
        notes.append(f"{int(np.sum(~good))} rows without a time were left out")
    kept = np.flatnonzero(good)
    stray = _stray(t_s[kept])
    if 0 < stray.sum() < _UNSORTED * len(kept):
        notes.append(f"{int(stray.sum())} rows with a time far from both neighbours' were left out")
        kept = kept[~stray]
    backwards = int(np.sum(np.diff(t_s[kept]) < 0.0))
    if backwards:
        usual = float(np.median(np.abs(np.diff(t_s[kept]))))
        back = float(-np.min(np.diff(t_s[kept])))
        if backwards < _UNSORTED * len(kept) and back > _MOST_BACK * usual:
            raise InputError(f"{where}: its time jumps back by {back:.4g}, {back / max(usual, 1e-12):.0f} rows' worth; "
                             "it mixes clocks or flights. Name a log of one flight by one clock")  # fmt: skip
        notes.append(f"time goes backwards {backwards} times; rows were sorted")
        kept = kept[np.argsort(t_s[kept], kind="stable")]
    t_us = np.round(np.clip(t_s[kept] * 1e6, -9e18, 9e18)).astype(np.int64)
    first = np.concatenate([[True], np.diff(t_us) > 0])
    if not first.all():
        notes.append(f"{int(np.sum(~first))} rows repeat the time of another and were left out")
    rows = kept[first]
    return t_us[first], {name: np.ascontiguousarray(values[rows]) for name, values in signals.items()}, notes
