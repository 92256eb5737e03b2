"""The campaign file (TOML, `flightstack.campaign/1`): pure text in, one frozen object out; errors are one line."""

from __future__ import annotations

import math
import re
from bisect import bisect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import Any

from flightstack.checked import number, read_toml
from flightstack.cli.campaign import keys
from flightstack.cli.campaign.grouped import Grouping, parse_table
from flightstack.cli.campaign.searching import Search, parse_search
from flightstack.cli.filed import FILES, option_value
from flightstack.cli.files import read_text
from flightstack.errors import InputError
from flightstack.toml_text import toml_text

SCHEMA = "flightstack.campaign/1"
GRID, RANDOM, SOBOL = "grid", "random", "sobol"
KEPT = ("failures", "all", "none")
MOST_FLIGHTS = 10_000_000
_TOP = (
    "schema", "scenario", "task", "seeds", "design", "count", "vary", "search", "keep", "table", "timeout_s",
    "design_seed", "most_failures",
)  # fmt: skip
_TASK = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
_DEFAULT_TIMEOUT = (60.0, 5.0)
"""Wall time that a flight may take: seconds, and beside them so many for each second of its track."""


@dataclass(frozen=True, slots=True)
class Factor:
    """What is varied: a list of values, or a range."""

    name: str
    """As the file has it: the column's name."""
    sort: str
    """keys.VEHICLE, GRADE or OPTION; "scenario" is a factor too."""
    key: str
    values: tuple[Any, ...] = ()
    """Empty: a range."""
    weights: tuple[float, ...] = ()
    """Of the values; empty: all alike."""
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    """Even in the logarithm."""

    @property
    def is_range(self) -> bool:
        """Whether it is drawn between two numbers."""
        return not self.values

    def at(self, share: float) -> Any:
        """The value at a share of the range, 0..1, or of the list."""
        if self.weights:
            return self.values[bisect(list(accumulate(self.weights)), share * sum(self.weights))]
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if self.log:
            return float(self.low * math.exp(share * math.log(self.high / self.low)))
        return self.low + share * (self.high - self.low)


@dataclass(frozen=True, slots=True)
class CampaignSpec:
    """A campaign, checked."""

    path: Path
    scenarios: tuple[str, ...]
    """Empty where a task is flown."""
    first_seed: int
    seeds: int
    design: str
    count: int
    """Flights in all; of a search at most so many."""
    factors: tuple[Factor, ...]
    fixed: tuple[Factor, ...] = ()
    """Factors of one value."""
    design_seed: int = 0
    keep: str = "failures"
    timeout_s: float | None = None
    search: Search | None = None
    task: str = ""
    """MODULE:FUNCTION that is called instead of `fly`."""
    table: Grouping | None = None
    most_failures: int | None = None
    """With more than so many flights that failed, crashed or never ended, the verb's exit code is 1."""
    text: str = field(default="", repr=False)

    @property
    def verb(self) -> str:
        """What flies a flight's file again."""
        return "campaign" if self.task else "fly"

    def seed_of(self, flight: int) -> int:
        """Seed of a flight."""
        return self.first_seed + flight % self.seeds

    def limit_s(self, duration_s: float) -> float:
        """Wall time that a flight with a track so long may take."""
        return self.timeout_s or _DEFAULT_TIMEOUT[0] + _DEFAULT_TIMEOUT[1] * duration_s


def load_spec(path: Path, changes: Sequence[str] = ()) -> CampaignSpec:
    """The campaign of a file, with `changes` (KEY=VALUE, TOML); InputError, one line, where something is wrong."""
    text = read_text(path).text
    return parse_spec(_changed(text, changes, str(path)) if changes else text, path)


def _changed(text: str, changes: Sequence[str], source: str) -> str:
    data = read_toml(text, source)
    for change in changes:
        try:
            merged(data, read_toml(change, "--set"))
        except InputError:
            raise InputError(f"--set {change}: not KEY=VALUE as TOML has it; a text needs quotes") from None
    return toml_text(data)


def merged(data: dict[str, Any], more: Mapping[str, Any]) -> None:
    """Put the keys of `more` into `data`, tables key by key."""
    for key, value in more.items():
        inner = data.get(key)
        if isinstance(value, Mapping) and isinstance(inner, dict) and key in ("vary", "seeds", "search", "keep"):
            merged(inner, value)
        else:
            data[key] = value


