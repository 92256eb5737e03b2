"""Files of parameters: those to set before a flight (`flightstack.params/1`), and lists that tools save.  Pure."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from flightstack.checked import load_toml
from flightstack.types import InputError

SCHEMA = "flightstack.params/1"
_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,15}")
_KEYS = ("name", "description", "sensors", "set")


class ParamFile(NamedTuple):
    """Parameters to set, and what the vehicle's estimate is like with them."""

    values: dict[str, float]
    sensors: str = ""
    """Name of the sensors' grade whose statistics then hold; empty: nothing is said of it."""


def parse_params(text: str, source: str) -> ParamFile:
    """The table `set` and the key `sensors`; InputError in one line names `source` and what is wrong."""
    data = load_toml(text, source, SCHEMA, _KEYS)
    table = data.get("set")
    if not isinstance(table, dict) or not table:
        raise InputError(f"{source}: table [set] is missing or empty; it holds NAME = value")
    values = {}
    for name, value in table.items():
        if not _NAME.fullmatch(name):
            raise InputError(
                f"{source}: set.{name} is no name of a PX4 parameter (16 capital letters, digits and _ at most)"
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{source}: set.{name} = {value!r} is not allowed; it must be a number")
        values[name] = float(value)
    sensors = data.get("sensors", "")
    if not isinstance(sensors, str):
        raise InputError(f"{source}: sensors = {sensors!r} must be the name of a grade")
    return ParamFile(values, sensors)


def listed_params(text: str, source: str) -> dict[str, float]:
    """Name -> value of a list as ground stations save it; InputError where it holds none.

    QGroundControl writes `system component NAME value type` with tabs, MAVProxy `NAME value`, others `NAME,value`;
    lines that begin with # are comments.
    """
    values: dict[str, float] = {}
    for number, line in enumerate(text.splitlines(), 1):
        fields = re.split(r"[\s,;=]+", line.strip())
        if not line.strip() or line.lstrip().startswith(("#", "//")):
            continue
        at = 2 if len(fields) >= 4 and fields[0].isdigit() and fields[1].isdigit() else 0
        try:
            name, value = fields[at], float(fields[at + 1])
        except (IndexError, ValueError):
            raise InputError(f"{source}: line {number} is no parameter: {line.strip()[:60]!r}") from None
        if not _NAME.fullmatch(name) or not math.isfinite(value):
            raise InputError(f"{source}: line {number} is no parameter: {line.strip()[:60]!r}")
        values[name] = value
    if not values:
        raise InputError(f"{source}: holds no parameters; save them from QGroundControl, or name a ULog")
    return values
