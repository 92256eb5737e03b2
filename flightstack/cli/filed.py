"""Options of `fly` that a scenario file states itself, in its table [flight]: one file is then a whole flight.

What the command line says otherwise goes before; the names are the command line's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flightstack.errors import InputError

if TYPE_CHECKING:
    from flightstack.cli.flight import FlyOptions

OPTIONS: dict[str, tuple[str, type, bool]] = {
    "vehicle": ("vehicle", str, True),
    "truth": ("truth", str, True),
    "sensors": ("sensors", str, True),
    "seed": ("seed", int, True),
    "plant": ("plant", str, True),
    "fault": ("fault", str, True),
    "controller": ("controller", str, True),
    "duration": ("duration_s", float, True),
    "learning": ("learning", bool, True),
    "no-learning": ("learning", bool, False),
    "learned": ("learned", Path, True),
    "filter": ("filtering", bool, True),
    "no-filter": ("filtering", bool, False),
    "as-published": ("as_published", bool, True),
    "certificate": ("certificate", Path, True),
    "site": ("site", Path, True),
    "unprotected-ok": ("unprotected_ok", bool, True),
}
"""Name -> (field of FlyOptions, its kind, whether true means true)."""
FILES = {"vehicle", "truth", "learned", "certificate", "site"}
"""Those that may name files."""


def option_names() -> list[str]:
    """The names of OPTIONS that this version's flights have."""
    from flightstack.cli.flight import FlyOptions

    known = {each.name for each in fields(FlyOptions)}
    return [name for name, (place, _, _) in OPTIONS.items() if place in known]


def option_value(name: str, value: object, where: str) -> tuple[str, Any]:
    """(field of FlyOptions, value) of an option as a file states it; "none" is what nothing else would be."""
    place, kind, meaning = OPTIONS[name]
    if value == "none" and kind in (str, Path):
        return place, None
    if kind is bool and isinstance(value, bool):
        return place, value is meaning
    if kind in (str, Path) and isinstance(value, str):
        return place, kind(value)
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        return place, float(value)
    if kind is int and isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return place, value
    words = {bool: "true or false", int: "a whole number from 0", float: "a number"}.get(kind, "a text")
    raise InputError(f"{where}.{name} = {value!r} is not allowed; it must be {words}")


def with_filed(options: FlyOptions, stated: Mapping[str, object], source: str) -> FlyOptions:
    """The options with what the scenario's [flight] states where they stand at their defaults."""
    if not stated:
        return options
    names, changes = option_names(), {}
    defaults = {each.name: each.default for each in fields(options)}
    for name, value in stated.items():
        if name not in names:
            raise InputError(f"{source}: unknown key flight.{name}; known are {', '.join(names)}")
        place, parsed = option_value(name, value, f"{source}: flight")
        if getattr(options, place) == defaults[place]:
            changes[place] = parsed
    return replace(options, **changes)