def parse_spec(text: str, path: Path) -> CampaignSpec:
    """The campaign that `text` describes; `path` names it and is where its files are looked for first."""
    source, data = str(path), read_toml(text, str(path))
    for key in data:
        if key not in _TOP:
            raise keys.unknown(key, list(_TOP), source)
    if data.get("schema") != SCHEMA:
        raise InputError(f'{source}: schema = {data.get("schema")!r} is not known; this version reads "{SCHEMA}"')
    task = _task(data, source)
    scenarios = () if task else _scenarios(data.get("scenario"), source, path.parent)
    first, seeds = _seeds(data.get("seeds", {}), source)
    vary = data.get("vary", {})
    if not isinstance(vary, Mapping):
        raise InputError(f"{source}: vary must be a table of dotted keys")
    found = [
        _factor(name, entry, f"{source}: vary", None if task else path.parent) for name, entry in _dotted(vary).items()
    ]
    if len(scenarios) > 1:
        found.insert(0, Factor("scenario", "scenario", "scenario", scenarios))
    factors = tuple(each for each in found if len(each.values) != 1)
    design = data.get("design", RANDOM)
    if design not in (GRID, RANDOM, SOBOL):
        raise InputError(f"{source}: design = {design!r} is not known; known are {GRID}, {RANDOM}, {SOBOL}")
    search = parse_search(data["search"], f"{source}: search") if "search" in data else None
    if search is not None and search.adversary and task:
        raise InputError(f"{source}: search.adversary goes with scenarios; a task says itself what is moved")
    return CampaignSpec(
        path=path,
        scenarios=scenarios,
        first_seed=first,
        seeds=seeds,
        design=design,
        count=_count(data.get("count"), design, factors, seeds, source),
        factors=factors,
        fixed=tuple(each for each in found if len(each.values) == 1),
        design_seed=whole(data.get("design_seed", 0), f"{source}: design_seed", 0, 2**32),
        keep="none" if task else _kept(data.get("keep", {}), source),
        timeout_s=None if "timeout_s" not in data else number(data["timeout_s"], f"{source}: timeout_s", 0.1, 1e6),
        search=search,
        task=task,
        table=_grouping(data, [each.name for each in found], source),
        most_failures=(
            None
            if "most_failures" not in data
            else whole(data["most_failures"], f"{source}: most_failures", 0, MOST_FLIGHTS)
        ),
        text=text,
    )


def _grouping(data: Mapping[str, Any], factors: list[str], source: str) -> Grouping | None:
    if "table" not in data:
        return None
    table = parse_table(data["table"], f"{source}: table")
    for name in table.by:
        if name not in factors:
            raise keys.unknown(name, factors, f"{source}: table.by")
    return table


def _task(data: Mapping[str, Any], source: str) -> str:
    task = data.get("task", "")
    if task and ("scenario" in data or "keep" in data):
        raise InputError(f"{source}: a campaign flies scenarios or a task: scenario and keep go with the former")
    if not isinstance(task, str) or (task and not _TASK.fullmatch(task)):
        raise InputError(f"{source}: task = {task!r} is not allowed; it must be MODULE:FUNCTION")
    return task


def whole(value: object, where: str, least: int, most: int) -> int:
    """A whole number within its range."""
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise InputError(f"{where} = {value!r} is not allowed; it must be a whole number from {least} to {most}")
    return value


def _only(table: object, known: tuple[str, ...], where: str) -> Mapping[str, Any]:
    if not isinstance(table, Mapping):
        raise InputError(f"{where} must be a table, not {table!r}")
    for key in table:
        if key not in known:
            raise keys.unknown(key, list(known), where)
    return table


def _scenarios(value: object, source: str, folder: Path) -> tuple[str, ...]:
    listed = [value] if isinstance(value, str) else value
    if not isinstance(listed, list) or not listed or not all(isinstance(each, str) and each for each in listed):
        raise InputError(f"{source}: scenario = {value!r} is not allowed; name a scenario, or list several")
    return tuple(_beside(each, folder) for each in listed)


def _beside(name: str, folder: Path) -> str:
    """A file that lies beside the campaign's; else the name as it stands."""
    beside = folder / name
    return str(beside.resolve()) if beside.is_file() else name


def _seeds(table: object, source: str) -> tuple[int, int]:
    given = _only(table, ("from", "count"), f"{source}: seeds")
    first = whole(given.get("from", 0), f"{source}: seeds.from", 0, 2**53)
    return first, whole(given.get("count", 1), f"{source}: seeds.count", 1, MOST_FLIGHTS)


