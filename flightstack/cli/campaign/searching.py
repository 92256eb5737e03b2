"""The table [search] of a campaign file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flightstack.checked import number, words
from flightstack.cli.campaign import keys
from flightstack.errors import InputError

CROSS_ENTROPY, CMA_ES, SPLITTING, UNIFORM = "cross-entropy", "cma-es", "splitting", "random"
METHODS = (CROSS_ENTROPY, CMA_ES, SPLITTING, UNIFORM)
_KEYS = ("method", "target", "adversary", "below", "maximise", "population", "stop")


@dataclass(frozen=True, slots=True)
class Search:
    """What is looked for, and how."""

    method: str
    target: str
    """Field of fly's JSON, dotted."""
    adversary: bool = False
    below: float = 0.0
    """What counts as found: the target falls below this."""
    maximise: bool = False
    """The worst is the greatest: found where the target rises above `below`."""
    population: int | None = None
    """Flights of a generation, or of a level."""
    stop: bool = True
    """End with the generation in which the first failure is found."""


def parse_search(table: object, where: str) -> Search:
    """The checked table."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where} must be a table, not {table!r}")
    for key in table:
        if key not in _KEYS:
            raise keys.unknown(key, list(_KEYS), where)
    method = table.get("method", CROSS_ENTROPY)
    if method not in METHODS:
        raise InputError(f"{where}.method = {method!r} is not known; known are {', '.join(METHODS)}")
    for key in ("adversary", "maximise", "stop"):
        if not isinstance(table.get(key, False), bool):
            raise InputError(f"{where}.{key} = {table[key]!r} is not allowed; it must be true or false")
    population = table.get("population")
    if population is not None:
        population = int(number(population, f"{where}.population", 4, 100_000))
    return Search(
        method=str(method),
        target=words(table.get("target"), f"{where}.target"),
        adversary=bool(table.get("adversary", False)),
        below=number(table.get("below", 0.0), f"{where}.below", -1e12, 1e12),
        maximise=bool(table.get("maximise", False)),
        population=population,
        stop=bool(table.get("stop", method != SPLITTING)),
    )
