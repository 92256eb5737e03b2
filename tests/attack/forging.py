"""Certificates that were tampered with, under a seal that fits."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Iterator
from typing import Any

import numpy as np

Path = tuple[str | int, ...]


def resealed(data: dict[str, Any]) -> str:
    """Its text with a seal that fits; written from the format's description, not with the product's code."""
    rest = {key: part for key, part in data.items() if key != "seal"}
    canonical = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return json.dumps({**rest, "seal": hashlib.sha256(canonical.encode()).hexdigest()})


def numbers_of(value: Any, path: Path = ()) -> Iterator[tuple[Path, float]]:
    """Every number of a file, and where it is."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from numbers_of(part, (*path, key))
    elif isinstance(value, list):
        for k, part in enumerate(value):
            yield from numbers_of(part, (*path, k))
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield path, value


def with_number(data: dict[str, Any], path: Path, number: float) -> dict[str, Any]:
    """A copy with one number changed."""
    made = copy.deepcopy(data)
    place: Any = made
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = number
    return made


def tampered(data: dict[str, Any], count: int, seed: int) -> Iterator[tuple[Path, float, dict[str, Any]]]:
    """One number changed each: every place of the file but the long tables at least once, then at random."""
    rng = np.random.default_rng(seed)
    found = list(numbers_of(data))
    short = [each for each in found if sum(isinstance(key, int) for key in each[0]) < 3]
    rng.shuffle(short)  # type: ignore[arg-type]
    places = short[: count // 2] + [
        found[k] for k in rng.integers(len(found), size=count - min(len(short), count // 2))
    ]
    for path, number in places:
        changed = number * float(rng.choice([0.9, 0.99, 1.01, 1.1, -1.0])) if number else float(rng.choice([1e-3, 1.0]))
        if isinstance(number, int):
            changed = number + int(rng.choice([-1, 1]))
        if changed != number:
            yield path, changed, with_number(data, path, changed)