def _kept(table: object, source: str) -> str:
    keep = _only(table, ("logs",), f"{source}: keep").get("logs", "failures")
    if keep not in KEPT:
        raise InputError(f"{source}: keep.logs = {keep!r} is not known; known are {', '.join(KEPT)}")
    return str(keep)


def _dotted(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """`[vary.body] mass_kg = ...` is `"body.mass_kg"`; a range is no table of keys."""
    flat: dict[str, Any] = {}
    for key, entry in table.items():
        nested = isinstance(entry, Mapping) and not {"low", "high", "values"} & set(entry)
        flat |= _dotted(entry, f"{prefix}{key}.") if nested else {f"{prefix}{key}": entry}
    return flat


def _factor(name: str, entry: Any, where: str, folder: Path | None) -> Factor:
    """`folder`: where files lie; None: of a task, whose keys are its own."""
    sort, key = (keys.TASK, name) if folder is None else keys.sort_of(name, where)
    if isinstance(entry, Mapping) and "values" in entry:
        given = _only(entry, ("values", "weights"), f"{where}: {name}")
        return replace(_factor(name, given["values"], where, folder), weights=_weights(name, given, where))
    if isinstance(entry, Mapping):
        return _range(name, sort, key, _only(entry, ("low", "high", "steps", "scale"), f"{where}: {name}"), where)
    values = entry if isinstance(entry, list) else [entry]
    if not values:
        raise InputError(f"{where}: {name} = [] is not allowed; list at least one value")
    if sort == keys.TASK:
        if any(not isinstance(each, bool | int | float | str | list) for each in values):
            raise InputError(f"{where}: {name} = {entry!r} is not allowed; numbers, texts, true or false")
    elif sort == keys.OPTION:
        values = [
            _beside(each, folder) if folder and key in FILES and isinstance(each, str) else each for each in values
        ]
        for each in values:
            option_value(key, each, f"{where}: fly")
    elif any(isinstance(each, bool) or not isinstance(each, int | float | list) for each in values):
        raise InputError(f"{where}: {name} = {entry!r} is not allowed; its values must be numbers")
    return Factor(name, sort, key, tuple(values))


def _weights(name: str, entry: Mapping[str, Any], where: str) -> tuple[float, ...]:
    values, weights = entry["values"], entry.get("weights", ())
    if not isinstance(values, list) or not isinstance(weights, list | tuple) or len(weights) not in (0, len(values)):
        raise InputError(f"{where}: {name}.weights must be a list, one for each of the values")
    return tuple(number(each, f"{where}: {name}.weights", 1e-9, 1e9) for each in weights)


def _range(name: str, sort: str, key: str, entry: Mapping[str, Any], where: str) -> Factor:
    if sort == keys.OPTION and key not in ("duration",):
        raise InputError(f"{where}: {name} takes no range; list its values")
    for end in ("low", "high"):
        if end not in entry:
            raise InputError(f"{where}: {name}.{end} is missing")
    low, high = (number(entry[end], f"{where}: {name}.{end}", -1e9, 1e9) for end in ("low", "high"))
    if not low < high:
        raise InputError(f"{where}: {name}.low = {low:g} must lie below {name}.high = {high:g}")
    scale = entry.get("scale", "linear")
    if scale not in ("linear", "log") or (scale == "log" and low <= 0.0):
        raise InputError(f'{where}: {name}.scale = {scale!r} is not allowed; "linear", or "log" above 0')
    spread = Factor(name, sort, key, low=low, high=high, log=scale == "log")
    if "steps" not in entry:
        return spread
    steps = whole(entry["steps"], f"{where}: {name}.steps", 2, 10_000)
    return Factor(name, sort, key, tuple(spread.at(i / (steps - 1)) for i in range(steps)))


def _count(given: object, design: str, factors: tuple[Factor, ...], seeds: int, source: str) -> int:
    if design != GRID:
        if given is None:
            raise InputError(f"{source}: count is missing; design = {design!r} needs the number of flights")
        return whole(given, f"{source}: count", 1, MOST_FLIGHTS)
    for factor in factors:
        if factor.is_range:
            raise InputError(f"{source}: vary: {factor.name} is a range; in a grid list its values, or add steps = N")
    product = seeds * math.prod(len(factor.values) for factor in factors)
    if given is not None and given != product:
        raise InputError(f"{source}: count = {given!r} goes with random and sobol; this grid has {product} flights")
    return whole(product, f"{source}: flights of the grid", 1, MOST_FLIGHTS)
