"""`flightstack vehicle fit`: logs and a vehicle file in, what the logs say of every number out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flightstack.cli import files
from flightstack.errors import InputError
from flightstack.gap import pooled
from flightstack.gap.number_fit import FittedNumber, NumberFit, fit_numbers
from flightstack.gap.workflow import usable_flights
from flightstack.vehicle import parse_vehicle, vehicle_to_toml

SCHEMA = "flightstack.vehicle-fit/1"
_TOLD_BY = {"logs": "", "scale": "; up to the common scale", "range": "; the logs hardly tell it", "file": "; as known"}


def fit_file(logs: Sequence[Path], vehicle: str, columns: str | None, ground_d_m: float) -> tuple[NumberFit, str]:
    """The fit and the text of the fitted file; InputError, one line, where logs or file can't be used."""
    believed, _ = files.load_vehicle(vehicle)
    for path in logs:
        if not path.is_file():
            raise InputError(f"log {path}: there is no such file; check the path")
    flights = usable_flights(logs, believed, columns=columns, ground_d_m=ground_d_m)
    of = pooled.split(flights, [])
    if not any(mask.any() for mask in of.fit):
        raise InputError(f"log {logs[0]}: is too short to learn from; record at least 10 s in the air")
    done = fit_numbers(believed, of)
    text = f"# Fitted to {', '.join(path.name for path in logs)}; a range is the 95 % interval, or what was known.\n"
    text += vehicle_to_toml(done.vehicle)
    parse_vehicle(text, "the fitted file")  # what is written can be flown
    return done, text


def lines(done: NumberFit) -> list[str]:
    """What to print: a line for each number that is not simply known, then what concerns all of them."""
    found = []
    if done.assumed:
        found.append("the file gives no ranges: mass and geometry are taken as known, the rest within usual ranges")
    found += [_line(row) for row in done.numbers if row.told_by != "file"]
    plain = sum(row.told_by == "file" for row in done.numbers)
    found.append(f"{plain} plain numbers are taken as known")
    scale = done.scale
    if scale.known_by:
        found.append(f"the common scale of {_classed(scale.members)} is fixed by {scale.known_by}")
    else:
        found.append(
            f"no acceleration shows the common scale of {_classed(scale.members)}: it is known within "
            f"{100 * scale.spread:.2g} % by the ranges alone; weigh the vehicle"
        )
    for name, (ratio, low, high) in scale.per_kg.items():
        found.append(f"{name} per kg of mass: {ratio:.5g} [{low:.5g}, {high:.5g}]")
    found += [
        f"{name} stands at the end of its range: the range is wrong, or it stands for something else"
        for name in done.pressed
    ]
    found += [f"the logs contradict {key}: it stands in the file as known" for key in done.contradicted]
    for name, values in done.missing.items():
        told = ", ".join(f"{key} {x:.4g}" for key, x in values.items())
        found.append(f"the file lacks {name} ({told}): `flightstack gap` adds it")
    if done.unexplained.significant:
        on = ", ".join(done.unexplained.depends_on) or "nothing that these logs show"
        found.append(
            f"something is left that no number and no effect explains (depends on {on}): intervals may be too small"
        )
    return found


def as_json(done: NumberFit, logs: list[str], vehicle: str) -> dict[str, Any]:
    """The result as `flightstack.vehicle-fit/1`."""
    numbers = [
        {
            "name": row.number.name,
            "unit": row.number.unit,
            "before": row.number.value,
            "range": [row.number.low, row.number.high] if row.number.is_ranged else None,
            "estimate": row.estimate,
            "ci95": [row.low, row.high],
            "told_by": row.told_by,
            "indistinguishable_from": list(row.like),
        }
        for row in done.numbers
    ]
    scale = {
        "members": list(done.scale.members),
        "known_by": done.scale.known_by or None,
        "relative_ci95": done.scale.spread,
        "per_kg": {name: {"estimate": x, "ci95": [low, high]} for name, (x, low, high) in done.scale.per_kg.items()},
    }
    return {
        "schema": SCHEMA,
        "logs": logs,
        "vehicle": vehicle,
        "ranges_assumed": done.assumed,
        "numbers": numbers,
        "scale_class": scale,
        "missing_effects": {name: dict(values) for name, values in done.missing.items()},
        "at_end_of_range": list(done.pressed),
        "contradicted": list(done.contradicted),
        "unexplained": {"significant": done.unexplained.significant, "depends_on": list(done.unexplained.depends_on)},
    }


def _line(row: FittedNumber) -> str:
    unit = f" {row.number.unit}" if row.number.unit else ""
    like = f"; hardly told from {_classed(row.like)}" if row.like and row.told_by != "scale" else ""
    return (
        f"{row.number.name}: {row.number.value:.5g} -> {row.estimate:.5g}{unit} "
        f"[{row.low:.5g}, {row.high:.5g}]{_TOLD_BY[row.told_by]}{like}"
    )


def _classed(names: Sequence[str]) -> str:
    """Keys of the file, lists named once."""
    return ", ".join(dict.fromkeys(name.split("[")[0] for name in names))
