"""The dotted keys that a campaign can vary: the truth's vehicle file, the sensors' grade, options of `fly`."""

from __future__ import annotations

import difflib
import re

from flightstack.cli.filed import option_names
from flightstack.dotted import vehicle_keys
from flightstack.errors import InputError
from flightstack_sim.grade import grade_keys

VEHICLE, GRADE, OPTION, TASK = "vehicle", "grade", "option", "task"
_PLACE = re.compile(r"(\.\d+)+$")
_NOT_VARIED = {"seed"}
"""Options of `fly` that have a place of their own."""


def option_keys() -> list[str]:
    """`fly.fault` and the like."""
    return [f"fly.{name}" for name in option_names() if name not in _NOT_VARIED]


def sort_of(key: str, where: str) -> tuple[str, str]:
    """(which of the above, the key there) of a dotted key; InputError names the nearest one that is known."""
    plain = _PLACE.sub("", key)
    grades, vehicles, options = grade_keys(), vehicle_keys(), option_keys()
    if plain in vehicles:
        return VEHICLE, key
    bare, place = plain.removeprefix("sensors."), key[len(plain) :]
    if bare in grades:
        return GRADE, bare + place
    dashed = plain.replace("_", "-")
    if dashed in options and not place:
        return OPTION, dashed.removeprefix("fly.")
    raise unknown(key, [*vehicles, *grades, *options], where)


def unknown(key: str, known: list[str], where: str) -> InputError:
    """The error for a key that nobody knows: the nearest known one is named."""
    near = difflib.get_close_matches(key, known, 1, 0.0)
    last = [each for each in known if each.rsplit(".", 1)[-1] == key.rsplit(".", 1)[-1]]
    nearest = (difflib.get_close_matches(key, last, 1, 0.0) or near) if last else near
    said = f"; the nearest known one is {nearest[0]}" if nearest else ""
    return InputError(f"{where}: unknown key {key}{said}")
